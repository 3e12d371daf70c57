"""The samples of a layered depth cube, from the collective operations over streams: on every backend the same bits.

Stage: accelerate. Each triangle gives rows, each row a span, each texel of a span a sample; a scan of the counts gives
the start of each. Samples are sorted by depth and then by texel, both stable, so those of a texel stand in the order of
depth and, at equal depths, of the triangle's number. Memory grows with the samples.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.accel.bounds import FAR
from raytracer.errors import SceneError
from raytracer.layered import raster
from raytracer.layered.halves import Codes, decoded, depth_codes
from raytracer.layered.peeling import Spans, peeled
from raytracer.memory import free_bytes

_table: Any = sh.Table  # untyped: a stream brings its own type
_BYTES = 100
"""Bytes that a sample takes while samples are sorted."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples by texel and depth: those of texel k at `offsets[k] : offsets[k + 1]`, for the texels of three images.

    `depths` (n,), `triangles` (n,) and `slopes` (n, 2) are those of the samples (see `raster.Sample`), `ranges`
    and `slices`, each (3 B B, 2), those of the blocks (see `raster.Block`), B blocks along a side. `weights` (n, 2) are
    those of corners 1 and 2 of a sample's triangle, at the sample; None where nothing is shaded from samples. `halves`
    (n,) are the bits of binary16 that `depths` were decoded from (see `halves`); None for depths of binary32.
    """

    offsets: NDArray[np.int32]
    depths: NDArray[np.float32]
    triangles: NDArray[np.int32]
    slopes: NDArray[np.float32]
    ranges: NDArray[np.float32]
    slices: NDArray[np.uint32]
    weights: NDArray[np.float32] | None = None
    halves: Codes | None = None


class Scanlines:
    """The spans of triangles (see `triangle_rows`) in the raster of a `frame` (see `raster`)."""

    def __init__(self, triangles: NDArray[Any], frame: NDArray[np.float32], conservative: bool, backend: str) -> None:
        self.backend = backend
        self.resolution, _, self.blocks = map(int, frame[raster.COUNTS, :3])
        corners = sh.Stream(np.asarray(triangles, np.float32), sh.Attrib4f, backend=backend)
        self.frame = _table(sh.Stream(frame, sh.Attrib4f, backend=backend))
        self.triangles = _table(corners)
        first, rows = self.run(raster.rows_of_triangles(conservative), shape=(len(triangles) // 3,))
        number, starts = self.owners(rows, "rows of texels")
        self.spans: Any = None
        if number.size:
            self.spans = self.run(raster.spans_of_rows(conservative), number, _table(starts), _table(first))

    def run(self, program: Any, *inputs: Any, shape: Any = None) -> Any:
        """Run a program whose first inputs are the triangles and the frame."""
        return program.on(self.backend)(self.triangles, self.frame, *inputs, shape=shape)

    def owners(self, counts: Any, what: str) -> tuple[Any, Any]:
        """Return the number of the element that owns each of the counted parts, and where each element's parts begin.

        The number of an element is put where its parts begin. Elements without parts begin where the next one does, and
        of several values for a place the last one stays.
        """
        total = int(np.asarray(counts).sum(dtype=np.int64))
        check_count(total, what)
        starts = sh.scan(raster.added.program, counts, exclusive=True)
        number = raster.numbered.on(self.backend)(shape=counts.shape)
        number = sh.Stream(number, sh.Attrib1i, backend=self.backend)
        return sh.scan(raster.larger.program, sh.scatter(number, starts, (total,))), starts

    def samples(self) -> Any:
        """Return the samples in the order of triangles, rows and columns, as streams; None if there are none."""
        if self.spans is None:
            return None
        number, starts = self.owners(self.spans.number, "samples")
        tables = map(_table, (starts, self.spans.triangle, self.spans.row, self.spans.first))
        return self.run(raster.samples_of_spans, number, *tables) if number.size else None

    def weights(self, samples: Samples) -> NDArray[np.float32]:
        """Return where samples lie in their triangles."""
        texel = np.repeat(np.arange(len(samples.offsets) - 1, dtype=np.int32), np.diff(samples.offsets))
        return np.asarray(self.run(raster.weights_of_samples, texel, samples.triangles))


def build_samples(
    triangles: NDArray[Any],
    frame: NDArray[np.float32],
    conservative: bool,
    backend: str,
    builder: str,
    shaded: bool,
    half: bool = False,
) -> Samples:
    """Return the samples of triangles (see `triangle_rows`) in the raster of a `frame` (see `raster`).

    `builder` is one of BUILDERS; `shaded` asks for weights, `half` for depths of binary16. Raises SceneError if there
    are more samples than memory holds.
    """
    if not len(triangles):
        return nothing(*(int(frame[raster.COUNTS, k]) for k in (0, 2)))
    lines = Scanlines(triangles, frame, conservative, backend)
    streams = BUILDERS[builder](lines)
    if streams is None:
        return nothing(lines.resolution, lines.blocks)
    offsets, depths, triangle, slopes = streams
    halves = None
    if half:
        texels = np.asarray(offsets)
        halves = depth_codes(frame, texels, np.asarray(depths))
        depths = sh.Stream(decoded(frame, texels, halves), sh.Attrib1f, backend=backend)
    coarse = raster.coarse_blocks.on(backend)
    blocks = coarse(lines.frame, _table(offsets), _table(depths), shape=(3 * lines.blocks**2,))
    samples = Samples(*(np.asarray(part) for part in (offsets, depths, triangle, slopes, *blocks)))
    return replace(samples, halves=halves, weights=lines.weights(samples) if shaded else None)


def sorted_samples(lines: Scanlines) -> tuple[Any, ...] | None:
    """Return the offsets, depths, triangles and slopes of `Samples` as streams, by sorting; None if there are none."""
    samples = lines.samples()
    if samples is None:
        return None
    by_depth = sh.argsort(samples.depth)
    order = sh.gather(by_depth, sh.argsort(sh.gather(samples.texel, by_depth)))
    counts = sh.histogram(samples.texel, 3 * lines.resolution**2 + 1)
    parts = (sh.gather(part, order) for part in (samples.depth, samples.triangle, samples.slope))
    return sh.scan(raster.added.program, counts, exclusive=True), *parts


def peeled_samples(lines: Scanlines) -> tuple[Any, ...] | None:
    """Return the result of `sorted_samples`, with the samples in the order of depth peeling."""
    spans, backend = lines.spans, lines.backend
    if spans is None:
        return None
    plane = lines.run(raster.planes_of_spans, spans.triangle)
    place = np.stack([np.asarray(part) for part in (spans.row, spans.first, spans.number)], axis=1)
    owner = np.stack([np.asarray(part) for part in (plane.image, spans.triangle)], axis=1)
    check_count(int(place[:, 2].sum(dtype=np.int64)), "samples")
    offsets, triangle = peeled(Spans(place, owner, np.asarray(plane.corner), np.asarray(plane.slope)), lines.resolution)
    if not len(triangle):
        return None
    texel = np.repeat(np.arange(len(offsets) - 1, dtype=np.int32), np.diff(offsets))
    parts = (sh.Stream(part, sh.Attrib1i, backend=backend) for part in (texel, triangle))
    samples = lines.run(raster.samples_of_texels, *parts)
    return sh.Stream(offsets, sh.Attrib1i, backend=backend), samples.depth, samples.triangle, samples.slope


BUILDERS: dict[str, Callable[[Scanlines], tuple[Any, ...] | None]] = {"sort": sorted_samples, "peel": peeled_samples}
"""The ways to put samples into their order: by collective operations; by the passes of the paper on OpenGL."""


def nothing(resolution: int, blocks: int) -> Samples:
    """Return the samples of a scene in which no triangle has an area."""
    ranges = np.tile(np.array([FAR, -FAR], np.float32), (3 * blocks**2, 1))
    offsets, slopes = np.zeros(3 * resolution**2 + 1, np.int32), np.zeros((0, 2), np.float32)
    slices = np.zeros((3 * blocks**2, 2), np.uint32)
    halves = np.zeros(0, np.uint16)
    return Samples(offsets, slopes[:, 0], np.zeros(0, np.int32), slopes, ranges, slices, slopes, halves)


def check_count(count: int, what: str) -> None:
    """Raise SceneError for more samples, or rows of them, than memory or an index holds."""
    free = free_bytes() if count * _BYTES > 1 << 28 else None
    if count >= 2**31 or (free is not None and count * _BYTES > free):
        raise SceneError(
            f"the layered depth cube has {count:,} {what}, which take {count * _BYTES:,} bytes while they are sorted: "
            "choose a lower resolution"
        )
