"""From a scene to a picture: lays the scene out, records and compiles the tracer, and runs it over bands of rows.

Stage: render. A `Renderer` keeps the compiled kernel of one scene; `render` makes one and uses it once.

    image = render(Scene.builtin("boxes"), size=(512, 512), backend="numpy", bounces=2)
    image.save("boxes.png")
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from math import isqrt
from typing import Any

import numpy as np

import shpy as sh
from raytracer.accel.choice import check
from raytracer.camera import Camera
from raytracer.errors import SceneError
from raytracer.image import Image, Stats
from raytracer.kernels.tracer import Pixel, Tracer
from raytracer.layout import Layout
from raytracer.memory import check_fits
from raytracer.scene import Scene

Progress = Callable[[int, int], None]
"""Called with the rows that are done and all rows, after each band."""

_BAND = 1 << 14
"""Rays of a band on numpy: few enough for progress to be seen and Ctrl-C to be heard."""
_DEVICE_BAND = 1 << 19
"""Rays of a band on a device: enough to keep it busy."""


class Renderer:
    """The compiled tracer of one scene, for pictures of any size from any camera.

    `backend` is one of `sh.backends()`, None for the default one; `bounces` how often a ray may be mirrored; `accel`
    one of `accel.choice.ACCELERATORS`.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        backend: str | None = None,
        bounces: int = 3,
        precision: str = "f32",
        math: str = "strict",
        accel: str = "bvh",
    ) -> None:
        if isinstance(bounces, bool) or not isinstance(bounces, int) or not 0 <= bounces <= 64:
            raise SceneError(f"bounces is a number from 0 to 64, not {bounces!r}")
        check(accel)
        self.scene = scene
        self.backend = backend or sh.default_backend()
        started = time.perf_counter()
        self.layout = Layout.of(scene, accel, precision) if scene.triangles else None
        self.build_seconds = time.perf_counter() - started
        self.record_seconds = self.compile_seconds = 0.0
        self.features: dict[str, bool | int] = {}
        if self.layout is None:
            return
        started = time.perf_counter()
        tracer = Tracer(self.layout, scene.background, scene.ambient, bounces, self.backend)
        self.features = tracer.features
        self.program = eye_rays(tracer)
        recorded = time.perf_counter()
        # No budget of turns: each turn of the walk leaves a triangle or a cell behind, each of the tracer's a ray.
        self.kernel = self.program.compile(self.backend, precision=precision, math=math, loop_limit=None)
        self.record_seconds = recorded - started
        self.compile_seconds = time.perf_counter() - recorded

    def render(
        self,
        size: tuple[int, int] = (512, 512),
        *,
        camera: Camera | None = None,
        samples: int = 1,
        progress: Progress | None = None,
    ) -> Image:
        """A picture of `size` = (width, height) pixels; see `render`."""
        width, height = _checked(size)
        fine = isqrt(samples) if isinstance(samples, int) and samples > 0 else 0
        if fine < 1 or fine * fine != samples or fine > 8:
            raise SceneError(f"samples is a square number from 1 to 64, not {samples!r}")
        started = time.perf_counter()
        layers = _unset(width, height)
        if self.layout is None:
            _clear(layers, self.scene.background)
        else:
            self._aim(camera or self.scene.camera, width * fine, height * fine)
            rows = max(1, (_BAND if self.backend == "numpy" else _DEVICE_BAND) // (width * fine * fine))
            for top in range(0, height, rows):
                count = min(rows, height - top)
                self._band(layers, top, count, width, fine)
                if progress is not None:
                    progress(top + count, height)
        stats = Stats(
            backend=self.backend,
            seconds=time.perf_counter() - started,
            build_seconds=self.build_seconds,
            record_seconds=self.record_seconds,
            compile_seconds=self.compile_seconds,
            rays=int(layers["rays"].sum(dtype=np.int64)),
            triangles=self.scene.triangles,
            features=self.features,
        )
        return Image(**layers, stats=stats)

    def _aim(self, camera: Camera | None, width: int, height: int) -> None:
        assert camera is not None  # a scene frames one if it has none
        assert self.layout is not None
        view = camera.view(width, height)
        view = view._replace(eye=(view.eye - self.layout.origin) * self.layout.scale)
        for name, value in view._asdict().items():
            self.program.params[name].value = value

    def _band(self, layers: dict[str, Any], top: int, count: int, width: int, fine: int) -> None:
        """Trace rows `top` to `top + count` and put them into the layers."""
        assert self.layout is not None
        self.program.params["first_row"].value = top * fine
        band = Pixel(*(layer[top : top + count] for layer in layers.values()))
        if fine == 1 and self.kernel.options.precision == "f32":
            self.kernel.run(shape=(count, width), out=band)
            self._unscale(band)
            return
        found = self.kernel(shape=(count * fine, width * fine))
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


def eye_rays(tracer: Tracer) -> Any:
    """The program of the whole picture: makes the eye ray of each pixel of a band and traces it."""
    eye = sh.Param(sh.Point3f, (0, 0, 0), name="eye")
    corner = sh.Param(sh.Vector3f, (0, 0, 0), name="corner")
    across = sh.Param(sh.Vector3f, (0, 0, 0), name="across")
    down = sh.Param(sh.Vector3f, (0, 0, 0), name="down")
    first_row = sh.Param(sh.Attrib1f, 0, name="first_row")

    @sh.program
    def picture() -> Pixel:
        row, column = sh.grid_index(2)
        ray = sh.normalize(corner + (column + 0.5) * across + (row + first_row + 0.5) * down)
        return tracer(ray, sh.Point3f(eye))

    return picture


def render(
    scene: Scene,
    size: tuple[int, int] = (512, 512),
    *,
    backend: str | None = None,
    bounces: int = 3,
    samples: int = 1,
    precision: str = "f32",
    math: str = "strict",
    accel: str = "bvh",
    max_error: float | None = None,
    progress: Progress | None = None,
) -> Image:
    """The picture of a scene from its camera, `size` = (width, height) pixels.

    `bounces` is how often a ray may be mirrored; `samples` how many rays there are for each pixel, a square number,
    on a regular grid (colours are averaged, the other layers show the middle one); `precision` and `math` are those of
    `sh.Program.compile`; `accel` is "bvh", "grid" or "brute", which differ in time alone. An empty scene shows its
    background.

    With `max_error`, a root mean square error in 255ths of sRGB, the fastest variant that `tradeoff` finds within it is
    rendered: `precision`, `math`, `accel` and fewer bounces are its choice, which `image.stats.picked` names.

    Raises SceneError for sizes and numbers that make no picture, for pictures that do not fit into memory, for another
    accelerator, and for an error that no
    variant keeps; sh.BackendUnavailable for a backend that is not there.
    """
    _checked(size)  # before a scene is laid out and compiled
    if max_error is not None and scene.triangles:
        from raytracer.trade import fastest

        variant, chosen = fastest(scene, max_error, backend, bounces)
        image = chosen.render(size, samples=samples, progress=progress)
        return dataclasses.replace(image, stats=dataclasses.replace(image.stats, picked=str(variant)))
    renderer = Renderer(scene, backend=backend, bounces=bounces, precision=precision, math=math, accel=accel)
    return renderer.render(size, samples=samples, progress=progress)


def _checked(size: tuple[int, int]) -> tuple[int, int]:
    try:
        width, height = (int(n) for n in size if int(n) == n)
    except (TypeError, ValueError):
        raise SceneError(f"a size is (width, height) in whole pixels, not {size!r}") from None
    if not (1 <= width <= 32768 and 1 <= height <= 32768):
        raise SceneError(f"a picture is from 1 to 32768 pixels wide and high, not {width} x {height}")
    check_fits(width, height)
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
