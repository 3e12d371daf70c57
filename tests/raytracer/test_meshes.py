import numpy as np
import pytest

from raytracer import Material, Mesh, SceneError
from raytracer.meshes.shapes import box, checkerboard, cylinder, floor, icosahedron, knot, sphere, torus

CUBE_OBJ = """\
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
f 1 2 3 4
"""


def closed(mesh):
    """Every edge, by the places of its ends, is used once in each direction."""
    _, place = np.unique(np.round(mesh.vertices, 9), axis=0, return_inverse=True)
    faces = place.reshape(-1)[mesh.faces]
    edges = {(a, b) for f in faces.tolist() for a, b in zip(f, f[1:] + f[:1], strict=True)}
    return len(edges) == 3 * len(faces) and all((b, a) in edges for a, b in edges)


def volume(mesh):
    c = mesh.corners
    return np.einsum("ij,ij->", c[:, 0], np.cross(c[:, 1], c[:, 2])) / 6


@pytest.mark.parametrize(
    ("mesh", "triangles", "expected"),
    [
        (box((1, 2, 3)), 12, 6.0),
        (box(inward=True), 12, -1.0),
        (sphere(2.0, rings=64, segments=128), 2 * 128 * 63, 4 / 3 * np.pi * 8),
        (torus(1.0, 0.25, segments=96, sides=48), 2 * 96 * 48, 2 * np.pi**2 * 0.25**2),
        (knot(segments=200, sides=20), 2 * 200 * 20, None),
        (cylinder(1.0, 2.0, segments=128), 4 * 128, 2 * np.pi),
        (icosahedron(1.0), 20, 2.53615),
    ],
    ids=["box", "room", "sphere", "torus", "knot", "cylinder", "icosahedron"],
)
def test_shapes_are_closed_and_turned_outside(mesh, triangles, expected):
    assert len(mesh) == triangles
    assert closed(mesh)
    assert volume(mesh) > 0 or mesh.vertices.max() == 0.5  # the room faces inward
    if expected is not None:
        assert volume(mesh) == pytest.approx(expected, rel=6e-3)


@pytest.mark.parametrize("mesh", [sphere(), torus(), knot()], ids=["sphere", "torus", "knot"])
def test_smooth_shapes_have_normals_near_their_faces(mesh):
    along = np.einsum("ij,ikj->ik", mesh.face_normals, mesh.normals)
    assert along.min() > 0.98
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=-1), 1, atol=1e-12)


def test_smoothed_keeps_the_edges_of_a_box():
    mesh = box().smoothed(45)
    np.testing.assert_allclose(mesh.normals, np.repeat(mesh.face_normals[:, None], 3, axis=1), atol=1e-12)


def test_smoothed_finds_the_normals_of_a_sphere():
    exact = sphere(rings=48, segments=96)
    again = Mesh(exact.vertices, exact.faces).smoothed(45)
    assert np.einsum("ijk,ijk->ij", exact.normals, again.normals).min() > 0.999


def test_smoothed_joins_vertices_at_the_same_place():
    shared = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0.1], [0, -1, 0.1]], [[0, 1, 2], [0, 3, 1]])
    split = Mesh(shared.corners.reshape(-1, 3), [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_allclose(shared.smoothed(60).normals, split.smoothed(60).normals)
    assert not np.allclose(shared.smoothed(60).normals[0, 0], shared.face_normals[0])


def test_smoothed_of_a_triangle_without_area_is_finite():
    mesh = Mesh([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 1, 3]]).smoothed()
    assert np.all(np.isfinite(mesh.normals))


def test_tiny_triangles_keep_their_normals():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]) * 1e-170
    np.testing.assert_array_equal(Mesh(corners, [[0, 1, 2]]).face_normals, [[0, 0, 1]])


def test_checkerboard_alternates():
    mesh = checkerboard(4, 4, (1, 1, 1), (0, 0, 0))
    assert len(mesh) == 32
    assert mesh.colors[:2].tolist() != mesh.colors[2:4].tolist()
    np.testing.assert_array_equal(mesh.face_normals, np.tile([0, 1, 0], (32, 1)))


def test_moved_turns_about_y_and_moves():
    mesh = floor(2).moved((0, 3, 0), scale=2, tilt=90)
    np.testing.assert_allclose(mesh.face_normals, [[0, 0, 1]] * 2, atol=1e-12)
    np.testing.assert_allclose([mesh.vertices[:, 1].min(), mesh.vertices[:, 1].max()], [1, 5])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([[0, 0]], []), "three components"),
        (([[0, 0, np.nan]], []), "NaN or infinity"),
        ((np.zeros((3, 3)), [[0, 1, 3]]), "face 0 names a vertex"),
        ((np.zeros((3, 3)), [[0, 1, -1]]), "face 0 names a vertex"),
        ((np.zeros((3, 3)), [[0.0, 1.0, 2.0]]), "integers"),
        ((np.zeros((3, 3)), [[0, 1, 2]], np.zeros((2, 3))), r"\(V, 3\) or \(F, 3, 3\)"),
    ],
)
def test_wrong_arrays_are_named(arguments, words):
    with pytest.raises(SceneError, match=words):
        Mesh(*arguments)


def test_obj_quads_become_triangles(tmp_path):
    path = tmp_path / "quad.obj"
    path.write_text(CUBE_OBJ)
    mesh = Mesh.load(path)
    assert len(mesh) == 2
    assert mesh.name == "quad"
    np.testing.assert_allclose(np.abs(mesh.normals[..., 2]), 1)


def test_obj_normals_are_kept(tmp_path):
    path = tmp_path / "tilted.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0.6 0 0.8\nf 1//1 2//1 3//1\n")
    np.testing.assert_allclose(Mesh.load(path).normals, np.broadcast_to([0.6, 0, 0.8], (1, 3, 3)), atol=1e-6)


def test_ply_colours_become_linear(tmp_path):
    path = tmp_path / "colour.ply"
    header = ["ply", "format ascii 1.0", "element vertex 3", *(f"property float {a}" for a in "xyz")]
    header += [*(f"property uchar {c}" for c in ("red", "green", "blue")), "element face 1"]
    header += ["property list uchar int vertex_indices", "end_header"]
    path.write_text("\n".join([*header, "0 0 0 255 0 128", "1 0 0 255 0 128", "0 1 0 255 0 128", "3 0 1 2", ""]))
    np.testing.assert_allclose(Mesh.load(path).colors[0, 0], [1, 0, 0.21586], atol=1e-4)


@pytest.mark.parametrize("suffix", ["ply", "stl", "glb"])
def test_formats_give_the_same_shape_back(tmp_path, suffix):
    import trimesh

    mesh = icosahedron()
    path = tmp_path / f"shape.{suffix}"
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)
    loaded = Mesh.load(path)
    assert volume(loaded) == pytest.approx(volume(mesh), rel=1e-5)
    assert closed(loaded)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("points.obj", b"v 0 0 0\nv 1 1 1\n", "no triangles"),
        ("empty.obj", b"", "no triangles|not a readable"),
        ("broken.ply", b"ply\nnonsense", "not a readable PLY"),
        ("broken.glb", b"\x00\x01\x02", "not a readable GLB"),
        ("shape.xyz", b"1 2 3", r"read from \.obj"),
        ("nan.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "NaN"),
    ],
)
def test_bad_files_are_named(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(SceneError, match=words):
        Mesh.load(path)


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no file .*gone\.obj"):
        Mesh.load(tmp_path / "gone.obj")


@pytest.mark.parametrize("wrong", [{"reflectivity": 1.5}, {"diffuse": -1}, {"color": (1, 1)}, {"shininess": np.inf}])
def test_materials_refuse_what_makes_no_sense(wrong):
    with pytest.raises(SceneError):
        Material(**wrong)
