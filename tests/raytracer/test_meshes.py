import tracemalloc
import warnings

import numpy as np
import pytest
import trimesh

import shpy as sh
from raytracer import EnvironmentLight, Material, Mesh, Scene, SceneError, Texture
from raytracer.accel.planes import unit
from raytracer.meshes.shapes import box, checkerboard, cylinder, floor, icosahedron, knot, sphere, torus
from raytracer.meshes.teapot import teapot

CUBE_OBJ = """\
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
f 1 2 3 4
"""


PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
property uchar red
property uchar green
property uchar blue
end_header
0 0 0
1 0 0
0 1 0
3 0 1 2 255 0 128
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
        (([[0, 0]], []), "3 components"),
        ((None, []), "3 components"),
        (([[0, 0, 0], [1, 0]], []), "mesh: vertices are rows of different lengths"),
        ((np.zeros((3, 3)), [[0, 1, 2], [0, 1]]), "mesh: faces are rows of different lengths"),
        (("abc", []), "mesh: vertices are real numbers, not <U3"),
        ((np.zeros((3, 3), complex), []), "mesh: vertices are real numbers, not complex128"),
        ((np.ma.masked_array(np.zeros((3, 3)), True), []), "mesh: vertices are real numbers, not a masked array"),
        (([[0, 0, np.nan]], []), "NaN or infinity"),
        ((np.zeros((3, 3)), [[0, 1, 3]]), "face 0 names a vertex"),
        ((np.zeros((3, 3)), [[0, 1, -1]]), "face 0 names a vertex"),
        ((np.zeros((3, 3)), [[0.0, 1.0, 2.0]]), "integers"),
        ((np.zeros((3, 3)), [[0, 1, 2]], np.zeros((2, 3))), r"\(V, 3\) or \(F, 3, 3\)"),
        ((np.zeros((3, 3)), [[0, 1, 2]], None, None, Material(), None), "the name of a mesh is a str, not None"),
    ],
)
def test_wrong_arrays_are_named(arguments, words):
    with pytest.raises(SceneError, match=words):
        Mesh(*arguments)


@pytest.mark.parametrize("wrong", [(1, 2), 1, "abc", None, (1, 2, np.nan)])
def test_an_offset_is_three_numbers(wrong):
    with pytest.raises(SceneError, match="box: an offset is three finite numbers"):
        box().moved(wrong)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: box((1, 1)), r"a box's size is three finite numbers, not \(1, 1\)"),
        (lambda: box(size="abc"), "a box's size is three finite numbers, not 'abc'"),
        (lambda: floor(np.nan), "a floor's size is a finite number, not nan"),
        (lambda: sphere((1, 2, 3)), r"a sphere's radius is a finite number, not \(1, 2, 3\)"),
        (lambda: sphere(rings=2.5), "a sphere's rings is a whole number above 0, not 2.5"),
        (lambda: torus(segments=0), "a torus's segments is a whole number above 0, not 0"),
        (lambda: torus(0), "the curve of a torus has a length above 0"),
        (lambda: knot(0, 0), "the curve of a knot has a length above 0"),
        (lambda: knot(2, 2.5), "a knot's q is a whole number, not 2.5"),
        (lambda: checkerboard(1, 2, (1, 1), (0, 0, 0)), "a checkerboard's light is three finite numbers"),
        (lambda: teapot(divisions=2.5), "a teapot's divisions is a whole number above 0, not 2.5"),
        (lambda: box().moved(scale=(1, 2, 3)), r"box: a scale is a finite number, not \(1, 2, 3\)"),
        (lambda: box().smoothed("flat"), "box: an angle is a finite number, not 'flat'"),
    ],
)
def test_wrong_numbers_of_a_shape_are_named(make, words):
    with pytest.raises(SceneError, match=words):
        make()


def test_shapes_may_be_flat_and_mirrored():
    flat = cylinder(0, 2)
    assert np.isfinite(flat.uv).all()
    assert not flat.vertices[:, ::2].any()
    np.testing.assert_array_equal(np.ptp(box(np.float32(2)).vertices, axis=0), [2, 2, 2])
    assert len(knot(-2, 3)) == len(knot(2, 3))


def test_pixels_in_rows_of_different_lengths_are_refused():
    for make in (Texture, EnvironmentLight):
        with pytest.raises(SceneError, match="rows of different lengths"):
            make([[0.5, 1.0], [0.5]])


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
        ("zero.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "line 4: a face names vertex 0; numbers begin at 1"),
        ("beyond.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n", "line 4: a face names vertex 7, and there are 3"),
        ("lines.obj", b"v 0 \\\n0 0\nv 1 \\\r\n0 0\nv 0 1 0\nf 1 \\\n2 7\n", "line 6: a face names vertex 7"),
        ("two.obj", b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "line 1: a vertex is not three finite numbers: 'v 0 0'"),
        ("word.obj", b"v 0 0 zero\nf 1 1 1\n", "line 1: a vertex is not three finite numbers"),
        ("letter.obj", b"v 0 0 0\nf a b c\n", "line 2: 'a' in a face is not an index"),
        ("far.obj", b"v 0 0 0\nv 3e38 0 0\nv 0 1 0\nf 1 2 3\n", "within 1e.36 of 0"),
        ("cut.stl", b"\0" * 80 + b"\x09\0\0\0" + b"\0" * 120, "declares 9 triangles and ends within number 3"),
        ("digits.obj", b"v 1_0 0 0\nf 1 1 1\n", "line 1: a vertex is not three finite numbers"),
        ("script.obj", "v \u0661 0 0\nf 1 1 1\n".encode(), "line 1: a vertex is not three finite numbers"),
        ("digits_too.obj", b"v 0 0 0\nf 1 1 0_1\n", "line 2: '0_1' in a face is not an index"),
        ("digits.off", b"OFF\n3 1 0\n1_0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "vertex 0: 1 vertex is not three finite"),
        (
            "digits_too.off",
            b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n0_3 0 1 2\n",
            "face 0: 1 face ends before its last number",
        ),
        ("bare.off", b"3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "it has no header: OFF, and then the numbers"),
        ("cut.off", b"OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "3 vertices and 2 faces, and 4 lines follow"),
        ("corners.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n4 0 1 2\n", "face 0: 1 face ends before its last number"),
        ("short.stl", b"\0" * 30, "ends within the header"),
        ("many.ply", PLY.replace("face 1", "face 1000000000").encode(), "at least 1,000,000,003 lines, not 4"),
        (
            "nan.obj",
            b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
            "line 1: a vertex is not three finite numbers: 'v nan 0 0'",
        ),
    ],
)
def test_bad_files_are_named(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(SceneError, match=words):
        Mesh.load(path, strict=True)


def test_an_stl_text_may_be_in_capitals(tmp_path):
    path = tmp_path / "part.stl"
    trimesh.Trimesh(box().vertices, box().faces).export(path, file_type="stl_ascii")
    path.write_text(path.read_text().upper())
    assert sorted(Mesh.load(path).corners.reshape(-1).tolist()) == sorted(box().corners.reshape(-1).tolist())


OFF = "OFF\n5 3 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n0.5 2 0\n"


@pytest.mark.parametrize(
    ("text", "triangles", "said"),
    [
        (OFF + "5 0 1 2 4 3\n4 0 1 2 3\n3 2 4 3\n", 6, []),
        (OFF.replace("\n", " ", 1) + "# none\n5 0 1 2 4 3\n\n3 0 1 4\n3 2 4 3 # one\n", 5, []),
        ("C" + OFF.replace(" 0\n", " 0 255 0 0 255\n") + "3 0 1 2\n" * 3, 3, ["colours of vertices (5)"]),
        (OFF + "3 0 1 2 0.5 0.5 0.5\n" * 2 + "3 0 2 3", 3, ["colours of faces (2)"]),
    ],
    ids=["polygons", "comments", "colours", "colours of faces"],
)
def test_an_off_file_has_faces_of_any_number_of_corners(tmp_path, text, triangles, said):
    path = tmp_path / "part.off"
    path.write_text(text)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mesh = Mesh.load(path)
    assert len(mesh) == triangles
    assert [str(warning.message) for warning in caught] == [f"part.off: ignored: {what}" for what in said]


def test_what_a_ply_file_holds_beyond_its_triangles_is_said(tmp_path):
    """trimesh would make a path of edges, for which it needs scipy."""
    path = tmp_path / "scan.ply"
    head = PLY[: PLY.index("end_header") + len("end_header\n")].replace(
        "property float z\n", "property float z\nproperty float confidence\n"
    )
    edges = "element edge 2\nproperty int vertex1\nproperty int vertex2\nend_header"
    path.write_text(head.replace("end_header", edges) + "0 0 0 1\n1 0 0 1\n0 1 0 1\n3 0 1 2 255 0 128\n0 1\n1 2\n")
    with pytest.warns(sh.ShpyWarning, match=r"ignored: confidence of each vertex \(3\), elements edge \(2\)$"):
        mesh = Mesh.load(path)
    assert mesh.corners.tolist() == [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no file .*gone\.obj"):
        Mesh.load(tmp_path / "gone.obj")
    with pytest.raises(IsADirectoryError, match=f"{tmp_path} is a folder: name a file in it"):
        Mesh.load(tmp_path)


@pytest.mark.parametrize("wrong", [{"reflectivity": 1.5}, {"diffuse": -1}, {"color": (1, 1)}, {"shininess": np.inf}])
def test_materials_refuse_what_makes_no_sense(wrong):
    with pytest.raises(SceneError):
        Material(**wrong)


@pytest.mark.parametrize(
    "content",
    [
        CUBE_OBJ.replace(" ", "\t").encode(),
        b"\xef\xbb\xbf" + CUBE_OBJ.encode(),
        ("\ufeff" + CUBE_OBJ).encode("utf-16-le"),
        b"# caf\xe9\n" + CUBE_OBJ.encode(),
        CUBE_OBJ.replace("3 4", "3 \\\n4").encode(),
        b"# C:\\models\\\n" + CUBE_OBJ.encode(),
        CUBE_OBJ.replace("\n", "\r\n").encode(),
        CUBE_OBJ.replace("1 2 3 4", "-4 -3 -2 -1").encode(),
    ],
    ids=["tabs", "byte-order mark", "UTF-16", "Latin-1", "continued", "a comment's backslash", "CRLF", "from the end"],
)
def test_an_obj_file_may_be_written_in_many_ways(tmp_path, content):
    path = tmp_path / "quad.obj"
    path.write_bytes(content)
    assert sorted(map(tuple, Mesh.load(path).corners.reshape(-1, 3).tolist()))[0] == (0, 0, 0)
    assert len(Mesh.load(path)) == 2


def test_ply_colours_of_faces_are_kept(tmp_path):
    path = tmp_path / "faces.ply"
    path.write_text(PLY)
    np.testing.assert_allclose(Mesh.load(path).colors, np.broadcast_to([1, 0, 0.21586], (1, 3, 3)), atol=1e-4)


@pytest.mark.parametrize("scale", [(0.01, 0.01, 0.01), (1, 1, 0), (0.01, 1, 1), (-1, 1, 1)])
def test_normals_of_a_scaled_node_have_length_one(tmp_path, scale):
    import trimesh

    ball = sphere(rings=6, segments=8)
    scene = trimesh.Scene()
    made = trimesh.Trimesh(ball.vertices, ball.faces, process=False)
    made.vertex_normals = ball.vertices
    scene.add_geometry(made, transform=np.diag([*scale, 1]))
    path = tmp_path / "ball.glb"
    path.write_bytes(scene.export(file_type="glb", include_normals=True))
    mesh = Mesh.load(path)
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=-1), 1, atol=1e-6)
    if 0 not in scale:
        assert np.einsum("ij,ikj->ik", mesh.face_normals, mesh.normals).min() > 0


def test_normals_are_kept_with_length_one():
    triangle = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    mesh = Mesh(triangle, [[0, 1, 2]], normals=[[0, 0, 1e-20], [0, 3, 4], [0, 0, 0]])
    np.testing.assert_allclose(mesh.normals[0], [[0, 0, 1], [0, 0.6, 0.8], [0, 0, 1]])


def fan(count, height):
    """Triangles about one vertex."""
    angle = 2 * np.pi * np.arange(count) / count
    rim = np.stack([np.cos(angle), np.zeros(count), np.sin(angle)], axis=1)
    k = np.arange(count)
    return Mesh(np.concatenate([[[0, height, 0]], rim]), np.stack([0 * k, 1 + (k + 1) % count, 1 + k], axis=1))


def means_of_near(mesh, below):
    """The normals that `smoothed` gives, corner by corner: the sums of the faces at its place in their order."""
    a, b, c = np.moveaxis(mesh.corners, 1, 0)
    weighted = np.cross(b - a, c - a)
    units = unit(weighted)
    at = {}
    for face, corners in enumerate(mesh.corners.tolist()):
        for place in corners:
            at.setdefault(tuple(np.add(place, 0.0)), []).append(face)
    found = np.zeros((len(mesh), 3, 3))
    for face, corners in enumerate(mesh.corners.tolist()):
        for k, place in enumerate(corners):
            some = at[tuple(np.add(place, 0.0))]
            own = np.repeat(units[[face]], len(some), axis=0)
            near = np.einsum("ij,ij->i", own, units[some]) > np.cos(np.radians(below))
            total = np.zeros(3)
            for other in np.asarray(some)[near]:
                total += weighted[other]
            found[face, k] = total
    normals = unit(found)
    normals = np.where(normals.any(axis=2, keepdims=True), normals, units[:, None])
    return np.where(normals.any(axis=2, keepdims=True), normals, mesh.face_normals[:, None])


@pytest.mark.parametrize("seed", range(40))
def test_smoothed_has_the_bits_of_sums_corner_by_corner(seed):
    """Smooth and sharp places, faces without area, opposite ones and tiny ones: the quick way and the pairs agree."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(4, 60))
    vertices = rng.normal(size=(count, 3)) * rng.choice([1e-170, 1, 1e30])
    vertices[:, 2] *= rng.choice([0, 0.1, 1])
    if seed % 3 == 0:
        vertices = np.rint(vertices / np.abs(vertices).max() * 3)  # several vertices at a place, and faces without area
    faces = [rng.permutation(count)[:3] for _ in range(int(rng.integers(1, 3 * count)))]
    mesh = Mesh(vertices, np.array(faces))
    for below in (45, float(rng.uniform(0, 180)), 180):
        np.testing.assert_array_equal(mesh.smoothed(below).normals, means_of_near(mesh, below))


def test_smoothed_takes_memory_in_proportion_to_the_mesh():
    """A fan and a cone of 100,000 triangles: less than 400 MB, where pairs of faces would be 160 GB."""
    for height in (0.0, 1.0):
        mesh = fan(100_000, height)
        tracemalloc.start()
        normals = mesh.smoothed().normals
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert most < 400e6
        np.testing.assert_allclose(normals[:, 1:], np.repeat(mesh.face_normals[:, None], 2, axis=1), atol=1e-3)


@pytest.mark.parametrize("count", [60, 600])
def test_smoothed_means_the_same_where_many_faces_meet(count):
    """At the tip of a cone the mean of those within 45 degrees, also where faces are taken in groups."""
    mesh = fan(count, 2.0)
    units = mesh.face_normals
    near = units @ units.T > np.cos(np.radians(45))
    expected = near @ units
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert np.einsum("ij,ij->i", mesh.smoothed().normals[:, 0], expected).min() > np.cos(np.radians(4))


def test_pictures_of_one_index_array_and_other_palettes_are_other_pictures():
    import trimesh
    from PIL import Image as pillow

    def textured(palette):
        image = pillow.fromarray(np.zeros((2, 2), np.uint8), "P")
        image.putpalette(palette)
        look = trimesh.visual.material.SimpleMaterial(image=image)
        visual = trimesh.visual.TextureVisuals(uv=[(0, 0), (1, 0), (0, 1)], material=look)
        return trimesh.Trimesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)], visual=visual, process=False)

    given = trimesh.Scene([textured(palette) for palette in ([255, 0, 0], [0, 0, 255], [255, 0, 0])])
    colors = [mesh.material.color for mesh in Scene([given]).meshes]
    assert [color.image[0, 0].tolist() for color in colors] == [[1, 0, 0], [0, 0, 1], [1, 0, 0]]


def test_the_solids_of_an_stl_file_have_their_names(tmp_path):
    corners = "vertex 0 0 {1}\nvertex 1 0 {1}\nvertex 0 1 {1}\n"
    solid = f"solid {{0}}\nfacet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\nendsolid\n"
    path = tmp_path / "parts.stl"
    path.write_text(solid.format("bolt", 0) + solid.format("nut", 1))
    assert [mesh.name for mesh in Scene.load(path, floor=False).meshes] == ["bolt", "nut"]
    path.write_text(solid.format("bolt", 0))
    assert [mesh.name for mesh in Scene.load(path, floor=False).meshes] == ["parts"]


@pytest.mark.parametrize("colored", [0, 3])
def test_the_attributes_of_an_stl_file_are_ignored_aloud(colored, tmp_path):
    """Magics and VisCAM write colours there."""
    path = tmp_path / "one.stl"
    made = trimesh.creation.icosahedron()
    made.export(path)
    data = bytearray(path.read_bytes())
    for number in range(colored):
        data[84 + 50 * number + 48] = 31
    path.write_bytes(data)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert len(Mesh.load(path)) == 20
    wanted = ["one.stl: ignored: attributes of triangles (3)"] if colored else []
    assert [str(w.message) for w in caught] == wanted
