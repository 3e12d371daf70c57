"""A picture that becomes better: coarse at once, then with all pixels, then with more samples, piece by piece.

Stage: the command line, in the worker. Between two pieces a session hears what the user does, so a piece takes a short
time, which the times of those before tell.

    refinement = Refinement(renderer, Pace(), (512, 512), camera)
    for piece in refinement:
        refinement.shown              # (512, 512, 4) bytes, or of a smaller picture while piece.coarse
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.image import srgb_bytes
from raytracer.integrators.integrator import Integrator, Path
from raytracer.integrators.layers import unset
from raytracer.integrators.renderer import Renderer
from raytracer.scene.camera import Camera
from raytracer.scene.scene import Scene

_ANSWER: Final = 0.06
"""Seconds that the first picture after a change is to take."""
_PIECE: Final = 0.1
"""Seconds that a piece of a later picture is to take; more, where a call of a few rays takes nearly as long."""
_SMALLEST: Final = 48
"""Pixels along the longer side of a coarse picture: the least number."""
_AT_ONCE: Final = 16
"""Samples that path tracing adds to a pixel at once: the largest number."""


@dataclass
class Pace:
    """The time of the last coarse picture, which predicts better than single rows: it has all parts of a picture."""

    rays: int = _SMALLEST**2
    seconds: float | None = None
    plain: bool = False
    """True if even the smallest picture takes too long with mirrors, so that coarse pictures leave them out."""

    def learn(self, rays: int, seconds: float, *, smallest: bool) -> None:
        """Store the rays and seconds of the last coarse picture; set `plain` where even the `smallest` one was slow."""
        if not self.plain:
            self.rays, self.seconds = rays, seconds
            self.plain = smallest and seconds > _ANSWER
        elif seconds < _ANSWER / 4:  # the machine was busy with something else
            self.rays, self.seconds, self.plain = rays, None, False

    def forget(self) -> None:
        """Know nothing of the times of pictures."""
        self.rays, self.seconds, self.plain = _SMALLEST**2, None, False

    def count(self, seconds: float) -> int:
        """Return how many rays take this many seconds, at the speed of the last picture."""
        return self.rays if self.seconds is None else round(self.rays * min(seconds / self.seconds, 4.0))

    @property
    def piece(self) -> float:
        """The seconds for a piece: twice those of the smallest picture, where rays are few and calls take long."""
        return max(_PIECE, 2 * (self.seconds or 0.0)) if self.plain else _PIECE


@dataclass(frozen=True)
class Piece:
    """One step of a picture: the samples that it computes, the share of the picture that has them, and its seconds.

    `plain` is True for a coarse picture without mirrored and scattered rays, which would have taken too long.
    """

    coarse: bool
    samples: int
    share: float
    seconds: float
    plain: bool = False


class Refinement:
    """The steps of one picture, as an iterator of `Piece`; `shown` are the pixels in sRGB after each.

    `layers` are those of an `Image`, of the size of `shown`. `stops` and `tonemap` are the exposure and the curve of
    `Image.save`. With `at_once` a coarse picture is the last one, as while the scene moves.
    """

    def __init__(
        self,
        renderer: Renderer,
        pace: Pace,
        size: tuple[int, int],
        camera: Camera,
        stops: float = 0.0,
        tonemap: str = "none",
        *,
        at_once: bool = False,
    ) -> None:
        self._renderer, self._pace = renderer, pace
        self.size, self.camera, self.stops, self.tonemap = size, camera, stops, tonemap
        self.at_once = at_once
        self.layers: dict[str, NDArray[Any]] = {}
        self.shown: NDArray[np.uint8] = np.zeros((1, 1, 4), np.uint8)
        self.last: Piece | None = None
        self._steps = self._refined()

    def __iter__(self) -> Iterator[Piece]:
        return self

    def __next__(self) -> Piece:
        self.last = next(self._steps)
        return self.last

    @property
    def finished(self) -> bool:
        """True once all pixels have all samples."""
        last, samples = self.last, self._renderer.integrator.samples
        return last is not None and not last.coarse and (last.samples, last.share) == (samples, 1.0)

    def expose(self, stops: float) -> None:
        """Show the picture with another exposure, without tracing a ray."""
        self.stops = stops
        self._develop(0, len(self.shown))

    def _refined(self) -> Iterator[Piece]:
        unknown = self._pace.seconds is None
        piece = self._first()
        yield piece
        if unknown and piece.coarse:
            piece = self._first()
            yield piece
        if piece.coarse and self.at_once:
            return
        self._enlarge()
        for first, past in self._stages():
            if past > 1 or piece.coarse:  # otherwise the first picture had all pixels
                yield from self._stage(first, past)

    def _stages(self) -> Iterator[tuple[int, int]]:
        """Yield the samples of a pixel before and after each stage."""
        most, done = self._renderer.integrator.samples, 0
        while done < most:
            if isinstance(self._renderer.integrator, Path):
                past = min(max(1, 2 * done), done + _AT_ONCE, most)
            else:
                past = min(max(1, 4 * done), most)
            yield done, past
            done = past

    def _small(self) -> tuple[int, int]:
        """Return the size of the first picture."""
        width, height = self.size
        scale = max((self._pace.count(_ANSWER) / (width * height)) ** 0.5, _SMALLEST / max(self.size))
        return (max(1, round(scale * width)), max(1, round(scale * height))) if scale < 1 else self.size

    def _first(self) -> Piece:
        """Render the whole picture, at the largest size that takes a short time."""
        small, plain, notes = self._small(), self._pace.plain, self._notes
        begun = time.perf_counter()
        with _plain(self._renderer) if plain else nullcontext():
            self.layers = self._renderer.rows(small, 0, small[1], camera=self.camera, samples=1)
        seconds = time.perf_counter() - begun
        if self._notes == notes:
            self._pace.learn(small[0] * small[1], seconds, smallest=max(small) <= _SMALLEST)
        else:  # the driver has optimized the kernel meanwhile: times of before say nothing
            self._pace.forget()
        self.shown = np.zeros((small[1], small[0], 4), np.uint8)
        self._develop(0, small[1])
        return Piece(plain or small != self.size, 1, 1.0, seconds, plain)

    @property
    def _notes(self) -> tuple[str, ...]:
        """The notes of the kernel."""
        kernel = self._renderer.kernel
        return () if kernel is None else kernel.notes

    def _enlarge(self) -> None:
        """Enlarge the coarse picture to the full size, to be shown until its rows are computed."""
        width, height = self.size
        if self.shown.shape[:2] == (height, width):
            return
        rows, columns = len(self.shown), len(self.shown[0])
        place = np.ix_(np.arange(height) * rows // height, np.arange(width) * columns // width)
        larger = unset(width, height)
        for name, layer in self.layers.items():
            larger[name][:] = layer[place]
        self.layers, self.shown = larger, self.shown[place]

    def _stage(self, first: int, past: int) -> Iterator[Piece]:
        """Compute samples `first` to `past` - 1 of all pixels, band by band from the top."""
        width, height = self.size
        traced = isinstance(self._renderer.integrator, Path)
        row_of_rays = width * (past - first if traced else past)
        top, duration = 0, self._pace.piece
        count = max(1, self._pace.count(duration) // row_of_rays)
        while top < height:
            count = min(count, height - top)
            begun = time.perf_counter()
            band = {name: layer[top : top + count] for name, layer in self.layers.items()}
            start = (band, first) if traced and first else None
            rows = self._renderer.rows(self.size, top, count, camera=self.camera, samples=past, start=start)
            seconds = time.perf_counter() - begun
            for name, layer in self.layers.items():
                layer[top : top + count] = rows[name]
            self._develop(top, top + count)
            top += count
            yield Piece(False, past, top / height, seconds)
            count = max(1, int(count * min(duration / seconds, 2.0)))  # rows below may be of more than background

    def _develop(self, top: int, past: int) -> None:
        """Recompute rows of `shown` from `layers`."""
        light = self.layers["pixels"][top:past]
        self.shown[top:past, :, :3] = srgb_bytes(light, self.stops, self.tonemap)  # the bytes that a file would have
        self.shown[top:past, :, 3] = 255


@contextmanager
def _plain(renderer: Renderer) -> Iterator[None]:
    """Trace no mirrored rays meanwhile; path tracing scatters light once, as otherwise only lamps would be seen."""
    bounces = renderer.params.get("bounces")
    if bounces is None:
        yield
        return
    before = bounces.value
    bounces.value = 1 if isinstance(renderer.integrator, Path) else 0
    try:
        yield
    finally:
        bounces.value = before


@dataclass(frozen=True, slots=True)
class Form:
    """A backend and an integrator, as a `Renderer` takes them."""

    backend: str
    integrator: Integrator

    def __str__(self) -> str:
        return f"{type(self.integrator).__name__} on {self.backend}"


@dataclass(eq=False)
class Drawer:
    """A renderer, the scene that it shows, and how long its rays take."""

    form: Form
    renderer: Renderer
    scene: Scene
    pace: Pace = field(default_factory=Pace)

    def show(self, scene: Scene) -> None:
        """Switch to another scene, from the next picture on."""
        if scene is not self.scene:
            self.renderer.show(scene)
            self.scene = scene


class Renderers:
    """Renderers by their form, each made in a thread; a form that failed keeps its error until it is asked for."""

    def __init__(self, wake: Callable[[], None]) -> None:
        self._drawers: sh.view.Background[Form, Drawer] = sh.view.Background(wake)
        self._last: Drawer | None = None

    def best(self, form: Form, scene: Scene) -> Drawer | None:
        """Return the wanted drawer; until it is made, the last one used, or None if there is none.

        Raises the error with which the wanted drawer could not be made.
        """
        self._drawers.begin(form, partial(_make, form, scene))
        error = self._drawers.error(form)
        if error is not None:
            # Another scene, such as one without glass, may be possible.
            self._drawers.forget(form)
            raise error
        if self._drawers.is_done(form):
            self._last = self._drawers.result(form)
        return self._last

    def is_ready(self, form: Form) -> bool:
        """Return whether a form has been made, or has failed."""
        return self._drawers.has_ended(form)


def _make(form: Form, scene: Scene) -> Drawer:
    return Drawer(form, Renderer(scene, integrator=form.integrator, backend=form.backend), scene)
