"""The measurement of a layered depth cube, or of an exact accelerator, over one model: time, memory and errors.

Stage: measure. A model stands on a floor under a light; it mirrors half of the light, the floor a fifth. A `Bench`
renders the exact pictures and rays of a model by the BVH, and measures every `Case` in turns with it.

    bench = Bench(Model("knot", (mesh,)), "opencl", (1280, 1024))
    bench.measure(Case("knot", "opencl", "ldc", 512, "plane"), framed=True)
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.choice import build
from raytracer.appearance.materials import Material
from raytracer.image import Image
from raytracer.integrators.renderer import Renderer
from raytracer.intersector import Intersector
from raytracer.layered.cube import LayeredCube
from raytracer.meshes import Mesh
from raytracer.meshes.shapes import floor, knot, sphere, torus
from raytracer.scene.camera import Camera
from raytracer.scene.lights import PointLight
from raytracer.scene.scene import Scene
from raytracer.studies.report import Clock
from raytracer.studies.tradeoff import errors

Work = Callable[[int], Any]
Vectors = NDArray[np.float64]

ROUNDS = 3
_SLOW = 1.0
"""Seconds: pictures and rays that take longer are timed twice."""
SMALLER = 4
"""Errors are those of a picture whose sides are this many times shorter, and of the rays from its pixels."""
MISPLACED = 1e-3
"""The largest distance of a correct hit from the exact one along its ray, as a part of the model's largest side."""
KINDS = ("mirrored", "shadow", "scattered")
"""Rays from the points that the eye sees: mirrored at the face, to the light, and in random directions."""
_MIRROR = Material((0.5, 0.5, 0.5), specular=0.2, reflectivity=0.5)
_FLOOR = Material((0.5, 0.48, 0.45), specular=0.0, reflectivity=0.2)


@dataclass(frozen=True, eq=False)
class Model:
    """A mesh, its largest side of length 1; of a deforming one a mesh for each frame."""

    name: str
    meshes: tuple[Mesh, ...]


@dataclass(frozen=True, slots=True)
class Case:
    """An accelerator for secondary rays: "bvh", "grid", or "ldc" with the options of `LayeredCube.of`."""

    model: str
    backend: str
    accel: str
    resolution: int = 0
    hit: str = ""
    tolerance: float | None = None
    depths: str = "single"
    block: int | None = None

    def __str__(self) -> str:
        if self.accel != "ldc":
            return {"bvh": "BVH"}.get(self.accel, self.accel)
        return f"{self.resolution}² {self.test}"

    @property
    def test(self) -> str:
        """The hit test with its tolerance, and "half" for half depths."""
        tolerance = "" if self.tolerance is None else f" {self.tolerance:g}"
        return f"{self.hit}{tolerance}{' half' if self.depths == 'half' else ''}"


@dataclass(frozen=True, slots=True)
class Wrong:
    """The wrong hits of rays of one kind: shares that missed, hit nothing real, or hit elsewhere than the exact rays.

    `seconds` for all `rays`, beside `bvh_seconds` for the same rays.
    """

    rays: int
    missed: float
    false: float
    misplaced: float
    seconds: float
    bvh_seconds: float

    @property
    def all(self) -> float:
        """The share of rays whose hit is wrong."""
        return self.missed + self.false + self.misplaced


@dataclass(frozen=True, slots=True)
class Measurement:
    """The cost of a case and its errors.

    `build_seconds` is the least of some builds; `frame_seconds` that of some pictures, None if there was none, beside
    `bvh_seconds` with the BVH alone; `layers` and `samples` are 0 for what is no cube; `errors` as `tradeoff.errors`.
    """

    case: Case
    triangles: int
    build_seconds: float
    nbytes: int
    layers: int
    samples: int
    rays: int
    frame_seconds: float | None
    bvh_seconds: float | None
    errors: dict[str, float]
    wrong: dict[str, Wrong]
    pixels: NDArray[np.uint8] = field(repr=False)

    @property
    def cost(self) -> float:
        """The time of the secondary rays as a multiple of the BVH's."""
        return sum(w.seconds for w in self.wrong.values()) / sum(w.bvh_seconds for w in self.wrong.values())


def unit(mesh: Mesh) -> Mesh:
    """Move a mesh to 0, and scale it so that its largest side has length 1."""
    low, high = mesh.corners.min(axis=(0, 1)), mesh.corners.max(axis=(0, 1))
    scale = 1 / float((high - low).max() or 1.0)
    x, y, z = (-scale * (low + high) / 2).tolist()
    return mesh.moved((x, y, z), scale=scale)


def bumpy(mesh: Mesh, height: float, phase: float = 0.0) -> Mesh:
    """Move the vertices of a mesh along their normals by waves; `phase`, from 0 to 1, is a moment of a period."""
    x, y, z = 9.0 * np.asarray(mesh.vertices).T
    waves = np.sin(x + 2 * np.pi * phase) * np.cos(1.3 * y) * np.sin(0.7 * z + 1)
    away = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    return dataclasses.replace(mesh, vertices=mesh.vertices + height * waves[:, None] * away, normals=None)


def models(quick: bool = False) -> tuple[Model, ...]:
    """Make models of as many triangles as the paper's bunny, car, dragon, head and animation; or a small one."""
    if quick:
        return (Model("knot", (unit(knot(segments=40, sides=6)),)),)
    still = {
        "torus": torus(1.0, 0.4, segments=128, sides=32),
        "knot": knot(segments=298, sides=34),
        "braid": knot(3, 5, tube=0.15, segments=1000, sides=50),
        "rock": bumpy(sphere(0.5, rings=301, segments=500), 0.04),
    }
    ball = sphere(0.5, rings=23, segments=37)
    animation = Model("animation", tuple(unit(bumpy(ball, 0.1, k / 4)) for k in range(4)))
    return *(Model(name, (unit(mesh.moved(tilt=25)),)) for name, mesh in still.items()), animation


def scene_of(mesh: Mesh) -> Scene:
    """Put a mesh of a model, half a mirror, on a floor under a light."""
    low, high = mesh.corners.min(axis=(0, 1)), mesh.corners.max(axis=(0, 1))
    radius = float(np.linalg.norm(high - low)) / 2
    ground = floor(2.6 * radius, _FLOOR).moved((0, float(low[1]) - 0.01, 0))
    light = PointLight((-3 * radius, 5 * radius, 4 * radius))
    plain = dataclasses.replace(mesh, colors=None, material=_MIRROR)
    return Scene((plain, ground), [light], Camera.framing(low, high), name=mesh.name)


class Bench:
    """Measures accelerators for a model on a backend, against its pictures and rays through the exact BVH."""

    def __init__(self, model: Model, backend: str, size: tuple[int, int]) -> None:
        self.backend, self.size = backend, size
        self.clock: Clock = time.perf_counter
        self.small = max(size[0] // SMALLER, 1), max(size[1] // SMALLER, 1)
        self.scenes = [scene_of(mesh) for mesh in model.meshes]

    @cached_property
    def exact(self) -> list[Renderer]:
        """A renderer through the BVH for each frame."""
        return [Renderer(scene, backend=self.backend, bounces=1) for scene in self.scenes]

    @cached_property
    def picture(self) -> Image:
        """The exact small picture of the first frame."""
        return self.exact[0].render(self.small)

    @cached_property
    def exact_rays(self) -> Intersector:
        """The first frame's BVH for rays."""
        return Intersector(self.scenes[0], backend=self.backend)

    @cached_property
    def rays(self) -> dict[str, tuple[Vectors, Vectors]]:
        """Origins and directions of each kind of rays, from the points of the small picture; shadow rays have t < 1."""
        scene = self.scenes[0]
        camera, (width, height) = scene.camera, self.small
        assert camera is not None  # a Scene sets its own camera by default
        eye, corner, across, down = camera.view(width, height)
        row, column = np.mgrid[:height, :width].reshape(2, -1, 1) + 0.5
        ray = corner + column * across + row * down
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        hits = self.exact_rays.intersect(np.broadcast_to(eye, ray.shape), ray)
        met = hits.triangle >= 0
        start, ray = self.exact_rays.points(hits)[met], ray[met]
        normal = np.concatenate([mesh.face_normals for mesh in scene.meshes])[hits.triangle[met]]
        normal *= -np.sign((normal * ray).sum(axis=1, keepdims=True))
        away = np.random.default_rng(1).normal(size=ray.shape)
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        away *= np.sign((normal * away).sum(axis=1, keepdims=True))
        light = scene.lights[0]
        assert isinstance(light, PointLight)
        mirrored = ray - 2 * normal * (normal * ray).sum(axis=1, keepdims=True)
        return {"mirrored": (start, mirrored), "shadow": (start, light.position - start), "scattered": (start, away)}

    @cached_property
    def answers(self) -> dict[str, Any]:
        """The exact answers to the rays."""
        return {kind: self._ask(self.exact_rays, kind) for kind in KINDS}

    def measure(self, case: Case, *, framed: bool) -> Measurement:
        """Measure a case; `framed` adds the time to render whole pictures."""
        rounds = max(ROUNDS, len(self.scenes)) if framed else 2
        built = [self._build(case, self.scenes[k % len(self.scenes)]) for k in range(rounds)]
        structure = built[0][1]
        renderers = [self._renderer(case, k, built[k][1]) for k in range(len(self.scenes) if framed else 1)]
        picture = renderers[0].render(self.small)
        frame, bvh = self._frames(renderers) if framed else (None, None)
        cube = structure if isinstance(structure, LayeredCube) else None
        shoot = Intersector(self.scenes[0], cube or case.accel, self.backend)
        return Measurement(
            case,
            self.scenes[0].triangles,
            min(seconds for seconds, _ in built),
            structure.bytes if cube is None else cube.nbytes,
            max(cube.layers) if cube else 0,
            cube.samples if cube else 0,
            int(picture.stats.rays),
            frame,
            bvh,
            errors(picture, self.picture),
            {kind: self._wrong(shoot, kind) for kind in KINDS},
            picture.srgb,
        )

    def _build(self, case: Case, scene: Scene) -> tuple[float, Any]:
        """Build the accelerator of a case; return the seconds and the accelerator."""
        if case.accel != "ldc":
            corners = np.concatenate([mesh.corners for mesh in scene.meshes])
            return self._timed(lambda: build(case.accel, corners, backend=self.backend))
        options: dict[str, Any] = {"hit": case.hit, "tolerance": case.tolerance, "depths": case.depths}
        options |= {} if case.block is None else {"block": case.block}
        return self._timed(lambda: LayeredCube.of(scene, case.resolution, backend=self.backend, **options))

    def _renderer(self, case: Case, frame: int, structure: Any) -> Renderer:
        if case.accel == "bvh":
            return self.exact[frame]
        options: dict[str, Any] = {"secondary": structure} if case.accel == "ldc" else {"accel": case.accel}
        return Renderer(self.scenes[frame], backend=self.backend, bounces=1, **options)

    def _frames(self, renderers: list[Renderer]) -> tuple[float, float]:
        """Return the least seconds of a picture and of its exact one, rendered alternately."""
        for renderer, exact in zip(renderers, self.exact, strict=False):
            renderer.render(self.small)  # drivers compile once more when a kernel runs for the first time
            exact.render(self.size)
        count = len(renderers)
        return self._in_turns(
            lambda k: renderers[k % count].render(self.size),
            lambda k: self.exact[k % count].render(self.size),
            max(ROUNDS, count),
        )

    def _in_turns(self, work: Work, exact: Work, rounds: int) -> tuple[float, float]:
        """Return the least seconds of both, which run alternately; two rounds do where they take long."""
        times: list[tuple[float, float]] = []
        while len(times) < rounds and not (len(times) > 1 and times[-1][0] > _SLOW):
            k = len(times)
            times.append((self._timed(lambda: work(k))[0], self._timed(lambda: exact(k))[0]))  # noqa: B023
        least, exact_least = map(min, zip(*times, strict=True))
        return least, exact_least

    def _timed(self, work: Callable[[], Any]) -> tuple[float, Any]:
        started = self.clock()
        result = work()
        return self.clock() - started, result

    def _ask(self, shoot: Intersector, kind: str) -> Any:
        """Return the hits of rays of a kind; for "shadow", True for those that hit."""
        start, away = self.rays[kind]
        if kind == "shadow":
            return shoot.occluded(start, away, 1.0, leaving=True)
        return shoot.intersect(start, away, leaving=True).t

    def _wrong(self, shoot: Intersector, kind: str) -> Wrong:
        """Compare the hits of rays with the exact ones, and time both alternately."""
        answers, exact = self._ask(shoot, kind), self.answers[kind]
        is_shadow = kind == "shadow"
        hit, exact_hit = (answers, exact) if is_shadow else (np.isfinite(answers), np.isfinite(exact))
        both = hit & exact_hit
        apart = np.abs(answers[both] - exact[both]) > MISPLACED if not is_shadow else np.zeros(1, bool)
        count = max(len(exact), 1)
        times = self._in_turns(lambda k: self._ask(shoot, kind), lambda k: self._ask(self.exact_rays, kind), ROUNDS)
        missed, false, misplaced = (int(wrong.sum()) / count for wrong in (exact_hit & ~hit, hit & ~exact_hit, apart))
        return Wrong(len(exact), missed, false, misplaced, *times)
