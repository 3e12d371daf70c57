"""The coordinates of kernels: where they begin, how large they are, and how they are rounded.

Stage: accelerate. Takes the corners of triangles in the scene's units, gives corners and rows in those of a kernel.

>>> scale_of(np.full((1, 3, 3), 0.5), "f32") == 2.0**EXPONENT
True
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raytracer.accel.planes import copy_columns, normals_of, parts
from raytracer.errors import SceneError

Rows = NDArray[np.float64]
WORKING: dict[str, type[np.floating]] = {"f16": np.float16, "f32": np.float32, "f64": np.float64}
"""The floats of a precision."""


def origin_of(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the origin of the kernels' coordinates, (3,): 0, or near the middle of triangles that lie far from 0.

    So the picture of a scene does not depend on its position. It is a multiple of a power of two that is about the
    size of the scene, so that subtracting it takes nothing from coordinates that were rounded already.
    """
    by_axis = [corners[..., axis] for axis in range(3)]  # ten times as fast as min over two axes of three
    low, high = np.array([x.min() for x in by_axis]), np.array([x.max() for x in by_axis])
    middle, size = (low + high) / 2, float((high - low).max())
    if size == 0:
        return np.asarray(middle)
    step = 2.0 ** np.floor(np.log2(size))
    return np.where(np.abs(middle) <= size, 0.0, np.round(middle / step) * step)


EXPONENT = 32
"""Exponent of 2 below which the largest coordinate lies in a kernel.

A kernel divides products of three lengths by products of two. With this exponent no product of three vanishes for a
triangle 10**21 times smaller than the scene. None overflows for a triangle as large as the scene that is seen from
2**24 times its size, where f32 no longer tells parts of the scene from each other.
"""
PAST_F16 = 65520.0
"""The least number that f16 rounds to infinity."""
STEEPEST = 1000
"""Exponent of the largest scale: in f64 it is finite, and so are its products with scenes that it enlarges."""


def scale_of(corners: NDArray[np.float64], precision: str) -> float:
    """Return the power of two for a kernel's coordinates, so that no product of them leaves f32's range.

    `corners` are relative to `origin_of`. At f16, which holds no such numbers, exponents above 0 stay as they are.
    Raises SceneError for a corner that f16 does not hold.
    """
    if not corners.any():
        return 1.0
    largest = float(np.abs(corners).max())
    if precision == "f16" and largest >= PAST_F16:
        raise SceneError(
            f"the scene reaches {largest:.6g} from its origin, and f16 holds numbers up to 65504: "
            'scale the meshes, or choose precision="f32"'
        )
    _, exponent = np.frexp(largest)
    limit = np.clip(exponent, 0, EXPONENT) if precision == "f16" else EXPONENT
    return float(2.0 ** min(limit - exponent, STEEPEST))


def placed(what: str, position: ArrayLike, origin: Rows, scale: float, dtype: np.dtype[Any]) -> Rows:
    """Return a position (3,) in the kernel's coordinates.

    Raises SceneError, which names the object `what`, if `dtype` cannot hold them.
    """
    with np.errstate(over="ignore"):
        coordinates = np.asarray(np.subtract(position, origin, dtype=np.float64) * scale)
    if not (np.abs(coordinates) <= np.finfo(dtype).max).all():
        place = ", ".join(f"{x:.6g}" for x in np.ravel(position))
        raise SceneError(
            f"{what} at ({place}) is too far away for a scene of this size, in floats of {8 * dtype.itemsize} bits: "
            f"scale the scene, or move {what} nearer"
        )
    return coordinates


def to_kernel(corners: Rows, precision: str) -> tuple[Rows, Rows, float]:
    """Return corners (N, 3, 3) as a kernel that works at `precision` sees them, their origin (3,) and their scale."""
    if not len(corners):
        return corners, np.zeros(3), 1.0
    origin = origin_of(corners)
    corners = corners - origin
    scale = scale_of(corners, precision)
    return rounded(corners * scale, precision), origin, scale


def rounded(corners: Rows, precision: str) -> Rows:
    """Round coordinates as a kernel that works at `precision` holds them."""
    return corners.astype(WORKING.get(precision, np.float32)).astype(np.float64)


def frame_of(low: Rows, high: Rows, precision: str) -> tuple[Rows, float]:
    """Return the origin (3,) and the scale that `to_kernel` gives triangles in the box from `low` to `high`."""
    box = np.stack([low, high])[None]
    origin = origin_of(box)
    return origin, scale_of(box - origin, precision)


def triangle_rows(corners: NDArray[np.float64]) -> Rows:
    """Return rows (3N, 4): row 3k + c holds corner c of triangle k, and in w component c of its unit normal.

    The normals are those of these corners: hand it rounded ones, so that a kernel sees no other plane than they span.
    """
    rows = np.empty((len(corners), 3, 4))
    for part in parts(len(corners)):
        rows[part, :, :3] = corners[part]
        copy_columns(rows[part, :, 3], normals_of(corners[part]))
    return rows.reshape(-1, 4)
