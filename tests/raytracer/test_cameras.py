"""Cameras and the falloff of lights: where each eye ray goes, by formulas in f64."""

import dataclasses

import numpy as np
import pytest
from scene_pictures import BACKENDS, same

import shpy as sh
from raytracer import Camera, DirectionalLight, Material, PointLight, Renderer, Scene, SceneError, Surface, render
from raytracer.integrators.layers import BANDS
from raytracer.meshes.shapes import box, floor, sphere

AWRY = {"position": (1, 2, 5), "target": (0.5, 0.3, -1), "up": (0.1, 1, 0.2)}


def places(camera, meshes, size=(32, 24), backend="numpy"):
    """The point that each eye ray meets, (H, W, 3)."""
    shown = Material(surface=lambda hit: Surface(color=hit.position), specular=0)
    scene = Scene([mesh.with_material(shown) for mesh in meshes], (), camera, background=(np.pi, 0, 0), ambient=1.0)
    found = render(scene, size, backend=backend).pixels
    assert not (found[..., 0] == np.float32(np.pi)).any()
    return found


def wall(z):
    return floor(40).moved((0, 0, z), tilt=90)


@pytest.mark.parametrize("far", [1e150, 1e160, 1e300])
def test_directions_that_are_long_or_short_are_those_of_any_length(far):
    for camera in (Camera((0, 0, 5), (0, 0, -far), (0, far, 0)), Camera((0, 0, 1 / far), up=(0, 1 / far, 0))):
        np.testing.assert_array_equal(camera.axes, [[1, 0, 0], [0, 1, 0], [0, 0, -1]])


@pytest.mark.sampled(2)
@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize("given", [{"aperture": 1e30}, {"aperture": 0.1, "focus": 1e300}, {"span": 1e300}])
def test_lengths_of_a_camera_that_no_kernel_holds_are_told(given, precision):
    camera = Camera((0, 0, 5), projection="orthographic" if "span" in given else "perspective", **given)
    with pytest.raises(SceneError, match="the span, aperture or focus of the camera is too large"):
        render(Scene([sphere()], camera=camera), (4, 4), backend="numpy", precision=precision)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_a_camera_that_no_kernel_holds_is_told(precision):
    for far in (1e30, 1e160):
        with pytest.raises(SceneError, match=f"the camera at .*{far:g}.* is too far away".replace("+", r"\+")):
            render(Scene([sphere()], camera=Camera((0, 0, far))), (4, 4), backend="numpy", precision=precision)


def test_orthographic_rays_are_parallel():
    camera = Camera(**AWRY, projection="orthographic", span=3.0)
    found = places(camera, [wall(-4)])
    right, above, forward = camera.axes
    row, column = np.mgrid[:24, :32] + 0.5
    start = camera.position + (column[..., None] - 16) * right / 8 - (row[..., None] - 12) * above / 8
    far = (-4 - start[..., 2:]) / forward[2]
    np.testing.assert_allclose(found, start + far * forward, atol=1e-5)


def test_a_panorama_shows_all_directions():
    camera = Camera(**AWRY, projection="panorama")
    radius = 2.0
    found = places(camera, [sphere(radius, rings=24, segments=48).moved(AWRY["position"])], (32, 16))
    right, above, forward = camera.axes
    row, column = np.mgrid[:16, :32] + 0.5
    azimuth, height = 2 * np.pi * (column / 32 - 0.5), np.pi * (0.5 - row / 16)
    way = np.sin(azimuth)[..., None] * right + np.cos(azimuth)[..., None] * forward
    way = np.cos(height)[..., None] * way + np.sin(height)[..., None] * above
    ray = found - camera.position
    np.testing.assert_allclose(ray / np.linalg.norm(ray, axis=-1, keepdims=True), way, atol=2e-6)
    middle = way[7:9, 15:17].mean(axis=(0, 1))
    np.testing.assert_allclose(middle / np.linalg.norm(middle), forward, atol=1e-12)


@pytest.mark.slow
def test_what_is_in_focus_is_sharp_however_wide_the_lens():
    pinhole = Camera((0, 0, 5), (0, 0, 0), fov=50)
    lens = dataclasses.replace(pinhole, aperture=0.8)
    np.testing.assert_allclose(places(lens, [wall(0)]), places(pinhole, [wall(0)]), atol=1e-5)
    near = dataclasses.replace(lens, focus=3.0)
    np.testing.assert_allclose(places(near, [wall(2)]), places(pinhole, [wall(2)]), atol=1e-5)
    assert np.abs(places(near, [wall(0)]) - places(pinhole, [wall(0)])).max() > 0.1


@pytest.mark.parametrize(("distance", "focus", "aperture"), [(8.0, 4.0, 0.5), (2.0, 5.0, 0.3)])
def test_the_circle_of_confusion(distance, focus, aperture):
    """Its diameter is aperture |distance - focus| / focus, evenly filled (similar triangles)."""
    pinhole = Camera((0, 0, 0), (0, 0, -1), fov=40)
    lens = dataclasses.replace(pinhole, aperture=aperture, focus=focus)
    beside = (places(lens, [wall(-distance)], (96, 96)) - places(pinhole, [wall(-distance)], (96, 96)))[..., :2]
    radius = np.linalg.norm(beside, axis=-1)
    expected = aperture * abs(distance - focus) / focus / 2
    assert radius.max() <= expected * (1 + 1e-4)
    assert radius.max() >= expected * 0.99
    assert np.mean(radius**2) == pytest.approx(expected**2 / 2, rel=0.03)
    assert np.abs(beside.mean(axis=(0, 1))).max() < 0.02 * expected


def test_samples_go_through_other_points_of_the_lens():
    lens = Camera((0, 0, 5), (0, 0, 0), fov=50, aperture=0.5)
    scene = Scene([box(), wall(-3)], (DirectionalLight((0, 0, -1)),), lens)
    one, many = (render(scene, (24, 24), backend="numpy", samples=n).pixels for n in (1, 16))
    edge = np.abs(np.diff(many, axis=1)).max() / np.abs(np.diff(one, axis=1)).max()
    assert edge < 0.7


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("aspect", [0.25, 0.5, 1.0, 1.5, 4.0])
@pytest.mark.parametrize("size", [(64, 64), (96, 64), (64, 96), (256, 32), (32, 256)])
def test_a_picture_shows_the_whole_frame(projection, aspect, size):
    """The corners of the frame lie within the picture, and on its edges along one axis."""
    camera = Camera((0, 0, 5), fov=50, span=3, projection=projection, aspect=aspect)
    width, height = size
    given = camera.uniforms(width, height, np.zeros(3), 1.0)
    half = 1.5 if projection == "orthographic" else np.tan(np.radians(25))
    frame = half * np.array([max(aspect, 1), max(1 / aspect, 1)])
    shown = np.array([np.linalg.norm(given["across"]) * width, np.linalg.norm(given["down"]) * height]) / 2
    assert (shown >= frame * (1 - 1e-12)).all()
    assert np.isclose(shown, frame).any()
    assert np.linalg.norm(given["across"]) == pytest.approx(np.linalg.norm(given["down"]))


@pytest.mark.parametrize("aspect", [0, -1, float("nan"), float("inf"), "wide"])
def test_aspects_that_are_none(aspect):
    with pytest.raises(SceneError, match="a camera's aspect is "):
        Camera((0, 0, 5), aspect=aspect)


def test_a_calibrated_camera_projects_as_its_matrix_does():
    K = np.array([[50.0, 1.5, 20.0], [0, 45.0, 11.0], [0, 0, 1]])
    angle = np.radians(25)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    pose = np.eye(4)
    pose[:3, :3] = turn @ np.diag([1, -1, -1])
    pose[:3, 3] = 0.5, 1, 6
    for size in ((36, 24), (72, 48)):
        camera = Camera.from_intrinsics(K, pose, (36, 24))
        found = places(camera, [wall(-2)], size).astype(np.float64)
        seen = (found - pose[:3, 3]) @ pose[:3, :3] @ K.T
        row, column = np.mgrid[: size[1], : size[0]] + 0.5
        np.testing.assert_allclose(seen[..., 0] / seen[..., 2], column * 36 / size[0], atol=2e-4)
        np.testing.assert_allclose(seen[..., 1] / seen[..., 2], row * 24 / size[1], atol=2e-4)


def test_a_calibration_of_a_plain_camera_is_that_camera():
    plain = Camera((0, 0, 5), (0, 0, 0), fov=40)
    focal = 12 / np.tan(np.radians(20))
    pose = np.diag([1.0, -1, -1, 1])
    pose[2, 3] = 5
    made = Camera.from_intrinsics([[focal, 0, 16], [0, focal, 12], [0, 0, 1]], pose, (32, 24))
    np.testing.assert_allclose(places(made, [wall(-1)]), places(plain, [wall(-1)]), atol=1e-5)
    assert made.fov == pytest.approx(40)


CAMERAS = {
    "orthographic": Camera((1, 3, 5), projection="orthographic", span=4),
    "panorama": Camera((0.2, 1.5, 2.5), projection="panorama"),
    "lens": Camera((1, 3, 5), aperture=0.4),
}


def scene_of(camera):
    meshes = [
        sphere(1, Material(reflectivity=0.3), rings=8, segments=12),
        box().moved((1.5, 0, 0)),
        floor(8).moved((0, -1, 0)),
    ]
    return Scene(meshes, (PointLight((3, 5, 4), (20, 18, 15), falloff="square"),), camera)


@pytest.mark.slow
@pytest.mark.parametrize("name", CAMERAS)
def test_backends_bands_and_tracers_agree_to_the_last_bit(name, monkeypatch):
    scene = scene_of(CAMERAS[name])
    first = render(scene, (32, 20), backend="numpy", samples=4)
    assert len(np.unique(first.object_id)) >= 3
    for backend in BACKENDS[1:]:
        same(first, render(scene, (32, 20), backend=backend, samples=4))
    same(first, render(scene, (32, 20), backend="numpy", samples=4, tracer="staged"))
    monkeypatch.setitem(BANDS, "numpy", 300)
    same(first, render(scene, (32, 20), backend="numpy", samples=4))


def test_a_renderer_takes_cameras_of_every_kind():
    renderer = Renderer(scene_of(None), backend="numpy")
    cameras = (*CAMERAS.values(), Camera((1, 3, 5)))
    expected = [render(scene_of(camera), (16, 12), backend="numpy") for camera in cameras]
    for camera, picture in (*zip(cameras, expected, strict=True), *zip(CAMERAS.values(), expected, strict=False)):
        same(renderer.render((16, 12), camera=camera), picture)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("falloff", ["none", "square"])
@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (1e4, -3e4, 2e4)])
def test_a_plane_under_a_light_by_lamberts_law(falloff, at):
    light, color, size = np.array([0.7, 2.0, -0.4]), np.array([3.0, 2.0, 1.0]), 1e3 if any(at) else 1.0
    ground = floor(40 * size, Material((0.8, 0.5, 0.25), diffuse=0.9, specular=0)).moved(at)
    camera = Camera(tuple(size * np.array([2.0, 3, 4]) + at), at, fov=50)
    lights = (PointLight(tuple(size * light + at), tuple(color * (size**2 if falloff == "square" else 1)), falloff),)
    image = render(Scene([ground], lights, camera, ambient=0.0), (24, 16), backend="numpy")
    view = camera.view(24, 16)
    row, column = np.mgrid[:16, :24] + 0.5
    ray = view.corner + column[..., None] * view.across + row[..., None] * view.down
    eye = (camera.position - np.array(at)) / size
    place = eye - ray * (eye[1] / ray[..., 1:2])
    toward = light - place
    distance = np.linalg.norm(toward, axis=-1, keepdims=True)
    expected = 0.9 * np.array([0.8, 0.5, 0.25]) * color * (2 / distance) / (distance**2 if falloff == "square" else 1)
    ground_seen = (image.object_id == 0)[..., None] & (np.abs(place) < 19).all(axis=-1, keepdims=True)
    assert ground_seen.mean() > 0.5
    np.testing.assert_allclose(
        image.pixels[ground_seen[..., 0]], expected[ground_seen[..., 0]], rtol=3e-5 if any(at) else 1e-5
    )


def test_a_scene_without_falloff_has_none_of_its_code(monkeypatch):
    monkeypatch.setattr(sh.Program, "compile", lambda *_, **__: None)  # nothing is compiled
    bright = PointLight((3, 5, 4), falloff="square")
    plain, fading = (
        str(Renderer(Scene([box()], (light,)), backend="numpy").program.ir)
        for light in (dataclasses.replace(bright, falloff="none"), bright)
    )
    assert len(plain) < len(fading)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"projection": "fisheye"}, "perspective, orthographic, panorama, not 'fisheye'"),
        ({"position": 5}, "a camera's position is three finite numbers, not 5"),
        ({"target": (0, 0)}, r"a camera's target is three finite numbers, not \(0, 0\)"),
        ({"target": (0, 0, 10**400)}, "a camera's target is three finite numbers, not"),
        ({"fov": 10**400}, "a camera's fov is a number, not"),
        ({"up": "xyz"}, "a camera's up is three finite numbers, not 'xyz'"),
        ({"fov": "wide"}, "a camera's fov is a number, not 'wide'"),
        ({"aperture": None}, "a camera's aperture is a number, not None"),
        ({"span": 0}, "span"),
        ({"aperture": -1}, "aperture"),
        ({"focus": 0, "aperture": 1}, "focus"),
        ({"aperture": 1, "projection": "panorama"}, "an aperture is for a perspective camera"),
    ],
)
def test_cameras_that_are_none(given, message):
    with pytest.raises(SceneError, match=message):
        Camera(**{"position": (0, 0, 1)} | given)


@pytest.mark.parametrize(
    ("K", "pose", "message"),
    [
        (np.eye(4), np.eye(4), r"K is \(3, 3\)"),
        ([[1, 0, 0], [0, 1]], np.eye(4), "the numbers of K are rows of different lengths"),
        (np.zeros((3, 3)), np.eye(4), "positive fx and fy"),
        (np.eye(3), 2 * np.eye(4), "rotation"),
        (np.eye(3), np.diag([-1.0, 1, 1, 1]), "rotation"),
        (np.eye(3), np.full((4, 4), np.nan), "finite"),
    ],
)
def test_calibrations_that_are_none(K, pose, message):
    with pytest.raises(SceneError, match=message):
        Camera.from_intrinsics(K, pose, (8, 8))


@pytest.mark.parametrize("size", [8, (8,), "8x8", (0, 8), (8.5, 8), (8, float("inf")), (8, float("nan"))])
def test_sizes_of_a_calibration_that_are_none(size):
    with pytest.raises(SceneError, match=r"a size is \(width, height\) in whole pixels, not"):
        Camera.from_intrinsics(np.eye(3), np.eye(4), size)


def test_falloffs_that_are_none():
    with pytest.raises(SceneError, match="none, square, not 'linear'"):
        PointLight((0, 0, 0), falloff="linear")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PointLight(5), "a light's position is three finite numbers, not 5"),
        (lambda: PointLight((0, 0, 0), 0.5), r"a light's color is three finite numbers, not 0\.5"),
        (lambda: DirectionalLight(None), "a light's direction is three finite numbers, not None"),
        (lambda: Scene(background=["red"]), r"a background is three finite numbers, not \['red'\]"),
    ],
)
def test_what_is_no_place_or_colour_is_told(make, message):
    with pytest.raises(SceneError, match=message):
        make()
