"""Rays against the triangles of a mesh: coherent and incoherent ones, the closest hit and any hit.

    for work in works(mesh):
        ...

Primary rays leave a camera that sees the whole mesh, one a pixel; ours makes them in the kernel. Secondary rays start
where primary ones hit and leave in random directions on that side of the surface; ours are given as arrays. Mitsuba
holds both kinds as arrays of its own already. The answer is the distance of the hit, or whether there is one.
"""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import numpy as np

import shpy as sh
from benchmarks.work import TARGETS, Work
from raytracer import Camera, Intersector, Mesh, MetallicRoughness, PointLight, Scene
from raytracer.accel.choice import build
from raytracer.accel.space import triangle_rows
from raytracer.kernels.packet_walk import PacketIntersector
from raytracer.kernels.walk import walk_with
from raytracer.kernels.wide_walk import WideIntersector
from raytracer.rays import alike

NAMES = ("primary", "primary-any", "secondary", "secondary-any")
EDGES = "Rays that graze an edge may miss it."


def works(mesh: Mesh) -> list[Work]:
    """Return the four works of a mesh."""
    return [_work(mesh, name) for name in NAMES]


def _work(mesh: Mesh, name: str) -> Work:
    primary, any_hit = name.startswith("primary"), name.endswith("any")
    rays = "coherent rays from the eye" if primary else "rays from surfaces in random directions"
    hit = "any hit" if any_hit else "the closest hit"
    work = Work(
        name,
        f"{{size}} x {{size}} {rays}, {hit}, {len(mesh):,} triangles of {mesh.name}",
        inputs=(lambda size: (size,)) if primary else (lambda size: secondary_rays(mesh, size)),
        size=1024 if primary else 512,
        quick=32,
        within=1e-3,
        share=1e-3,
        note=EDGES,
    )
    ours = ours_primary if primary else ours_given
    work.ours_on("opencl", "plain", "opencl-1", "glsl")(partial(ours, mesh=mesh, any_hit=any_hit))
    if not primary:
        work.version("plain")(partial(plain, mesh=mesh, any_hit=any_hit))
    work.version("mitsuba")(partial(mitsuba, mesh=mesh, any_hit=any_hit))
    return work


def view(mesh: Mesh, size: int) -> Any:
    """Return the camera's vectors."""
    corners = mesh.corners.reshape(-1, 3)
    return Camera.framing(corners.min(axis=0), corners.max(axis=0)).view(size, size)


def primary_rays(mesh: Mesh, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Origins and unit directions (size * size, 3) of the rays from the eye."""
    eye, corner, across, down = view(mesh, size)
    row, column = np.mgrid[:size, :size].reshape(2, -1, 1) + 0.5
    rays = corner + column * across + row * down
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return np.broadcast_to(eye, rays.shape).astype(np.float32), rays.astype(np.float32)


@cache
def secondary_rays(mesh: Mesh, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Origins and unit directions, one for each primary ray that hits."""
    eye, ray = primary_rays(mesh, size)
    hits = Intersector(mesh).intersect(eye, ray)
    hit = hits.triangle >= 0
    normal = mesh.face_normals[hits.triangle[hit]]
    normal *= np.where(np.sum(normal * ray[hit], axis=1) > 0, -1, 1)[:, None]
    away = np.random.default_rng(1).normal(size=normal.shape)
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    away *= np.where(np.sum(normal * away, axis=1) < 0, -1, 1)[:, None]
    radius = np.linalg.norm(np.ptp(mesh.corners.reshape(-1, 3), axis=0))
    start = eye[hit] + hits.t[hit, None] * ray[hit] + 1e-4 * radius * normal
    return start.astype(np.float32), away.astype(np.float32)


@cache
def _structure(mesh: Mesh) -> tuple[Any, np.ndarray]:
    return build("bvh", mesh.corners), triangle_rows(mesh.corners)


def _answer(hit: Any, any_hit: bool) -> Any:
    return sh.cond(hit.id >= 0, 1.0, 0.0) if any_hit else sh.cond(hit.id >= 0, hit.l, np.inf)


def ours_primary(compiled: Any, size: int, mesh: Mesh, any_hit: bool) -> Any:
    """Trace rays that the kernel makes, with the walk that queries of alike rays take."""
    walk: Any = walk_with(*_structure(mesh), compiled.keywords.get("backend", "opencl"))
    if compiled.keywords in (TARGETS["opencl"], TARGETS["plain"]):
        walk = PacketIntersector(*_structure(mesh))
    eye, corner, across, down = (tuple(v) for v in view(mesh, size))

    @sh.program
    def primary() -> sh.Attrib1f:
        row, column = sh.grid_index(2)
        ray = sh.normalize(sh.Vector3f(*corner) + (column + 0.5) * across + (row + 0.5) * down)
        return _answer(walk(ray, sh.Point3f(*eye), 0.0, sh.Attrib1f(1e30), any_hit), any_hit)

    kernel = compiled(primary, loop_limit=None)
    return lambda: kernel(shape=(size, size))


def ours_given(compiled: Any, origins: np.ndarray, directions: np.ndarray, mesh: Mesh, any_hit: bool) -> Any:
    """Trace rays given as arrays, with the walk that `Intersector` chooses for such rays."""
    structure, rows = _structure(mesh)
    alone = compiled.keywords == TARGETS["opencl"] and not alike(
        origins.astype(np.float64), directions.astype(np.float64), structure.low[0], structure.high[0]
    )
    backend = compiled.keywords.get("backend", "opencl")
    walk = WideIntersector(structure, rows) if alone else walk_with(structure, rows, backend)

    @sh.program
    def secondary(eye: sh.Point3f, ray: sh.Vector3f) -> sh.Attrib1f:
        return _answer(walk(ray, eye, 0.0, sh.Attrib1f(1e30), any_hit), any_hit)

    kernel = compiled(secondary, loop_limit=None, **({"lanes": 1} if alone else {}))
    return lambda: kernel(origins, directions)


def plain(origins: np.ndarray, directions: np.ndarray, mesh: Mesh, any_hit: bool) -> Any:
    """Trace rays given as arrays, by the call that users write."""
    intersector = Intersector(mesh)
    if any_hit:
        return lambda: intersector.occluded(origins, directions)
    return lambda: intersector.intersect(origins, directions).t


def mitsuba_sensor(camera: Camera, size: int) -> Any:
    """Return a camera as Mitsuba's."""
    import mitsuba as mi

    places = [mi.ScalarPoint3f(*v) for v in (camera.position, camera.target)]
    return mi.load_dict({
        "type": "perspective",
        "fov": camera.fov,
        "fov_axis": "smaller",
        "to_world": mi.ScalarTransform4f().look_at(*places, mi.ScalarVector3f(*camera.up)),
        "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent"},
    })  # fmt: skip


def mitsuba_mesh(mesh: Mesh, properties: Any = None, *, textured: bool = False) -> Any:
    """Return the mesh as Mitsuba's, with flat faces; `textured` with uv coordinates, for corners of each triangle."""
    import mitsuba as mi

    vertices, faces = mesh.vertices, mesh.faces
    if textured:
        vertices, faces = mesh.corners.reshape(-1, 3), np.arange(3 * len(mesh)).reshape(-1, 3)
    properties = properties or mi.Properties()
    shape = mi.Mesh(mesh.name, len(vertices), len(faces), has_vertex_texcoords=textured, props=properties)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = np.float32(vertices).ravel()
    parameters["faces"] = np.uint32(faces).ravel()
    if textured:
        uv = np.zeros((len(vertices), 2)) if mesh.uv is None else mesh.uv
        parameters["vertex_texcoords"] = np.float32(uv).ravel()
    parameters.update()
    return shape


def mitsuba_surface(look: Any) -> dict[str, Any]:
    """Return a matt surface, a perfect mirror, a rough metal or plastic as Mitsuba's."""
    color = {"type": "rgb", "value": list(look.tint)}
    if isinstance(look, MetallicRoughness) and look.metallic:
        return {"type": "principled", "base_color": color, "metallic": 1.0, "roughness": look.roughness}
    if isinstance(look, MetallicRoughness):
        facets = {"distribution": "ggx", "alpha": float(look.roughness) ** 2}
        return {"type": "roughplastic", "diffuse_reflectance": color, "int_ior": 1.5, "ext_ior": 1.0, **facets}
    if look.numbers["reflectivity"] == 1:
        return {"type": "conductor", "material": "none"}
    color["value"] = [look.numbers["diffuse"] * c for c in look.tint]
    return {"type": "diffuse", "reflectance": color}


@cache
def mitsuba_scene(scene: Scene) -> Any:
    """Return a scene of such surfaces, lamps and point lights, or under a picture, as Mitsuba's.

    A point light is so far away that its falloff, which Mitsuba's has, cannot be seen.
    """
    import mitsuba as mi

    assert scene.camera is not None
    description: dict[str, Any] = {"type": "scene"}
    for number, part in enumerate(scene.meshes):
        look, properties = part.material, mi.Properties()
        properties["bsdf"] = mi.load_dict({"type": "twosided", "bsdf": mitsuba_surface(look)})
        properties["face_normals"] = True
        if any(look.emission):
            radiance = {"type": "rgb", "value": list(look.emission)}
            properties["emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
        description[f"mesh_{number}"] = mitsuba_mesh(part, properties)
    for number, light in enumerate(scene.placed_lights):
        assert isinstance(light, PointLight)
        square = float(np.sum((np.asarray(light.position) - scene.camera.target) ** 2))
        intensity = {"type": "rgb", "value": [np.pi * square * c for c in light.color]}
        description[f"light_{number}"] = {"type": "point", "position": list(light.position), "intensity": intensity}
    if scene.environment is not None:
        image = scene.environment.picture.image  # Mitsuba's begins half a turn from ours
        around = np.roll(image, image.shape[1] // 2, axis=1)
        description["around"] = {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(around))}
    return mi.load_dict(description)


def _traced(scene: Any, ray: Any, coherent: bool, any_hit: bool) -> np.ndarray:
    if any_hit:
        return np.asarray(scene.ray_test(ray, coherent=coherent))
    return np.asarray(scene.ray_intersect_preliminary(ray, coherent=coherent).t)


def mitsuba_eye_rays(mesh: Mesh, size: int) -> Any:
    """Return the rays from the eye, not computed yet."""
    import drjit as dr
    import mitsuba as mi

    eye, corner, across, down = (mi.Vector3f(*v.tolist()) for v in view(mesh, size))
    i = dr.arange(mi.UInt32, size * size)
    row, column = mi.Float(i // size) + 0.5, mi.Float(i % size) + 0.5
    return mi.Ray3f(mi.Point3f(eye), dr.normalize(corner + column * across + row * down))


def mitsuba(*rays: Any, mesh: Mesh, any_hit: bool) -> Any:
    """All cores, and packets of 16 rays if they are coherent, as those from the eye are; rays are made beforehand."""
    import drjit as dr
    import mitsuba as mi

    scene, primary = mi.load_dict({"type": "scene", "mesh": mitsuba_mesh(mesh)}), len(rays) == 1
    ray = mitsuba_eye_rays(mesh, rays[0]) if primary else mi.Ray3f(*(a.T for a in rays))
    shape = (rays[0], rays[0]) if primary else (-1,)
    dr.eval(ray)
    return lambda: _traced(scene, ray, primary, any_hit).reshape(shape)
