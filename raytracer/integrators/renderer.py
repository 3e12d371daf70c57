"""From a scene to a picture: lays the scene out, records and compiles the tracer, and runs it over bands of rows.

Stage: render. A `Renderer` keeps the compiled kernel of one scene; `render` makes one and uses it once.

    image = render(Scene.builtin("boxes"), size=(512, 512), backend="numpy", bounces=2)
    image.save("boxes.png")
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator
from math import isqrt
from os import PathLike
from typing import Any, Final

import numpy as np

import shpy as sh
from raytracer.accel.choice import check
from raytracer.accel.grid import MAX_PER_SIDE
from raytracer.errors import SceneError
from raytracer.image import Image, Stats
from raytracer.integrators.progressive import MOST_SAMPLES, origin_of, passes, resumed
from raytracer.integrators.staged import Log, StagedTracer
from raytracer.kernels.eye_rays import EyeRays, PanoramaRays, eye_rays_of
from raytracer.kernels.glass import GlassTracer
from raytracer.kernels.path import PathTracer
from raytracer.kernels.tracer import Pixel, Tracer
from raytracer.layered.cube import LayeredCube, cube_of, is_layered
from raytracer.memory import check_fits
from raytracer.scene.camera import Camera
from raytracer.scene.layout import Layout
from raytracer.scene.scene import Scene

Progress = Callable[[int, int], None]
"""Called with the rows that are done and all rows, after each band."""

_BAND = 1 << 14
"""Rays of a band on numpy: few enough for progress to be seen and Ctrl-C to be heard."""
_DEVICE_BAND = 1 << 19
"""Rays of a band on a device: enough to keep it busy."""
_STAGED_BAND = 1 << 18
"""Rays of a band of the staged tracer, whose streams take about 300 bytes for each."""
TRACERS = ("unified", "staged")
INTEGRATORS = ("whitted", "path")
BOUNCES: Final = {"whitted": 3, "path": 8}
SAMPLES: Final = {"whitted": 1, "path": 64}
"""What an integrator does where nothing is said."""
PASSING = 36
"""Bytes of a pixel that path tracing needs besides the layers: those of the pass before."""
THRESHOLD = 0.2
"""The share of waiting rays in the thesis."""


class Renderer:
    """The compiled tracer of one scene, for pictures of any size from any camera.

    `backend` is one of `sh.backends()`, None for the default one; `bounces` how often a ray may be mirrored; `accel`
    one of `accel.choice.ACCELERATORS`, None for the one that suits the tracer. `tracer`, `threshold`, `grid`,
    `integrator`, `seed` and `secondary` are those of `render`, and so is `accel="ldc"`.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        backend: str | None = None,
        bounces: int | None = None,
        precision: str = "f32",
        math: str = "strict",
        accel: str | None = None,
        tracer: str = "unified",
        threshold: float = THRESHOLD,
        grid: int | None = None,
        integrator: str = "whitted",
        seed: int = 0,
        secondary: LayeredCube | None = None,
    ) -> None:
        _check_integrator(integrator, seed, scene, tracer, precision)
        bounces = BOUNCES[integrator] if bounces is None else bounces
        if isinstance(bounces, bool) or not isinstance(bounces, int) or not 0 <= bounces <= 64:
            raise SceneError(f"bounces is a number from 0 to 64, not {bounces!r}")
        cube, accel = _layered(accel, secondary, tracer, precision)
        accel = _checked_tracer(tracer, accel, threshold, grid)
        self.scene = scene
        self.backend = backend or sh.default_backend()
        started = time.perf_counter()
        self.layout = Layout.of(scene, accel, precision, grid) if scene.triangles else None
        if self.layout is not None and cube is not None:
            secondary = cube if isinstance(cube, LayeredCube) else cube_of(cube, scene, self.backend)
            self.layout = dataclasses.replace(self.layout, secondary=secondary)
        self.build_seconds = time.perf_counter() - started
        self.record_seconds = self.compile_seconds = 0.0
        self.features: dict[str, bool | int] = {}
        self.staged: StagedTracer | None = None
        self.program: Any = None
        self.kernel: Any = None
        self.params: dict[str, Any] = {}
        self.integrator, self.seed = integrator, seed
        if self.layout is None:
            return
        self._options: dict[str, Any] = {"precision": precision, "math": math}
        if cube is not None and self.backend == "opencl":
            self._options["lanes"] = 1  # rays in a cube part, so that packets of them take longer than rays alone
        self._threshold = threshold if tracer == "staged" else None
        started = time.perf_counter()
        self._tracer = self._tracer_of(self.layout, bounces)
        self.features = self._tracer.features | ({"layered cube": secondary.resolution} if secondary else {})
        self.record_seconds = time.perf_counter() - started
        self._kinds: dict[tuple[str, bool], dict[str, Any]] = {}
        assert scene.camera is not None  # a scene frames one if it has none
        self._choose(scene.camera)

    def _tracer_of(self, layout: Layout, bounces: int) -> Tracer | PathTracer:
        """The tracer of the integrator and of what the scene has."""
        if self.integrator == "path":
            return PathTracer(layout, self.scene, bounces, self.backend)
        given: Any = (layout, self.scene.background, self.scene.ambient, bounces, self.backend)
        tracer = Tracer(*given)
        if not tracer.surfaces.clear:
            return tracer
        if self._threshold is not None:
            raise SceneError("the staged tracer follows mirrored rays alone, and this scene has glass: unified")
        return GlassTracer(*given)

    def _choose(self, camera: Camera) -> None:
        """Take the kernels for a camera's projection, compiled once."""
        kind = camera.projection, bool(camera.aperture)
        if kind not in self._kinds:
            self._kinds[kind] = self._compiled(camera)
        self.__dict__.update(self._kinds[kind])

    def _compiled(self, camera: Camera) -> dict[str, Any]:
        """The kernels for a camera's projection, as attributes."""
        started, rays = time.perf_counter(), eye_rays_of(camera)
        if isinstance(self._tracer, PathTracer):
            program = self._tracer.program(rays)
        elif self._threshold is not None:
            staged = StagedTracer(self._tracer, rays, backend=self.backend, threshold=self._threshold, **self._options)
            self.compile_seconds += time.perf_counter() - started
            return {"staged": staged, "params": staged.params}
        else:
            program = eye_rays(self._tracer, rays)
        recorded = time.perf_counter()
        # No budget of iterations: each one of the walk finishes a triangle or a cell, each one of the tracer a ray.
        kernel = program.compile(self.backend, **self._options, loop_limit=None)
        self.record_seconds += recorded - started
        self.compile_seconds += time.perf_counter() - recorded
        return {"program": program, "kernel": kernel, "params": program.params}

    def render(
        self,
        size: tuple[int, int] = (512, 512),
        *,
        camera: Camera | None = None,
        samples: int | None = None,
        progress: Progress | None = None,
        resume: Image | str | PathLike[str] | None = None,
    ) -> Image:
        """A picture of `size` = (width, height) pixels; see `render`."""
        samples = SAMPLES[self.integrator] if samples is None else samples
        if self.integrator == "path":
            *_, image = self.passes(size, camera=camera, samples=samples, progress=progress, resume=resume)
            return image
        if resume is not None:
            raise SceneError('resume is for integrator="path": other pictures have no samples to add to')
        width, height = _checked(size)
        fine = isqrt(samples) if isinstance(samples, int) and samples > 0 else 0
        if fine < 1 or fine * fine != samples or fine > 8:
            raise SceneError(f"samples is a square number from 1 to 64, not {samples!r}")
        started = time.perf_counter()
        layers = _unset(width, height)
        if self.layout is None:
            _clear(layers, self.scene.background)
        else:
            camera = camera or self.scene.camera
            assert camera is not None  # a scene frames one if it has none
            self._choose(camera)
            self._aim(camera, width * fine, height * fine)
            if self.staged is not None:
                self.staged.log = Log()
            rows = max(1, self._rays_at_once // (width * fine * fine))
            for top in range(0, height, rows):
                count = min(rows, height - top)
                self._band(layers, top, count, width, fine)
                if progress is not None:
                    progress(top + count, height)
        return Image(**layers, stats=self._stats(layers, started), samples=samples)

    def passes(
        self,
        size: tuple[int, int] = (512, 512),
        *,
        camera: Camera | None = None,
        samples: int | None = None,
        progress: Progress | None = None,
        resume: Image | str | PathLike[str] | None = None,
    ) -> Iterator[Image]:
        """Yield the path traced picture as it is after each pass over all pixels, the last one with all `samples`.

        For `integrator="path"`; see `render`.
        """
        if self.integrator != "path":
            raise SceneError('passes are those of integrator="path"')
        samples = SAMPLES["path"] if samples is None else samples
        if isinstance(samples, bool) or not isinstance(samples, int) or not 1 <= samples <= MOST_SAMPLES:
            raise SceneError(f"samples is a number from 1 to {MOST_SAMPLES:,}, not {samples!r}")
        width, height = _checked(size, PASSING)
        started, layers, first, origin = time.perf_counter(), _unset(width, height), 0, ""
        _clear(layers, self.scene.background)
        if self.layout is None:
            first = samples
        else:
            assert isinstance(self._tracer, PathTracer)
            camera = camera or self.scene.camera
            assert camera is not None  # a scene frames one if it has none
            self._choose(camera)
            self._aim(camera, width, height)
            self.params["seed"].value = self.seed
            origin = origin_of(self.scene, self.layout, self._tracer, camera, self.seed)
            layers["pixels"][:] = layers["rays"][:] = 0  # the mean of no samples
            if resume is not None:
                layers, first = resumed(resume, (width, height), origin, samples)
        if first == samples:
            yield Image(**layers, stats=self._stats(layers, started), samples=samples, origin=origin)
            return
        assert self.layout is not None  # of another scene the first samples are all
        # A driver without a GPU ends loops of many iterations, and rays take more of them through a cube.
        at_once = 1 if self.backend == "glsl" and self.layout.secondary is not None else None
        device = self.kernel, self.params, self.backend, self.layout.scale
        for found, done in passes(*device, layers, first, samples, progress, at_once):
            yield Image(**found, stats=self._stats(found, started), samples=done, origin=origin)

    def _stats(self, layers: dict[str, Any], started: float) -> Stats:
        return Stats(
            backend=self.backend,
            seconds=time.perf_counter() - started,
            build_seconds=self.build_seconds,
            record_seconds=self.record_seconds,
            compile_seconds=self.compile_seconds,
            rays=int(layers["rays"].sum(dtype=np.int64)),
            triangles=self.scene.triangles,
            features=self.features,
            calls={} if self.staged is None else dict(self.staged.log.calls),
            alive=() if self.staged is None else tuple(self.staged.log.alive),
        )

    @property
    def _rays_at_once(self) -> int:
        if self.staged is not None:
            return _STAGED_BAND
        return _BAND if self.backend == "numpy" else _DEVICE_BAND

    def _aim(self, camera: Camera, width: int, height: int) -> None:
        assert self.layout is not None
        for name, value in camera.uniforms(width, height, self.layout.origin, self.layout.scale).items():
            self.params[name].value = value

    def _band(self, layers: dict[str, Any], top: int, count: int, width: int, fine: int) -> None:
        """Trace rows `top` to `top + count` and put them into the layers."""
        assert self.layout is not None
        self.params["first_row"].value = top * fine
        band = Pixel(*(layer[top : top + count] for layer in layers.values()))
        if fine == 1 and self.staged is None and self.kernel.options.precision == "f32":
            self.kernel.run(shape=(count, width), out=band)
            self._unscale(band)
            return
        shape = (count * fine, width * fine)
        found = self.kernel(shape=shape) if self.staged is None else self.staged.trace(shape)
        middle = slice(fine // 2, None, fine)
        for layer, given in zip(band, found, strict=True):
            layer[:] = given[middle, middle]
        if fine > 1:
            band.color[:] = found.color.reshape(count, fine, width, fine, 3).mean(axis=(1, 3))
            band.rays[:] = found.rays.reshape(count, fine, width, fine).sum(axis=(1, 3))
        self._unscale(band)

    def _unscale(self, band: Pixel) -> None:
        """Give distances in the scene's own units again."""
        assert self.layout is not None
        if self.layout.scale != 1:
            depth = np.asarray(band.depth)
            depth[:] = depth.astype(np.float64) / self.layout.scale


def eye_rays(tracer: Tracer, rays: EyeRays | PanoramaRays) -> Any:
    """The program of the whole picture: makes the eye ray of each pixel of a band and traces it."""

    @sh.program
    def picture() -> Pixel:
        row, column = sh.grid_index(2)
        return tracer(*rays(row, column))

    return picture


def render(
    scene: Scene,
    size: tuple[int, int] = (512, 512),
    *,
    backend: str | None = None,
    bounces: int | None = None,
    samples: int | None = None,
    precision: str = "f32",
    math: str = "strict",
    accel: str | None = None,
    tracer: str = "unified",
    threshold: float = THRESHOLD,
    grid: int | None = None,
    integrator: str = "whitted",
    seed: int = 0,
    secondary: LayeredCube | None = None,
    resume: Image | str | PathLike[str] | None = None,
    max_error: float | None = None,
    progress: Progress | None = None,
) -> Image:
    """The picture of a scene from its camera, `size` = (width, height) pixels; that of an empty one is its background.

    `bounces` (3) is how often a ray may be mirrored; `samples` (1) how many rays a pixel has, a square number, on a
    regular grid (colours are averaged, other layers show the middle one); `precision`, `math` as in `Program.compile`.
    `accel` is "bvh", "grid" or "brute", which differ in time alone; `secondary`, a `LayeredCube`, is for all rays but
    the eye's, and `accel="ldc[:resolution[:hit]]"` makes one.

    `tracer` is "unified", one kernel that follows a ray to its end, or "staged", kernels over streams of rays (Christen
    2005), which differ in time alone. The staged tracer walks through a grid or tries every triangle, once the share
    `threshold`, 0 to 1, of its rays waits for that. A grid has `grid` cells along each axis, or as many as suit it.

    `integrator` is "whitted", light from lights directly and by mirrors, or "path", an unbiased estimate of all light
    that surfaces scatter up to `bounces` (8) times, from `samples` (64) paths a pixel, hashed from `seed` (0 to 2**32 -
    1); `resume` continues one of fewer samples or its .exr or .npy file. Other layers are those of the first sample.

    With `max_error`, a root mean square error in 255ths of sRGB, the fastest variant that `tradeoff` finds within it is
    rendered: `precision`, `math`, `accel` and fewer bounces are its choice, which `image.stats.picked` names.

    Raises SceneError for sizes and numbers that make no picture, pictures that do not fit into memory, options that do
    not go together, and an error that no variant keeps; sh.BackendUnavailable for a missing backend.
    """
    _checked(size)  # before a scene is laid out and compiled
    if max_error is not None and scene.triangles:
        if tracer != "unified" or integrator != "whitted" or (accel, grid, secondary) != (None, None, None):
            raise SceneError("max_error chooses among the variants of the unified tracer: leave the choice to it")
        return _render_fastest(scene, size, max_error, backend, bounces, samples, progress)
    walk: dict[str, Any] = {"accel": accel, "secondary": secondary, "threshold": threshold, "grid": grid, "seed": seed}
    options: dict[str, Any] = {"backend": backend, "bounces": bounces, "precision": precision, "math": math}
    renderer = Renderer(scene, tracer=tracer, integrator=integrator, **options, **walk)
    return renderer.render(size, samples=samples, progress=progress, resume=resume)


def _render_fastest(
    scene: Scene,
    size: tuple[int, int],
    max_error: float,
    backend: str | None,
    bounces: int | None,
    samples: int | None,
    progress: Progress | None,
) -> Image:
    """The picture by the fastest variant that keeps an error."""
    from raytracer.studies.tradeoff import fastest  # here: it needs this module

    variant, renderer = fastest(scene, max_error, backend, BOUNCES["whitted"] if bounces is None else bounces)
    image = renderer.render(size, samples=samples, progress=progress)
    return dataclasses.replace(image, stats=dataclasses.replace(image.stats, picked=str(variant)))


def _check_integrator(integrator: str, seed: int, scene: Scene, tracer: str, precision: str) -> None:
    """Raise SceneError for an integrator that does not go with the scene, the tracer or the precision."""
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**32:
        raise SceneError(f"a seed is a whole number from 0 to 2**32 - 1, not {seed!r}")
    if integrator not in INTEGRATORS:
        raise SceneError(f"the integrator is one of {', '.join(map(repr, INTEGRATORS))}, not {integrator!r}")
    if integrator == "whitted":
        if scene.environment is not None:
            raise SceneError(
                'an EnvironmentLight shines with integrator="path" alone: choose it, or leave the light out'
            )
        return
    if tracer != "unified":
        raise SceneError(f'tracer={tracer!r} is for integrator="whitted": leave it out')
    if precision != "f32":
        raise SceneError(f'integrator="path" works at precision="f32", not {precision!r}')
    if not scene.triangles and scene.environment is not None:
        raise SceneError("a scene without triangles shows its background: an EnvironmentLight needs something to light")


def _layered(
    accel: str | None, secondary: Any, tracer: str, precision: str
) -> tuple[LayeredCube | str | None, str | None]:
    """The cube, or the name of one that is to be made, and the accelerator of eye rays.

    Raises SceneError if a cube cannot be used.
    """
    layered, accel = (accel, None) if accel is not None and is_layered(accel) else (None, accel)
    if secondary is not None and not isinstance(secondary, LayeredCube):
        raise SceneError(f"secondary is a LayeredCube, not {type(secondary).__name__}")
    cube = secondary or layered
    if cube and tracer != "unified":
        raise SceneError('secondary rays go through a layered depth cube with tracer="unified" alone')
    if cube and precision != "f32":
        raise SceneError(f'a layered depth cube works at precision="f32", not {precision!r}')
    return cube, accel


def _checked_tracer(tracer: str, accel: str | None, threshold: float, grid: int | None) -> str:
    """The accelerator; SceneError for a tracer, accelerator, threshold or grid that does not go with the others."""
    if tracer not in TRACERS:
        raise SceneError(f"the tracer is one of {', '.join(map(repr, TRACERS))}, not {tracer!r}")
    chosen = accel or ("grid" if tracer == "staged" else "bvh")
    check(chosen)
    if tracer == "staged" and chosen == "bvh":
        raise SceneError('the staged tracer goes through cells of a grid: accel="grid" or "brute", not "bvh"')
    if isinstance(threshold, bool) or not isinstance(threshold, int | float) or not 0 <= threshold <= 1:
        raise SceneError(f"a threshold is a share from 0 to 1, not {threshold!r}")
    if grid is None:
        return chosen
    if isinstance(grid, bool) or not isinstance(grid, int) or not 1 <= grid <= MAX_PER_SIDE:
        raise SceneError(f"a grid has from 1 to {MAX_PER_SIDE} cells along each axis, not {grid!r}")
    if chosen != "grid":
        raise SceneError(f'grid={grid} is for accel="grid", not {chosen!r}')
    return chosen


def _checked(size: tuple[int, int], saving: int = 0) -> tuple[int, int]:
    try:
        width, height = (int(n) for n in size if int(n) == n)
    except (TypeError, ValueError):
        raise SceneError(f"a size is (width, height) in whole pixels, not {size!r}") from None
    if not (1 <= width <= 32768 and 1 <= height <= 32768):
        raise SceneError(f"a picture is from 1 to 32768 pixels wide and high, not {width} x {height}")
    check_fits(width, height, saving)
    return width, height


def _unset(width: int, height: int) -> dict[str, Any]:
    """The layers of a picture, to be filled, in the order of `Pixel`."""
    return {
        "pixels": np.empty((height, width, 3), dtype=np.float32),
        "depth": np.empty((height, width), dtype=np.float32),
        "normal": np.empty((height, width, 3), dtype=np.float32),
        "object_id": np.empty((height, width), dtype=np.int32),
        "rays": np.empty((height, width), dtype=np.int32),
    }


def _clear(layers: dict[str, Any], background: Any) -> None:
    """Fill the layers with what is seen where nothing is hit."""
    nothing = {"pixels": background, "depth": np.inf, "normal": 0, "object_id": -1, "rays": 1}
    for name, value in nothing.items():
        layers[name][:] = value
