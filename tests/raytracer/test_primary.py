"""Pictures whose primary visibility comes from a rasteriser: what they share with traced ones, and what is refused."""

import dataclasses
import re

import numpy as np
import pytest

import shpy as sh
from raytracer import (
    Camera,
    GBuffer,
    Hit,
    Instance,
    Intersector,
    Material,
    Mesh,
    Path,
    PointLight,
    Renderer,
    Scene,
    SceneError,
    Staged,
    Surface,
    Texture,
    Whitted,
    render,
)
from raytracer.meshes.shapes import box, floor, icosahedron, sphere

SIZE = (40, 30)
BOXES = Scene.builtin("boxes")


def seen(scene, size=SIZE, **changes):
    """The G-buffer that an exact rasteriser would draw: the points at the depths of a traced picture."""
    image = render(scene, size, backend="numpy")
    eye, corner, across, down = scene.camera.view(*size)
    row, column = np.indices(size[::-1])[..., None] + 0.5
    ray = corner + column * across + row * down
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        position = eye + ray * image.depth[..., None]
    arrays = {"position": position, "normal": image.normal, "object": image.object_id}
    return GBuffer(**(arrays | changes))


def is_edge(pixels):
    """Pixels of which one of the eight neighbours differs by more than 1/50."""
    around = np.pad(pixels, ((1, 1), (1, 1), (0, 0)), mode="edge")
    h, w, _ = pixels.shape
    neighbours = [around[i : i + h, j : j + w] for i in range(3) for j in range(3)]
    return np.max([np.abs(n - pixels).max(axis=-1) for n in neighbours], axis=0) > 0.02


def check_like(shown, traced, bound):
    """A ray starts up to 2**-13 of the eye's distance beside the traced one, so light changes little but at edges."""
    differs = np.abs(shown.pixels - traced.pixels).max(axis=-1) > bound
    assert np.all(is_edge(traced.pixels)[differs])
    assert differs.mean() < 0.01
    np.testing.assert_array_equal(shown.object_id, traced.object_id)
    met = traced.object_id >= 0
    np.testing.assert_allclose(shown.depth[met], traced.depth[met], rtol=1e-6)
    assert np.all(np.isinf(shown.depth[~met]))
    np.testing.assert_allclose(shown.normal, traced.normal, atol=1e-6)


@pytest.fixture(scope="module")
def boxes():
    return seen(BOXES)


@pytest.mark.slow
def test_the_picture_is_the_traced_one_on_every_backend(boxes):
    traced = render(BOXES, SIZE, backend="numpy")
    shown = [render(BOXES, primary=boxes, backend=backend) for backend in ("numpy", "opencl", "glsl")]
    check_like(shown[0], traced, 2e-4)
    for other in shown[1:]:
        np.testing.assert_array_equal(shown[0].pixels, other.pixels)
        np.testing.assert_array_equal(shown[0].depth, other.depth)
    met = traced.object_id >= 0
    assert 0.2 < met.mean() < 0.9
    np.testing.assert_array_equal(shown[0].pixels[~met], traced.pixels[~met])
    assert shown[0].stats.rays < traced.stats.rays - met.size * 0.99  # no eye rays


def stripes(hit: Hit) -> Surface:
    bright = sh.fract(3 * hit.uv.x) < 0.5
    return Surface(color=sh.cond(bright, sh.Color3f(0.9), sh.Color3f(0.2)), reflectivity=0.1 * hit.position.y)


@pytest.fixture(scope="module")
def painted():
    """Textures, programs, emission, mirrors and a smooth ball, without an accelerator's help."""
    picture = Texture(np.random.default_rng(1).random((4, 4, 3)), filter="nearest")
    meshes = [
        box((1.5, 1, 1), Material(surface=stripes)).moved((-1.2, 0.5, 0), turn=20),
        floor(8, Material(color=picture, reflectivity=0.3, specular=0.0)),
        box((0.4, 0.4, 0.4), Material((0.2, 0.2, 0.2), emission=(0.5, 0.4, 0.1))).moved((1, 0.2, 1)),
        sphere(0.7, Material((0.5, 0.6, 0.7), reflectivity=0.5), rings=12, segments=18).moved((0.9, 0.7, -0.5)),
    ]
    return Scene(meshes, [PointLight((3, 6, 4))], Camera((1, 3, 6), (0, 0.5, 0)))


@pytest.mark.slow
def test_materials_are_those_of_the_scene(painted):
    traced, flat = render(painted, SIZE, backend="numpy"), dataclasses.replace(painted, meshes=painted.meshes[:3])
    _, uv = uv_of(painted, SIZE)
    shown = render(painted, primary=seen(painted, uv=uv), backend="numpy")
    np.testing.assert_array_equal(shown.object_id, traced.object_id)
    assert set(np.unique(traced.object_id)) == {-1, 0, 1, 2, 3}
    smooth = traced.object_id == 3  # where a ray starts beside the curved surface, mirrored rays differ a little
    differs = np.abs(shown.pixels - traced.pixels).max(axis=-1) > 2e-3
    assert np.all(is_edge(traced.pixels)[differs & ~smooth])
    assert differs[~smooth].mean() < 0.01
    check_like(
        render(flat, primary=seen(flat, uv=uv_of(flat, SIZE)[1]), backend="numpy"),
        render(flat, SIZE, backend="numpy"),
        2e-3,
    )


def uv_of(scene, size):
    """The points and uv coordinates of the surfaces that the camera sees, by an Intersector."""
    eye, corner, across, down = scene.camera.view(*size)
    row, column = np.indices(size[::-1])[..., None] + 0.5
    near = Intersector(scene, backend="numpy")
    hits = near.intersect(np.broadcast_to(eye, (*size[::-1], 3)), corner + column * across + row * down)
    uvs = np.concatenate([np.zeros((len(m), 3, 2)) if m.uv is None else m.uv for m in scene.meshes])[hits.triangle]
    weights = np.stack([1 - hits.u - hits.v, hits.u, hits.v], axis=-1)[..., None]
    return near.points(hits), (weights * uvs).sum(axis=-2)


@pytest.mark.slow
def test_it_goes_with_every_accelerator_and_with_moved_objects(boxes):
    plain = render(BOXES, primary=boxes, backend="numpy").pixels
    cube = render(BOXES, primary=boxes, accel="ldc:64:triangle", backend="numpy").pixels
    np.testing.assert_array_equal(cube, plain)
    renderer = Renderer(BOXES, backend="numpy")
    turn = np.array([[0, 0, 1, 0.5], [0, 1, 0, 0], [-1, 0, 0, 0.2], [0, 0, 0, 1]])
    renderer.move(2, turn)
    there = Scene([*BOXES.meshes[:2], BOXES.meshes[2].transformed(turn)], BOXES.lights, BOXES.camera, BOXES.background)
    buffer = seen(there)
    shown = renderer.render(primary=buffer)
    np.testing.assert_array_equal(shown.pixels, render(there, primary=buffer, backend="numpy").pixels)
    np.testing.assert_array_equal(renderer.render(SIZE).pixels, render(there, SIZE, backend="numpy").pixels)


def test_no_kernel_of_eye_rays_is_compiled_for_a_buffer(boxes, monkeypatch):
    compiled, own = [], Renderer._compiled

    def noted(renderer, camera, seen, transparent):
        compiled.append(seen)
        return own(renderer, camera, seen, transparent)

    monkeypatch.setattr(Renderer, "_compiled", noted)
    render(BOXES, primary=boxes, backend="numpy")
    assert compiled == [True]


def test_a_scene_without_lights_and_a_buffer_without_surfaces(boxes):
    dark = dataclasses.replace(BOXES, lights=())
    check_like(render(dark, primary=boxes, backend="numpy"), render(dark, SIZE, backend="numpy"), 2e-4)
    matt = dataclasses.replace(dark, meshes=[box((1, 1, 1), Material((0.5, 0.2, 0.1)))])
    shown = render(matt, primary=seen(matt), backend="numpy")
    np.testing.assert_array_equal(shown.pixels, render(matt, SIZE, backend="numpy").pixels)
    nothing = GBuffer(np.full((3, 4, 3), np.nan), np.full((3, 4, 3), np.nan), np.full((3, 4), -1))
    empty = render(BOXES, primary=nothing, backend="numpy")
    assert empty.pixels.shape == (3, 4, 3)
    np.testing.assert_array_equal(empty.pixels, np.broadcast_to(np.float32(BOXES.background), (3, 4, 3)))
    assert empty.stats.rays == 0


def test_what_cannot_be_right_is_refused(boxes):
    def refused(text, scene=BOXES, primary=boxes, size=None, **options):
        with pytest.raises(SceneError, match=re.escape(text)):
            render(scene, size, primary=primary, backend="numpy", **options)

    refused("of 40 x 30 pixels, and the picture is 64 x 48: size=(40, 30), or rasterise at", size=(64, 48))
    refused("one surface a pixel: samples=1, not 4; average pictures of several", integrator=Whitted(samples=4))
    refused("takes the place of the eye rays of Whitted(), not of Path(): leave primary out", integrator=Path())
    refused("not of Staged()", integrator=Staged())
    refused("leave cluster and max_error out", max_error=1.0)
    refused("primary is a GBuffer(position, normal, object, uv), not int", primary=7, size=SIZE)
    refused("the GBuffer shows objects, and the scene has no triangles: give it the meshes", scene=Scene())
    numbers = boxes.object.copy()
    numbers[20, 20] = 3
    refused(
        "has object 3, and the scene's meshes are 0 to 2; a pixel without a surface has -1",
        primary=dataclasses.replace(boxes, object=numbers),
    )
    holes = boxes.position.copy()
    row, column = np.argwhere(boxes.object >= 0)[0]
    holes[row, column] = np.nan
    refused(
        f"the position of the GBuffer in row {row}, column {column} is [nan, nan, nan]",
        primary=dataclasses.replace(boxes, position=holes),
    )
    refused(
        f"the normal of the GBuffer in row {row}, column {column} is [0.0, 0.0, 0.0]: a surface's is finite and not 0",
        primary=dataclasses.replace(boxes, normal=0 * boxes.normal),
    )


def test_surfaces_that_a_buffer_does_not_describe_are_refused():
    def refused(text, mesh):
        scene = Scene([mesh], [PointLight((3, 6, 4))], Camera((1, 3, 6), (0, 0.5, 0)))
        buffer = GBuffer(np.ones((2, 2, 3)), np.ones((2, 2, 3)), np.zeros((2, 2), int), np.zeros((2, 2, 2)))
        with pytest.raises(SceneError, match=re.escape(text)):
            render(scene, primary=buffer, backend="numpy")

    plain = box()
    refused("a GBuffer shows opaque surfaces, and this scene has glass", box(material=Material(transmission=0.5)))
    refused(
        "a GBuffer has no vertex colours, and mesh 0 (mesh) has some: give it a Texture",
        Mesh(plain.vertices, plain.faces, colors=np.full((len(plain.vertices), 3), 0.5)),
    )
    bumps = Material(normal_map=Texture(np.full((2, 2, 3), 0.5)))
    refused("the normals of a GBuffer are final, and mesh 0 (box) has a normal_map: rasterise it", box(material=bumps))
    speckled = Material(surface=lambda hit: Surface(diffuse=sh.Attrib1f(hit.triangle)))
    refused("a GBuffer has no triangle, and the surface program of mesh 0 (box) may read it", box(material=speckled))


def test_uv_coordinates_are_asked_for_where_materials_need_them(painted):
    with pytest.raises(
        SceneError, match=r"materials of the scene need uv coordinates: GBuffer\(position, normal, object"
    ):
        render(painted, primary=seen(painted), backend="numpy")


def test_the_arrays_of_a_buffer_fit_each_other():
    one, three = np.zeros((2, 3), int), np.zeros((2, 3, 3))
    with pytest.raises(
        SceneError, match=r"the position of a GBuffer is \(2, 3, 3\), as its object is \(2, 3\), not \(3, 2, 3\)"
    ):
        GBuffer(np.zeros((3, 2, 3)), three, one)
    with pytest.raises(SceneError, match=r"the uv of a GBuffer is \(2, 3, 2\)"):
        GBuffer(three, three, one, three)
    with pytest.raises(SceneError, match=r"object of a GBuffer is \(height, width\) whole numbers, .* of float64"):
        GBuffer(three, three, one.astype(float))
    for number in (-2, 2**31, 2**32 + 1):
        with pytest.raises(SceneError, match=f"object of a GBuffer has {number}: it holds the numbers of meshes"):
            GBuffer(three, three, np.where(one == 0, number, one))
    with pytest.raises(SceneError, match="slack of a GBuffer is a share of the distance from 0 to 1, not 2"):
        GBuffer(three, three, one, slack=2)


def by_object(hit: Hit) -> Surface:
    return Surface(color=sh.Color3f(sh.Attrib1f(hit.object) / 8, 0.5, 0.2))


def test_instances_have_the_materials_of_their_meshes():
    gem, sheet = icosahedron(0.5, Material(surface=by_object)), floor(0.9, Material(Texture(np.eye(3)[None])))
    red, ground = gem.with_material(Material((1, 0, 0))), floor(9, Material((0, 0, 1))).moved((0, -1, 0))
    parts = [Instance(mesh, np.eye(4)) for mesh in (gem, ground, sheet, red, gem, sheet)]
    for k in (0, 2, 3, 4, 5):
        parts[k].transform[0, 3] = k - 2.5
    scene = Scene(parts, [PointLight((2, 9, 3))], Camera((0, 3, 6), (0, 0, 0)))
    primary = seen(scene, uv=np.zeros((*SIZE[::-1], 2)))
    assert len(np.unique(primary.object)) == 7
    one, other = (render(scene, accel=accel, primary=primary, backend="numpy") for accel in ("bvh", "instances"))
    np.testing.assert_allclose(one.pixels, other.pixels, atol=1e-4)


def test_instances_are_seen_where_they_have_moved():
    gem, cube = (mesh.with_material(Material(surface=by_object)) for mesh in (icosahedron(0.5), box()))
    away = np.diag([1.0, 1.5, -1.0, 1.0])
    away[0, 3] = 1.5
    parts = [Instance(mesh, np.eye(4)) for mesh in (gem, cube, cube, gem)]
    scene = Scene([*parts, floor(9).moved((0, -1, 0))], [PointLight((2, 9, 3))], Camera((0, 3, 6), (0, 0, 0)))
    moved = dataclasses.replace(scene, meshes=[*scene.meshes[:2], Instance(cube, away), *scene.meshes[3:]])
    position = np.random.default_rng(2).uniform(-2, 2, (6, 10, 3))
    primary = GBuffer(position, np.ones((6, 10, 3)), np.arange(60).reshape(6, 10) % 5, np.zeros((6, 10, 2)))
    renderers = [Renderer(each, accel="instances", backend="numpy", bounces=0) for each in (scene, moved)]
    before = renderers[0].render(primary=primary)
    renderers[0].move(2, away)
    after, new = (renderer.render(primary=primary) for renderer in renderers)
    assert renderers[0].builds == 1
    assert np.any(before.pixels != after.pixels)
    for name in ("pixels", "depth", "normal", "object_id"):
        np.testing.assert_array_equal(getattr(after, name), getattr(new, name))
