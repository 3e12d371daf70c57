"""Materials beside other features: precisions, lenses, cubes, G-buffers, spots behind glass, stages, animations."""

import dataclasses

import numpy as np
import pytest
from PIL import Image as pillow
from scene_pictures import CAMERA

from raytracer import (
    Camera,
    EnvironmentLight,
    GBuffer,
    LayeredCube,
    Material,
    MetallicRoughness,
    Path,
    PointLight,
    Renderer,
    Scene,
    SpotLight,
    Staged,
    Texture,
    Unlit,
    Whitted,
    render,
)
from raytracer.animation import animate
from raytracer.meshes.shapes import box, floor, sphere

SHARP = MetallicRoughness((0.9, 0.8, 0.7), metallic=1, roughness=0, clearcoat=0.5)
VELVET = MetallicRoughness((0.3, 0.02, 0.05), roughness=0.9, sheen_color=(0.9, 0.4, 0.5), sheen_roughness=0.4)
LOOKS = {
    "sharp": SHARP,
    "velvet": VELVET,
    "brushed": dataclasses.replace(SHARP, clearcoat=0, roughness=0.1, anisotropy=0.5, multiscatter=True),
    "unlit": Unlit((0.2, 0.4, 0.6)),
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", LOOKS)
def test_precisions_show_the_same_light(name):
    """From above, where a lamp at the eye makes the middle of a sharp metal as bright as binary16 can tell."""
    scene = Scene([floor(4, LOOKS[name])], [PointLight((0, 3, 0))], Camera((0, 3, 0.01), (0, 0, 0), fov=20))
    half, single, double = (
        render(scene, (9, 9), integrator=Whitted(precision=p, bounces=1), backend="numpy").pixels.astype(np.float64)
        for p in ("f16", "f32", "f64")
    )
    np.testing.assert_allclose(single, double, rtol=2e-4, atol=1e-6)
    assert np.isfinite(half).all()
    assert abs(half - double).max() <= 0.03 * double.max()


def ball_over(alpha, **changes):
    look = MetallicRoughness((0.8, 0.3, 0.2), alpha=alpha, roughness=0.6)
    return Scene([sphere(0.5, look, rings=8, segments=12).moved((0, 0.5, 0))], **{"camera": CAMERA, **changes})


@pytest.mark.slow
@pytest.mark.parametrize("integrator", [Path(samples=64), Whitted(samples=16)], ids=["Path", "Whitted"])
def test_alpha_through_a_lens_is_softer(integrator):
    """Out of focus more pixels are neither there nor not; light over a background is the opaque picture."""
    partial = []
    for aperture in (0.0, 0.6):
        camera = dataclasses.replace(CAMERA, aperture=aperture, focus=2.0)
        scene = ball_over(1.0, camera=camera, lights=[PointLight((2, 4, 3))])
        image = render(scene, (16, 12), integrator=integrator, backend="opencl", transparent=True)
        partial.append(((image.alpha > 0) & (image.alpha < 1)).sum())
        opaque = render(scene, (16, 12), integrator=integrator, backend="opencl")
        over = image.pixels + (1 - image.alpha[..., None]) * np.float32(scene.background)
        np.testing.assert_allclose(over, opaque.pixels, atol=1e-5)
    assert partial[1] > partial[0] * (1.5 if isinstance(integrator, Path) else 1)


@pytest.mark.slow
def test_alpha_beside_cubes_and_g_buffers():
    scene = Scene(
        [sphere(0.5, VELVET, rings=8, segments=12).moved((0, 0.5, 0)), floor(1.5)], [PointLight((2, 4, 3))], CAMERA
    )
    cube = LayeredCube.of(scene, resolution=32, backend="numpy")
    eyes = render(scene, (16, 12), backend="numpy", transparent=True)
    secondary = render(scene, (16, 12), integrator=Whitted(secondary=cube), backend="numpy", transparent=True)
    np.testing.assert_array_equal(secondary.alpha, eyes.alpha)
    seen = GBuffer(places(eyes), eyes.normal, eyes.object_id)
    buffered = render(scene, primary=seen, backend="numpy", transparent=True)
    np.testing.assert_array_equal(buffered.alpha, (eyes.object_id >= 0).astype(np.float32))
    np.testing.assert_allclose(buffered.pixels, eyes.pixels, atol=0.02)


@pytest.mark.slow
def test_an_environment_lights_surfaces_that_rays_find_in_cubes():
    """Mirrored rays find the same surfaces in a cube, but for its approximation, and the same light around it."""
    light = np.linspace(0.2, 1.5, 8 * 16 * 3, dtype=np.float32).reshape(8, 16, 3)
    meshes = [box((1, 1, 1), SHARP).moved((0, 0.5, 0), turn=30), floor(1.5, VELVET)]
    scene = Scene(meshes, [EnvironmentLight(Texture(light, srgb=False))], CAMERA)
    exact, shown = (render(scene, (48, 36), accel=accel, backend="opencl") for accel in ("bvh", "ldc:128"))
    assert exact.stats.rays > 48 * 36
    assert np.mean(abs(shown.pixels - exact.pixels).max(axis=2) < 0.02) > 0.99


def places(image):
    """Return where the eye rays of an image met a surface, (H, W, 3)."""
    height, width = image.depth.shape
    half = np.tan(np.radians(CAMERA.fov) / 2)
    y, x = (np.mgrid[:height, :width] + 0.5) * (2 / height)
    forward = np.subtract(CAMERA.target, CAMERA.position)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, (0, 1, 0))
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    rays = forward + half * ((x - width / height)[..., None] * right + (1 - y)[..., None] * up)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return np.asarray(CAMERA.position) + np.where(image.object_id >= 0, image.depth, 0)[..., None] * rays


@pytest.mark.slow
@pytest.mark.parametrize("integrator", [Whitted(), Path(samples=32, bounces=1)], ids=["Whitted", "Path"])
def test_spots_shine_through_clear_walls_within_their_cone(integrator):
    """A spot through a pane of half the light: half as bright inside of the cone, and dark outside."""
    ground = floor(20, Material((1, 1, 1), diffuse=1, specular=0))
    pane = MetallicRoughness((0.5, 0.5, 0.5), specular=0, roughness=0, transmission=1)
    spot = SpotLight((0, 3, 0), (0, -1, 0), 10, 15)
    middles = []
    for meshes in ([ground], [ground, floor(6, pane).moved((0, 1, 0))]):
        scene = Scene(meshes, [spot], Camera((3, 0.6, 0), (0, 0, 0), fov=6), ambient=0)
        middles.append(render(scene, (5, 5), integrator=integrator, backend="numpy").pixels[2, 2].mean())
        aside = dataclasses.replace(scene, camera=Camera((3, 0.6, 1.5), (0, 0, 1.5), fov=6))
        assert render(aside, (5, 5), integrator=integrator, backend="numpy").pixels[2, 2].max() == 0
    assert middles[1] == pytest.approx(middles[0] / 2, rel=0.01)
    assert middles[0] > 0.1


@pytest.mark.slow
def test_layered_materials_move_through_stages_and_animations(tmp_path):
    """Frames of an animation are the pictures of its scenes, staged or not."""
    stripes = Texture(np.float32([[[0.1] * 3, [0.9] * 3]]), srgb=False)

    def at(time):
        brushed = dataclasses.replace(LOOKS["brushed"], roughness=stripes)
        cube = box((0.8, 0.8, 0.8), brushed).moved((0.3 * time, 0.4, 0), turn=30 * time)
        return Scene([cube, floor(4, VELVET)], [PointLight((2, 4, 3))], CAMERA)

    for integrator in (Staged(), Whitted()):
        folder = tmp_path / type(integrator).__name__
        assert len(list(animate(at, folder, 2, fps=1, size=(16, 12), integrator=integrator, backend="numpy"))) == 2
        files = sorted(folder.iterdir())
        for k, file in enumerate(files):
            expected = render(at(float(k)), (16, 12), integrator=Whitted(accel="grid"), backend="numpy").srgb
            np.testing.assert_allclose(np.asarray(pillow.open(file)).astype(int), expected, atol=1)
    renderer = Renderer(at(0.0), integrator=Staged(), backend="numpy")
    renderer.render((16, 12))
    renderer.show(at(1.0))
    moved = renderer.render((16, 12)).pixels
    np.testing.assert_array_equal(moved, render(at(1.0), (16, 12), integrator=Staged(), backend="numpy").pixels)
