"""The cost of each feature of the ray tracer on every backend.

    print(features(Setup(mesh)).markdown())

The plain scene has two matt materials, flat triangles, one light at a point and no bounces. Each feature is added to it
alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import shpy as sh
from benchmarks.frames import settled
from benchmarks.rounds import in_turns
from benchmarks.tables import Setup, Table
from raytracer import Camera, DirectionalLight, Material, Mesh, PointLight, Scene, Surface, Texture, shaders
from raytracer.integrators.renderer import Renderer
from raytracer.meshes.shapes import floor

MATT = Material((0.5, 0.5, 0.5), diffuse=1.0, specular=0.0)
SIZES = {"numpy": 48, "opencl": 256, "glsl": 256}
"""Pixels along each side."""


@dataclass(frozen=True, eq=False)
class Case:
    """A scene with a feature, and how it is rendered."""

    scene: Scene
    bounces: int = 0
    options: tuple[tuple[str, Any], ...] = ()
    samples: int = 1

    def renderer(self, backend: str) -> Renderer:
        """Return the compiled scene."""
        return Renderer(self.scene, backend=backend, bounces=self.bounces, **dict(self.options))


def plain(mesh: Mesh) -> Scene:
    """Return a mesh on a floor, with nothing that costs anything."""
    low, high = mesh.corners.min(axis=(0, 1)), mesh.corners.max(axis=(0, 1))
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    x, _, z = middle.tolist()
    ground = floor(20 * radius, replace(MATT, color=(0.4, 0.38, 0.36))).moved((x, float(low[1]) - 1e-3 * radius, z))
    flat = replace(mesh, normals=None, colors=None, uv=None, material=MATT)
    place = middle + np.array([-3, 5, 4]) * radius
    light = PointLight((place[0], place[1], place[2]), (0.9, 0.9, 0.9))
    return Scene((flat, replace(ground, uv=None)), (light,), Camera.framing(low, high), ambient=0.1, name="plain")


def cases(mesh: Mesh) -> dict[str, Case]:
    """Return the features by name, the plain scene first."""
    scene = plain(mesh)
    body, ground = scene.meshes
    (light,) = scene.lights
    camera = scene.camera
    assert camera is not None
    assert isinstance(light, PointLight)
    uv = np.random.default_rng(1).random((len(body), 3, 2))
    picture = Texture(np.random.default_rng(2).random((64, 64, 3)))
    span = 2 * float(np.linalg.norm(np.subtract(camera.position, camera.target)) * np.tan(np.radians(camera.fov) / 2))

    def of(bounces: int = 0, mesh: Mesh = body, **changes: Any) -> Case:
        """Return the mesh of another material."""
        return Case(replace(scene, meshes=[mesh.with_material(replace(MATT, **changes)), ground]), bounces)

    def seen_by(**changes: Any) -> Case:
        return Case(replace(scene, camera=replace(camera, **changes)))

    def lit_by(*lights: Any) -> Case:
        return Case(replace(scene, lights=lights))

    def by_hand(hit: Any) -> Surface:
        return Surface(color=sh.abs(hit.normal))

    return {
        "plain": Case(scene),
        "highlights": of(specular=0.4),
        "smooth normals": of(mesh=body.smoothed(60)),
        "vertex colours": of(mesh=replace(body, colors=np.ones((len(body), 3, 3)))),
        "a second light": lit_by(light, replace(light, color=(0.1, 0.1, 0.2))),
        "a light from a direction": lit_by(DirectionalLight((3, -5, -4), light.color)),
        "a light that fades": lit_by(replace(light, falloff="square")),
        "orthographic camera": seen_by(projection="orthographic", span=span),
        "thin lens": seen_by(aperture=0.05 * span),
        "mirror, 1 bounce": of(bounces=1, reflectivity=0.5),
        "glass, 4 bounces": of(4, transmission=1.0),
        "texture": of(mesh=replace(body, uv=uv), color=picture),
        "a small surface program": of(surface=by_hand),
        "marble": of(surface=shaders.marble()),
        "a shade, toon": of(shade=shaders.toon()),
        "path, 4 samples, 1 bounce": Case(scene, 1, (("integrator", "path"),), 4),
    }


def features(setup: Setup) -> Table:
    """Measure the rays of each feature, and the time of its picture beside the plain one's."""
    backends = [b.name for b in sh.backends() if b.available and b.name in SIZES]
    mesh, cases_by_name = setup.mesh, cases(setup.mesh)
    if setup.quick:
        cases_by_name = dict(list(cases_by_name.items())[:3])
    rows: dict[str, list[str]] = {}
    for name, case in cases_by_name.items():
        shot = case.renderer("numpy").render((64, 64), samples=case.samples).stats.rays / 64**2
        rows[name] = [name, f"{shot:.2f}"]
    rounds = {}
    for backend in backends:
        size = 16 if setup.quick else SIZES[backend]
        runs = {name: settled(case.renderer(backend), size, case.samples) for name, case in cases_by_name.items()}
        times = {name: t.cpu for name, t in in_turns(runs, 1 if setup.quick else 5).items()}
        for name, row in rows.items():
            row.append(f"{min(times[name]) / min(times['plain']):.2f}")
        rows["plain"][-1] = f"{1e3 * min(times['plain']):.1f} ms"
        rounds |= {f"{name}, {backend}": cpu for name, cpu in times.items()}
    head = ["feature", "rays a pixel", *backends]
    pixels = ", ".join(f"{SIZES[b]}² on {b}" for b in backends)
    note = (
        f"{mesh.name}, {len(mesh):,} triangles, on a floor. Of each backend: how many times the CPU time of the plain "
        f"picture, the best of 5 in turns; pixels: {pixels}."
    )
    return Table("features", note, head, list(rows.values()), rounds)
