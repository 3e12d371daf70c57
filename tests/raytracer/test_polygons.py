"""Faces of files as triangles: concave ones, holes with a bridge, faces that are not quite planar."""

import numpy as np
import pytest

import shpy as sh
from raytracer import Mesh
from raytracer.meshes import polygons
from raytracer.meshes.polygons import triangulated

ELL = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
DART = [(0, 0), (1, 0.5), (2, 0), (1, 2)]
FRAME = [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)]
BOW = [(0, 0), (1, 1), (1, 0), (0, 1)]
SHAPES = {"an L": (ELL, 3), "a dart": (DART, 1.5), "a frame with a bridge": (FRAME, 12)}


def area_of(corners):
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2


def turned(outline, seed):
    """Place a flat outline at random in space, beginning at a random corner; give its normal."""
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    outline = np.roll(outline, int(rng.integers(len(outline))), axis=0)
    return np.column_stack([outline, np.zeros(len(outline))]) @ turn.T + rng.normal(size=3), turn[:, 2]


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("name", SHAPES)
def test_the_triangles_of_a_face_have_its_area_and_face_its_way(name, seed):
    outline, area = SHAPES[name]
    if name == "a frame with a bridge" and seed:
        outline = outline[:-1] + [outline[-1]]
    places, normal = turned(outline[::-1] if seed % 2 else outline, seed)
    normal = -normal if seed % 2 else normal
    found = triangulated(places, np.arange(len(places)), np.array([len(places)]))
    areas = area_of(places[found.corners])
    np.testing.assert_allclose(areas @ normal, np.linalg.norm(areas, axis=1), atol=1e-12)
    assert np.linalg.norm(areas, axis=1).sum() == pytest.approx(area, rel=1e-12)
    assert not found.crossed


def test_faces_of_many_kinds_keep_their_order():
    outlines = [ELL, DART, BOW, FRAME, ELL[:3], DART[:2], ELL[:4]]
    places = np.column_stack([np.concatenate(outlines), np.zeros(sum(map(len, outlines)))])
    found = triangulated(places, np.arange(len(places)), np.array(list(map(len, outlines))))
    areas = np.bincount(found.faces, np.linalg.norm(area_of(places[found.corners]), axis=1), len(outlines))
    np.testing.assert_allclose(areas, [3, 1.5, 1, 12, 1, 0, 1.5])
    assert (np.diff(found.faces) >= 0).all()
    assert found.crossed == 1  # the bow tie


def test_a_face_that_is_not_quite_planar_is_cut_as_its_shadow():
    rng = np.random.default_rng(3)
    places = np.column_stack([ELL, rng.normal(size=len(ELL)) * 0.05])
    found = triangulated(places, np.arange(6), np.array([6]))
    flat = area_of(places[found.corners] * (1, 1, 0))
    assert flat[:, 2].min() >= 0
    assert flat[:, 2].sum() == pytest.approx(3)


def test_convex_faces_keep_the_fan_about_their_first_corner():
    for count in range(3, 9):
        angle = 2 * np.pi * np.arange(count) / count
        places = np.stack([np.cos(angle), np.sin(angle), 0.2 * np.cos(3 * angle)], axis=1)
        found = triangulated(places, np.arange(count), np.array([count]))
        assert found.corners.tolist() == [[0, k, k + 1] for k in range(1, count - 1)]


def test_large_faces_that_are_not_convex_are_left_out(tmp_path, monkeypatch):
    monkeypatch.setattr(polygons, "MOST_CORNERS", 5)
    path = tmp_path / "ell.obj"
    path.write_text("".join(f"v {x} {y} 0\n" for x, y in ELL) + "f 2 3 4 5 6 1\nf 1 2 3\n")
    with pytest.warns(sh.ShpyWarning, match="1 face is not convex and has more than .* corners .in line 7."):
        assert len(Mesh.load(path)) == 1


def written(kind, outline):
    """A file with one face."""
    count, places = len(outline), [f"{x} {y} 0" for x, y in outline]
    corners = " ".join(map(str, range(count)))
    if kind == "obj":
        return "".join(f"v {place}\n" for place in places) + f"f {' '.join(str(k + 1) for k in range(count))}\n"
    if kind == "off":
        return "\n".join(["OFF", f"{count} 1 0", *places, f"{count} {corners}", ""])
    head = f"ply\nformat ascii 1.0\nelement vertex {count}\n" + "".join(f"property float {a}\n" for a in "xyz")
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    return head + "\n".join([*places, f"{count} {corners}", ""])


@pytest.mark.parametrize("kind", ["obj", "off", "ply"])
@pytest.mark.parametrize("name", SHAPES)
def test_files_with_faces_that_are_not_convex(tmp_path, kind, name):
    outline, area = SHAPES[name]
    path = tmp_path / f"one.{kind}"
    path.write_text(written(kind, outline))
    assert np.linalg.norm(area_of(Mesh.load(path).corners), axis=1).sum() == pytest.approx(area)
