"""Time against error for one scene: every way of rendering it that there is, and the fastest that is close enough.

Stage: measure. A picture in f64 is the reference. The variants are precision, math mode, accelerator and number of
bounces; each is rendered small, from the scene's camera and, as a check on pixels that the choice was not made on, from
beside it and from all around. Layered depth cubes are among the accelerators of scenes with many triangles.

    t = tradeoff(Scene.builtin("boxes"), max_error=1.0, backend="opencl")
    print(t.table())
    t.pick.variant                    # Variant(precision='f32', math='fast', accel='bvh', bounces=1)
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.accel.choice import ACCELERATORS
from raytracer.backends import chosen_backend
from raytracer.errors import SceneError, warn
from raytracer.image import Image, encoded
from raytracer.integrators.integrator import Whitted, check_scene
from raytracer.integrators.layers import Progress
from raytracer.integrators.renderer import Renderer
from raytracer.scene.camera import Camera
from raytracer.scene.scene import Scene

Pixels = NDArray[np.float64]
"""(H, W, 3), as sRGB in [0, 1]."""

SIZE = (160, 120)
"""Pixels of the pictures that are compared."""
AROUND = (60, 120, 180, 240, 300)
"""Degrees by which the camera is turned for views that the choice is checked on."""
ROUNDS = 5
_ENOUGH = 0.01
"""Seconds: several pictures that take less are timed at once."""
_BRUTE = 2_000
"""Triangles up to which every ray tries every triangle, as a variant and for the reference."""
LAYERED = ("ldc:512", "ldc:512:triangle")
"""Cubes for secondary rays that are variants of scenes with more triangles: an approximate and an exact hit test."""


_MEANINGS = {
    "variant": "precision, mode, accelerator, and how many mirrors a ray follows",
    "ms": "milliseconds for a picture, the median of the rounds",
    "quartiles": "of the rounds: half of them took a time between these",
}
_ERRORS = {
    "rmse": "root mean square error over all channels, in 255ths of sRGB, of the worst view",
    "max": "the largest error of a channel, from the scene's camera as the rest",
    "> 1/255": "pixels that are further off than that in a channel",
    "other object": "pixels that show another object",
    "flip": "the mean difference that is seen where both pictures alternate, from 0 to 1 (Andersson et al. 2020)",
}
_ACCELERATORS = {
    "bvh": "a hierarchy of boxes around triangles",
    "grid": "a uniform grid of cells",
    "brute": "each ray tries every triangle",
}


@dataclass(frozen=True, slots=True)
class Variant:
    """A way to render a scene: options of `Whitted`."""

    precision: str
    math: str
    accel: str
    bounces: int

    @property
    def integrator(self) -> Whitted:
        """The integrator that renders it."""
        return Whitted(**dataclasses.asdict(self))

    def __str__(self) -> str:
        return f"{self.precision} {self.math} {self.accel}, {self.bounces} bounces"


@dataclass(frozen=True, slots=True)
class Candidate:
    """A variant and what it was measured to do.

    `seconds` of a picture of SIZE, the median of the rounds, and `spread`, their quartiles; `error` (see `errors`), and
    `unseen`, the same from where it is worst of the views that are not the camera's.
    """

    variant: Variant
    seconds: float
    spread: tuple[float, float]
    error: dict[str, float]
    unseen: dict[str, float]

    @property
    def worst(self) -> float:
        """The larger of the two root mean square errors, in 255ths."""
        return max(self.error["rmse"], self.unseen["rmse"])


@dataclass(frozen=True)
class Tradeoff:
    """The measured candidates, fastest first; `skipped` has the variants that could not run, with reasons."""

    scene: str
    backend: str
    max_error: float
    candidates: tuple[Candidate, ...]
    skipped: tuple[tuple[str, str], ...] = ()

    @property
    def frontier(self) -> tuple[Candidate, ...]:
        """The Pareto-optimal candidates in time and error, the fastest first."""
        return tuple(self.candidates[n] for n in self._comparison.front)

    @property
    def pick(self) -> Candidate:
        """The choice: the fastest candidate whose error is at most `max_error`.

        Of those whose times are not separable from its time, the closest (`sh.accuracy.pareto`). Raises SceneError
        where no candidate is close enough.
        """
        place: int | None = self._comparison.picked
        if place is not None:
            return self.candidates[place]
        nearest = min(self.candidates, key=lambda c: c.worst)
        raise SceneError(
            f"no variant is within {self.max_error:g}/255: "
            f"the closest, {nearest.variant}, is {nearest.worst:.3g}/255 off"
        )

    def table(self) -> str:
        """Return the candidates as text, with a legend of its marks, columns and short names."""
        return str(self._comparison.table())

    def json(self) -> dict[str, Any]:
        """Return every candidate, for `json.dump`; `like_fastest` marks times not separable from the fastest's."""
        rows = [dataclasses.asdict(c) | self._comparison.marks(n) for n, c in enumerate(self.candidates)]
        return {"scene": self.scene, "backend": self.backend, "max_error": self.max_error, "candidates": rows}

    def plot(self, path: str | Path) -> None:
        """Draw time against error, the frontier and the budget; JSON of the same name goes beside it.

        Raises as `sh.outputs`.
        """
        figure = sh.outputs.new_figure(10, 6)
        sh.accuracy.pareto_plot.draw(self._comparison, figure)
        sh.outputs.save_figure(figure, Path(path), self.json())

    @cached_property
    def _comparison(self) -> Any:
        """The candidates as tables and plots show them, and the choice: an `sh.accuracy.pareto.Comparison`."""
        return sh.accuracy.pareto.Comparison(
            title=f"{self.scene} on {self.backend}: time against error",
            points=tuple(map(self._point, self.candidates)),
            limit=self.max_error,
            budget=f"within {self.max_error:g}/255",
            headings=("variant", "ms", "quartiles", *self._meanings()),
            meanings={**_MEANINGS, **self._meanings(), **self._names()},
            time=f"ms for a picture of {SIZE[0]} x {SIZE[1]}",
            error="root mean square error in 255ths of sRGB",
            series="accelerator",
            mode="arithmetic",
            skipped=self.skipped,
        )

    def _point(self, c: Candidate) -> Any:
        cells = [f"{c.error['max']:.3g}", f"{c.error['off']:.2%}", f"{c.error['objects']:.2%}"]
        if "flip" in self._meanings():
            cells.append(f"{c.error['flip']:.4f}" if "flip" in c.error else "")
        v, kept = c.variant, c.worst <= self.max_error
        milliseconds, spread = 1e3 * c.seconds, (1e3 * c.spread[0], 1e3 * c.spread[1])
        mode = f"{v.precision} {v.math}"
        return sh.accuracy.pareto.Point(
            str(v), str(v), v.accel, mode, milliseconds, spread, c.worst, kept, tuple(cells)
        )

    def _meanings(self) -> dict[str, str]:
        """Explain the columns of errors."""
        flip = any("flip" in c.error for c in self.candidates)
        return {name: meaning for name, meaning in _ERRORS.items() if flip or name != "flip"}

    def _names(self) -> dict[str, str]:
        """Explain the short names of the variants."""
        variants = [c.variant for c in self.candidates]
        names: dict[str, str] = sh.accuracy.pareto.names_of(w for v in variants for w in (v.precision, v.math))
        return names | {accel: _accelerator(accel) for accel in dict.fromkeys(v.accel for v in variants)}


def _accelerator(name: str) -> str:
    """Return what finds the triangles that a ray hits, by its name."""
    if name in _ACCELERATORS:
        return _ACCELERATORS[name]
    _, texels, *hit = name.split(":")
    test = "exact" if hit == ["triangle"] else "approximate"
    return f"secondary rays in a layered depth cube of {texels} x {texels} texels, with an {test} hit test"


def errors(image: Image, reference: Image) -> dict[str, float]:
    """Compute the errors of a picture against a reference, as sRGB in 255ths.

    `rmse` is the root mean square over all channels, `max` the largest; `off` the share of pixels that are more than
    1/255 off in a channel, `objects` of those that show another object. `flip`, where flip-evaluator is installed, is
    the mean difference that is seen when both are shown in turns, from 0 to 1 (Andersson et al. 2020).
    """
    seen, expected = encoded(image.pixels), encoded(reference.pixels)
    off = 255 * np.abs(seen - expected)
    return _flip(seen, expected) | {
        "rmse": float(np.sqrt(np.mean(off**2))),
        "max": float(off.max()),
        "off": float((off.max(axis=-1) > 1).mean()),
        "objects": float((image.object_id != reference.object_id).mean()),
    }


def _flip(seen: Pixels, expected: Pixels) -> dict[str, float]:
    try:
        from flip_evaluator import evaluate
    except ImportError:  # the table then lacks that column: see `errors`
        return {}
    _, mean, _ = evaluate(expected.astype(np.float32), seen.astype(np.float32), "LDR", applyMagma=False)
    return {"flip": float(mean)}


def tradeoff(
    scene: Scene,
    *,
    max_error: float = 1.0,
    backend: str | None = None,
    bounces: int = 3,
    progress: Progress | None = None,
) -> Tradeoff:
    """Measure every variant of rendering `scene` on one backend.

    `max_error` is the root mean square error that is allowed, in 255ths of sRGB; the reference has `bounces`.
    `progress(done, total)` is called with the number of the reference's pictures and of the variants that are done.
    Raises SceneError for a scene without triangles, and for an error that is not positive.
    """
    return _measured(scene, max_error, backend, bounces, progress)[0]


def fastest(scene: Scene, max_error: float, backend: str | None, bounces: int) -> tuple[Variant, Renderer]:
    """Return the variant that `tradeoff` picks, and its renderer; SceneError if there is none."""
    comparison, renderers = _measured(scene, max_error, backend, bounces, None)
    return comparison.pick.variant, renderers[comparison.pick.variant]


def _measured(
    scene: Scene, max_error: float, backend: str | None, bounces: int, progress: Progress | None
) -> tuple[Tradeoff, dict[Variant, Renderer]]:
    check_scene(scene)
    if not (isinstance(max_error, int | float | np.number) and max_error > 0):
        raise SceneError(f"max_error is a positive number of 255ths, not {max_error!r}")
    if not scene.triangles:
        raise SceneError(f"{scene.name} has no triangles: there is nothing to trade")
    backend = chosen_backend(backend)
    cameras = (scene.camera, beside(scene.camera), *(turned(scene.camera, angle) for angle in AROUND))
    exact = reference(scene, backend, bounces)
    variants = list(_variants(scene, bounces))
    tell: Progress = progress or (lambda done, total: None)
    total = len(cameras) + len(variants)
    references: list[Image] = []
    for camera in cameras:
        tell(len(references), total)
        references.append(exact.render(SIZE, camera=camera))
    built_renderers: list[tuple[Variant, Renderer]] = []
    skipped = []
    for done, variant in enumerate(variants, len(cameras)):
        tell(done, total)
        try:
            built_renderers.append((variant, Renderer(scene, integrator=variant.integrator, backend=backend)))
        except sh.CompileError as error:
            skipped.append((str(variant), error.message))
        except SceneError as error:  # memory cannot hold the cube
            skipped.append((str(variant), str(error)))
    tell(total, total)
    candidates = [
        _candidate(v, r, t, cameras, references)
        for (v, r), t in zip(built_renderers, _times(built_renderers), strict=True)
    ]
    candidates.sort(key=lambda c: c.seconds)
    return Tradeoff(scene.name, backend, max_error, tuple(candidates), tuple(skipped)), dict(built_renderers)


def beside(camera: Camera | None) -> Camera:
    """Return the camera a little to the side and farther off, looking at the same place."""
    assert camera is not None  # a scene frames one if it has none
    sight = np.subtract(camera.position, camera.target)
    side = np.cross(sight, camera.up)
    x, y, z = (
        np.add(camera.position, 0.15 * side / np.linalg.norm(side) * np.linalg.norm(sight) + 0.05 * sight)
    ).tolist()
    return dataclasses.replace(camera, position=(x, y, z), intrinsics=None)


def turned(camera: Camera | None, angle: float, rise: float = 1.0) -> Camera:
    """Return the camera turned by `angle` degrees about its target, its height above that multiplied by `rise`."""
    assert camera is not None  # a scene frames one if it has none
    up = np.asarray(camera.up, dtype=np.float64) / np.linalg.norm(camera.up)
    sight = np.subtract(camera.position, camera.target)
    height, across = up * (up @ sight), np.cross(up, sight)
    turn = np.radians(angle)
    moved = rise * height + (sight - height) * np.cos(turn) + across * np.sin(turn)
    x, y, z = np.add(camera.target, moved).tolist()
    return dataclasses.replace(camera, position=(x, y, z), intrinsics=None)


def _variants(scene: Scene, bounces: int) -> list[Variant]:
    """Return the variants to measure: without mirrors, only those of 0 bounces, as more change nothing."""
    mirrors = any(mesh.material.may_mirror for mesh in scene.meshes)
    numbers = range(bounces + 1) if mirrors else (0,)
    accelerators = [a for a in ACCELERATORS if a != "brute" or scene.triangles <= _BRUTE]
    modes = [("f32", "strict"), ("f32", "relaxed"), ("f32", "fast"), ("f64", "strict"), ("f16", "strict")]
    variants = [Variant(p, m, "bvh", n) for (p, m), n in itertools.product(modes, numbers)]
    if scene.triangles > _BRUTE and (scene.lights or (mirrors and bounces)):  # the scene has secondary rays
        accelerators += LAYERED
    return variants + [Variant("f32", "strict", a, bounces if mirrors else 0) for a in accelerators if a != "bvh"]


def reference(scene: Scene, backend: str, bounces: int) -> Renderer:
    """Return the renderer of the picture in f64: on the backend, or on numpy where that has none."""
    accel = "brute" if scene.triangles <= _BRUTE else "bvh"  # accelerators differ in time alone
    exact = Whitted(bounces=bounces, precision="f64", accel=accel)
    try:
        return Renderer(scene, integrator=exact, backend=backend)
    except sh.CompileError as error:
        warn(f"the reference is rendered on numpy, which is slower: {backend} has no f64 ({error.message})")
        return Renderer(scene, integrator=exact, backend="numpy")


def _times(renderers: Sequence[tuple[Variant, Renderer]]) -> list[tuple[float, tuple[float, float]]]:
    """Return the seconds of a picture by each renderer, the median of the rounds, and their quartiles."""
    times: list[tuple[float, tuple[float, float]]] = sh.accuracy.pareto.timed(
        [partial(renderer.render, SIZE) for _, renderer in renderers], ROUNDS, _ENOUGH
    )
    return times


def _candidate(
    variant: Variant,
    renderer: Renderer,
    timing: tuple[float, tuple[float, float]],
    cameras: Sequence[Any],
    references: Sequence[Image],
) -> Candidate:
    errors_by_camera = [errors(renderer.render(SIZE, camera=c), r) for c, r in zip(cameras, references, strict=True)]
    return Candidate(variant, *timing, errors_by_camera[0], max(errors_by_camera[1:], key=lambda e: e["rmse"]))
