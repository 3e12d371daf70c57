"""Pictures: right against the oracle, the same on every backend, with code only for what the scene requires."""

import dataclasses
import time
from functools import cache

import numpy as np
import pytest
from oracle import Picture
from scene_pictures import BACKENDS, LIGHTS, small

import shpy as sh
from raytracer import (
    Camera,
    LayeredCube,
    Material,
    Mesh,
    Path,
    PointLight,
    Renderer,
    Scene,
    SceneError,
    Staged,
    Whitted,
    render,
)
from raytracer.animation import animate
from raytracer.integrators.layers import BANDS
from raytracer.meshes.shapes import box, floor, icosahedron, sphere
from raytracer.scenes import SCENES


def near(pixels, other, shares=((1 / 255, 0.99), (0.02, 0.995))):
    """Most pixels agree; the others lie at edges, which f32 and f64 place differently."""
    difference = np.abs(np.clip(pixels, 0, 1) - np.clip(other, 0, 1)).max(axis=-1)
    for bound, share in shares:
        assert (difference <= bound).mean() >= share, (
            f"{(difference > bound).mean():.2%} differ by more than {bound:.4f}"
        )


@cache
def oracles(scene, width, height, bounces):
    """Return the oracle's picture of a scene."""
    return Picture(scene()).render(width, height, bounces)


@cache
def pictures(scene):
    """Return a scene, and pictures of it by numpy and one of the devices, which take turns; of `small` by both."""
    made, turn = scene(), [*SCENES.values()].index(scene) % 2 if scene in SCENES.values() else None
    devices = BACKENDS[1:] if turn is None else BACKENDS[1 + turn : 2 + turn]
    return made, [render(made, (48, 32), backend=backend, bounces=2) for backend in ("numpy", *devices)]


@pytest.mark.sampled(9)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("bounces", [0, 1, 3])
def test_the_picture_is_the_oracles(backend, bounces):
    scene = small()
    image = render(scene, (72, 48), backend=backend, bounces=bounces)
    near(image.pixels, oracles(small, 72, 48, bounces))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_boxes_is_the_oracles(backend):
    image = render(Scene.builtin("boxes"), (64, 64), backend=backend)
    near(image.pixels, oracles(SCENES["boxes"], 64, 64, 3))


@pytest.mark.sampled(8)
@pytest.mark.parametrize(
    "changes",
    [
        {"lights": ()},
        {"lights": LIGHTS[:1]},
        {"lights": LIGHTS[1:]},
        {"lights": (*LIGHTS, PointLight((-4, 3, 2), (0.2, 0.5, 0.2)))},
        {"ambient": 0.0, "background": (0, 0, 0)},
        {"meshes": [box()]},
        {"meshes": [sphere(rings=8, segments=12)], "lights": ()},
        {"meshes": [Mesh(box().vertices, box().faces, colors=box().vertices + 0.5), floor(9)]},
    ],
    ids=[
        "no light",
        "point",
        "direction",
        "three lights",
        "dark",
        "one flat mesh",
        "one smooth mesh",
        "vertex colours",
    ],
)
def test_what_a_scene_lacks_changes_nothing(changes):
    scene = small(**changes)
    near(render(scene, (48, 48), backend="numpy", bounces=2).pixels, Picture(scene).render(48, 48, 2))


def test_backends_agree_about_materials_to_the_last_bit():
    agree(SCENES["materials"])


@pytest.mark.sampled(12)
@pytest.mark.parametrize("scene", [small, *(scene for name, scene in SCENES.items() if name != "materials")])
def test_backends_agree_to_the_last_bit(scene):
    agree(scene)


def agree(scene):
    images = pictures(scene)[1]
    for other in images[1:]:
        for layer in ("pixels", "depth", "normal", "object_id", "rays"):
            np.testing.assert_array_equal(getattr(images[0], layer), getattr(other, layer))


def test_layers():
    scene = small()
    image = render(scene, (40, 30), backend="numpy")
    assert image.pixels.shape == (30, 40, 3)
    assert image.pixels.dtype == np.float32
    miss = image.object_id < 0
    assert miss.any()
    assert not miss.all()
    np.testing.assert_array_equal(np.isinf(image.depth), miss)
    np.testing.assert_allclose(np.linalg.norm(image.normal[~miss], axis=-1), 1, atol=1e-5)
    np.testing.assert_array_equal(image.pixels[miss], np.broadcast_to(np.float32(scene.background), (miss.sum(), 3)))
    assert set(np.unique(image.object_id)) == {-1, 0, 1, 2, 3}
    assert np.all(image.rays[miss] == 1)
    assert 6 < image.rays.max() <= 12  # at most four surfaces, each with two lights before it or behind
    assert image.stats.rays == image.rays.sum()


def test_the_seconds_of_the_stages_are_parts_of_those_that_passed():
    began = time.perf_counter()
    stats = render(small(), (8, 6), backend="numpy").stats
    passed = time.perf_counter() - began
    parts = (stats.build_seconds, stats.record_seconds, stats.compile_seconds, stats.seconds)
    assert min(parts) > 0
    assert sum(parts) <= 2 * passed  # the picture's seconds hold those of a kernel that it is the first to need


def test_rows_run_from_the_top_and_columns_from_the_left():
    scene = small(meshes=[box((0.5, 0.5, 0.5)).moved((1, 1, 0))], camera=Camera((0, 0, 6), fov=45))
    seen = np.argwhere(render(scene, (32, 32), backend="numpy").object_id == 0)
    assert seen[:, 0].max() < 16
    assert seen[:, 1].min() >= 16


def test_features_say_what_is_in_and_out():
    bare = Renderer(small(meshes=[box()], lights=()), backend="numpy")
    full = Renderer(small(), backend="numpy")
    assert bare.features["lights"] == 0
    assert bare.features["reflections"] == 0
    assert bare.features["smooth normals"] is False
    assert bare.features["materials"] == 1
    assert full.features["lights"] == 2
    assert full.features["smooth normals"] is True
    assert full.features["materials"] == 4
    levels = {"levels_of_triangles", "levels_of_leaves"}
    assert set(bare.program.tables) == {"triangles", "boxes", "first", "past", "leaves", "items", "materials", *levels}
    shaded = {"normals", "material_of", "object_of", "lights"}
    assert set(full.program.tables) == {*bare.program.tables, *shaded}
    assert "pow" not in str(bare.program.ir)
    assert "pow" in str(full.program.ir)
    loops = [str(r.program.ir).count("loop @") for r in (bare, full)]
    assert loops[1] == loops[0] + 1  # that of the bounces


def test_no_surface_shadows_itself():
    """A ball and floor under a light right above: nothing facing the light is dark, wherever the scene stands."""
    for scale, offset in ((1, (0, 0, 0)), (1e3, (0, 0, 0)), (1e-3, (0, 0, 0)), (1, (100, 0, 50))):
        ball = sphere(1.0, Material((1, 1, 1), diffuse=1, specular=0), rings=64, segments=128).moved(
            offset, scale=scale
        )
        place = np.array(offset) + np.array([0, 60, 0]) * scale
        eye = np.array(offset) + np.array([0, 6, 0.1]) * scale
        camera = Camera(tuple(eye), offset, fov=12)
        scene = Scene([ball], [PointLight(tuple(place))], camera, ambient=0)
        image = render(scene, (64, 64), backend="numpy", bounces=0)
        lit = image.normal[..., 1] > 0.2
        assert lit.sum() > 1000
        assert image.pixels[lit].min() > 0.15


def test_a_mirror_shows_what_is_behind_the_viewer():
    mirror = floor(4, Material((1, 1, 1), diffuse=0, specular=0, reflectivity=1)).moved(tilt=90)
    red = floor(40, Material((1, 0, 0))).moved((0, 0, 10), tilt=-90)
    scene = Scene([mirror, red], camera=Camera((0, 0, 3), fov=30), background=(0, 0, 1), ambient=1)
    pixels = render(scene, (16, 16), backend="numpy", bounces=1).pixels
    np.testing.assert_allclose(pixels, np.broadcast_to([1, 0, 0], (16, 16, 3)), atol=1e-6)


def test_no_shadow_ray_starts_from_a_perfect_mirror():
    dark = floor(4, Material((1, 1, 1), diffuse=0, specular=0, reflectivity=1))
    light = (PointLight((0, 3, 0)),)
    for material, rays in ((dark.material, 2), (dataclasses.replace(dark.material, specular=0.1), 3)):
        scene = Scene([dark.with_material(material), box().moved((50, 0, 0))], light, Camera((0, 2, 0.1), fov=30))
        image = render(scene, (8, 8), backend="numpy", bounces=1)
        assert np.all(image.object_id == 0)
        assert np.all(image.rays == rays)
        np.testing.assert_array_equal(image.pixels[0, 0], np.float32(scene.background))


def test_samples_are_averages():
    scene = small()
    fine = render(scene, (64, 48), backend="numpy", bounces=1)
    coarse = render(scene, (32, 24), backend="numpy", bounces=1, samples=4)
    np.testing.assert_allclose(coarse.pixels, fine.pixels.reshape(24, 2, 32, 2, 3).mean(axis=(1, 3)), atol=1e-6)
    assert coarse.rays.sum() == fine.rays.sum()


def test_a_renderer_serves_sizes_and_cameras():
    scene = small()
    renderer = Renderer(scene, backend="numpy", bounces=1)
    again = renderer.render((20, 10), camera=Camera((5, 3, 0), (0, 1, 0)))
    moved = Scene(scene.meshes, scene.lights, Camera((5, 3, 0), (0, 1, 0)))
    np.testing.assert_array_equal(again.pixels, render(moved, (20, 10), backend="numpy", bounces=1).pixels)
    assert renderer.render((8, 8)).pixels.shape == (8, 8, 3)


def test_an_empty_scene_is_background():
    for meshes in ([], [Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))]):
        image = render(Scene(meshes, LIGHTS, background=(0.1, 0.2, 0.3)), (5, 4), backend="numpy")
        np.testing.assert_array_equal(image.pixels, np.broadcast_to(np.float32([0.1, 0.2, 0.3]), (4, 5, 3)))
        assert np.all(image.object_id == -1)


def test_progress_counts_rows(monkeypatch):
    monkeypatch.setitem(BANDS, "numpy", 64)
    seen = []
    whole = render(small(), (16, 10), backend="numpy", progress=lambda *rows: seen.append(rows))
    assert seen == [(4, 10), (8, 10), (10, 10)]
    monkeypatch.undo()
    np.testing.assert_array_equal(whole.pixels, render(small(), (16, 10), backend="numpy").pixels)


@pytest.mark.parametrize("size", [(0, 5), (5, -1), (5,), 5, (5.5, 4), ("a", 4), (99999, 2), (np.nan, 3)])
def test_sizes_that_make_no_picture(size):
    with pytest.raises(SceneError, match=r"size|pixels"):
        render(small(), size, backend="numpy")


@pytest.mark.parametrize("wrong", [{"bounces": -1}, {"bounces": 1.5}, {"samples": 3}, {"samples": 0}])
def test_numbers_that_make_no_picture(wrong):
    with pytest.raises(SceneError, match=next(iter(wrong))):
        render(small(), (4, 4), backend="numpy", **wrong)


def test_numbers_of_numpy_are_numbers(tmp_path):
    given = Whitted(bounces=np.int64(2), samples=np.uint8(4), accel="grid", grid=np.int32(3))
    assert given == Whitted(bounces=2, samples=4, accel="grid", grid=3)
    assert repr(Path(seed=np.int64(7))) == repr(Path(seed=7))
    assert Staged(threshold=np.float32(0.5)) == Staged(threshold=0.5)
    cube = LayeredCube.of(box(), np.int64(8), np.int32(4), "numpy", "sample", tolerance=np.float32(0.5))
    assert cube.options == LayeredCube.of(box(), 8, 4, "numpy", "sample", tolerance=0.5).options
    assert len(list(animate(lambda time: small(), tmp_path / "a.gif", np.int64(1), size=(4, 4), backend="numpy"))) == 1


def test_unknown_backend():
    with pytest.raises(sh.BackendUnavailable, match="vulkan"):
        render(small(), (4, 4), backend="vulkan")


def test_unknown_scene_names_the_known():
    with pytest.raises(SceneError, match="boxes, cubes, mirror-box, mixed"):
        Scene.builtin("teapots")


@pytest.mark.sampled(12)
@pytest.mark.parametrize(
    ("name", "triangles"),
    [
        ("boxes", 36), ("cubes", 2064), ("mirror-box", 4558), ("mixed", 61_562), ("spheres", 72_066), ("glass", 21_230),
        ("materials", 71_454), ("teapot", 61_324), ("chrome", 69_442), ("two-teapots", 28_562),
    ],
)  # fmt: skip
def test_built_in_scenes(name, triangles):
    scene, images = pictures(SCENES[name])
    assert scene.triangles == triangles
    for image in images:
        assert np.all(np.isfinite(image.pixels))
        assert len(np.unique(image.object_id)) > 3


def test_a_bare_mesh_is_framed():
    scene = Scene.framed(icosahedron(5).moved((100, 7, -3)))
    image = render(scene, (32, 32), backend="numpy")
    seen = np.argwhere(image.object_id == 0)
    assert len(seen) > 150
    assert seen.min() > 0
    assert seen.max() < 31


@pytest.mark.parametrize(
    "wrong", [{"fov": 0}, {"fov": 180}, {"up": (0, 0, 1)}, {"target": (0, 0, 5)}, {"position": (0, np.nan, 5)}]
)
def test_cameras_that_see_nothing(wrong):
    with pytest.raises(SceneError):
        Camera(**({"position": (0, 0, 5)} | wrong))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("length", [1e-20, 0.01, 100.0, 1e20])
def test_normals_of_any_length_give_the_same_light(length):
    """As those of a node that is scaled in a GLB file."""
    ball = sphere(1.0, rings=12, segments=24)
    longer = Mesh(ball.vertices, ball.faces, ball.normals * length)
    one, other = (render(small(meshes=[mesh]), (24, 24), backend="numpy", bounces=0) for mesh in (ball, longer))
    np.testing.assert_allclose(other.pixels, one.pixels, atol=1e-5)


def test_where_a_normal_is_zero_the_triangle_has_its_own():
    ball = sphere(1.0, rings=12, segments=24)
    flat = dataclasses.replace(ball, normals=None)
    zero = Mesh(ball.vertices, ball.faces, np.zeros_like(ball.vertices))
    one, other = (render(small(meshes=[mesh]), (24, 24), backend="numpy", bounces=0) for mesh in (flat, zero))
    np.testing.assert_allclose(other.pixels, one.pixels, atol=1e-5)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("scale", [1e-30, 1e-18, 1e-9, 1e12, 1e18, 1e30])
def test_extreme_scales_change_no_picture(scale):
    """A power of two beside the scale: the very pixels, ids and normals, and the depth times the scale."""
    scale = 2.0 ** round(np.log2(scale))
    meshes = [sphere(1.0, rings=8, segments=12), box().moved((1.5, 0, 0.5)), floor(9).moved((0, -1, 0))]
    one, other = (
        render(Scene([mesh.moved(scale=s) for mesh in meshes]), (32, 24), backend="numpy", bounces=0)
        for s in (1.0, scale)
    )
    assert len(np.unique(one.object_id)) == 4
    np.testing.assert_array_equal(other.object_id, one.object_id)
    np.testing.assert_array_equal(other.depth, (one.depth.astype(float) * scale).astype(np.float32))
    np.testing.assert_allclose(other.pixels, one.pixels, atol=1e-6)


def test_depth_beside_a_huge_triangle_is_that_of_the_plane():
    """Floors of a million million, across and tilted, seen from a height of 2, and a ball of 1 on them."""
    for tilt in (0, 30):
        ground = floor(1e12).moved(tilt=tilt)
        ball = sphere(1.0, rings=8, segments=12).moved((0, 1, 0))
        camera = Camera((0, 6, 9), (0, 0, 0), fov=50)
        image = render(Scene([ground, ball], LIGHTS, camera), (24, 24), backend="numpy", bounces=0)
        view = camera.view(24, 24)
        rows, columns = np.mgrid[:24, :24][..., None] + 0.5
        rays = view.corner + columns * view.across + rows * view.down
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        normal = ground.face_normals[0]
        exact = -(view.eye @ normal) / (rays @ normal)
        seen = image.object_id == 0
        assert seen.sum() > 100
        np.testing.assert_allclose(image.depth[seen], exact[seen], rtol=1e-5)
        assert (image.object_id == 1).sum() > 10


def test_a_tiny_ball_is_seen_where_it_is():
    """Rays that pass far beside triangles of 1e-5 do not meet them, whatever finds triangles."""
    scene = Scene([sphere(1e-5, rings=8, segments=12)], camera=Camera((0, 0, 8), fov=40))
    for accel in ("brute", "bvh", "grid"):
        image = render(scene, (64, 48), backend="numpy", bounces=0, accel=accel)
        assert (image.object_id >= 0).sum() <= 1


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["numpy", "glsl"])
@pytest.mark.parametrize("name", ["mirror-box", "glass"])
def test_relaxed_pictures_are_nearly_the_strict_ones(name, backend):
    """Assert that no channel of 99.9 % of the pixels is off by more than 1/255."""
    strict, relaxed = (
        Renderer(Scene.builtin(name), backend=backend, math=math).render((80, 60)) for math in ("strict", "relaxed")
    )
    assert (np.abs(strict.pixels - relaxed.pixels).max(axis=-1) <= 1 / 255).mean() >= 0.999
