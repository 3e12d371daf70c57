"""The layers of a picture: its size, the memory or the file of each layer, and the samples that are put together in it.

Stage: render.

    layers = unset(*checked_size((640, 480)))
    clear(layers, background=(0, 0, 0))
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from typing import Any

import numpy as np

from raytracer.arrays import is_whole
from raytracer.errors import SceneError
from raytracer.image import ALPHA, LAYERS
from raytracer.kernels.pixel import Pixel
from raytracer.memory import PIXEL, check_fits

Progress = Callable[[int, int], None]
"""Called with the rows that are done and all rows, after each band."""
BANDS = {
    "numpy": 1 << 14,
    "device": 1 << 19,
    "staged": 1 << 18,
    "paths on numpy": 1 << 13,
    "paths on a device": 1 << 16,
    "parts": 1 << 17,
}
"""Rays of a band: few enough on numpy for progress to be seen and Ctrl-C to be heard, enough to keep a device busy.

A ray of the staged tracer takes about 300 bytes of streams. Rays of path tracing have several samples each.
"""


def rows_at_once(kind: str, rays_in_row: int) -> int:
    """Return the rows of a band of this kind, one of `BANDS`."""
    return max(1, BANDS[kind] // rays_in_row)


def checked_size(size: tuple[int, int], saving: int = 0) -> tuple[int, int]:
    """Return a size as (width, height); SceneError for one that makes no picture or exceeds the free memory.

    `saving` is how many bytes a pixel takes besides its layers.
    """
    width, height = whole_size(size)
    check_fits(width, height, saving)
    return width, height


def whole_size(size: tuple[int, int]) -> tuple[int, int]:
    """Return a size as (width, height); SceneError for one that makes no picture."""
    try:
        width, height = (int(n) for n in size if int(n) == n)
    except (TypeError, ValueError, OverflowError):
        raise SceneError(f"a size is (width, height) in whole pixels, not {size!r}") from None
    if not (1 <= width <= 32768 and 1 <= height <= 32768):
        raise SceneError(f"a picture is from 1 to 32768 pixels wide and high, not {width} x {height}")
    return width, height


def check_rows(top: int, count: int, height: int) -> None:
    """Raise SceneError unless `count` rows from `top` on are rows of a picture of this height."""
    if not (is_whole(top, 0, height) and is_whole(count, 0, height - top)):
        raise SceneError(f"a picture {height} pixels high has no {count!r} rows from row {top!r} on")


def unset(width: int, height: int, new: Callable[..., Any] = np.empty, *, transparent: bool = False) -> dict[str, Any]:
    """Return the layers of a picture, to be filled, in the order of `Pixel`; `new(shape, dtype)` makes each.

    A `transparent` picture has alpha after them.
    """
    kinds = {**LAYERS, ALPHA: (np.float32, ())} if transparent else LAYERS
    return {name: new((height, width, *shape), kind) for name, (kind, shape) in kinds.items()}


def clear(layers: dict[str, Any], background: Any) -> None:
    """Fill the layers with the values of a ray that hits nothing: the background, depth infinity, object -1.

    A background that is no colour is for kernels to find: its pixels are 0, as are those of a transparent picture.
    """
    color = background if isinstance(background, tuple) and ALPHA not in layers else 0
    nothing = {"pixels": color, "depth": np.inf, "normal": 0, "object_id": -1, "rays": 1, ALPHA: 0}
    for name, layer in layers.items():
        layer[:] = nothing[name]


def take_samples(band: Pixel, samples: Any, fine: int, alpha: Any = None) -> None:
    """Reduce the results of `fine` x `fine` eye rays per pixel to the layers of a band.

    Colours are averaged, numbers of rays added, and the other layers take the middle eye ray. With the layer `alpha`,
    that of a transparent picture, colours are those of the surfaces alone.
    """
    if alpha is not None:
        samples = samples._replace(color=np.array(samples.color))
        coverage = uncover(samples)
    count, width = np.shape(band.depth)
    middle = slice(fine // 2, None, fine)
    for layer, values in zip(band, samples, strict=True):
        layer[:] = values[middle, middle]
    if fine > 1:
        band.color[:] = samples.color.reshape(count, fine, width, fine, 3).mean(axis=(1, 3))
        band.rays[:] = samples.rays.reshape(count, fine, width, fine).sum(axis=(1, 3))
    if alpha is not None:
        alpha[:] = coverage.reshape(count, fine, width, fine).mean(axis=(1, 3))


def uncover(samples: Pixel) -> Any:
    """Make the colour of eye rays that met nothing 0; return whether each met a surface."""
    covered = np.asarray(samples.object) >= 0
    np.asarray(samples.color)[~covered] = 0
    return covered


def unscale(band: Pixel, scale: float) -> None:
    """Give distances in the scene's own units again."""
    if scale != 1:
        depth = np.asarray(band.depth)
        depth[:] = depth.astype(np.float64) / scale


def canvas(width: int, height: int) -> dict[str, Any]:
    """Return the layers of a picture, to be filled; SceneError where the folder for temporary files is too full."""
    folder = tempfile.gettempdir()
    needed, free = width * height * PIXEL, shutil.disk_usage(folder).free
    if needed > free:
        raise SceneError(
            f"a picture of {width} x {height} pixels takes {needed:,} bytes in {folder}, where {free:,} are free: "
            "choose a smaller size, or another folder by TMPDIR"
        )
    return unset(width, height, _array_in_file)


def _array_in_file(shape: tuple[int, ...], kind: Any) -> Any:
    with tempfile.TemporaryFile() as file:
        return np.asarray(np.memmap(file, kind, "w+", shape=shape))
