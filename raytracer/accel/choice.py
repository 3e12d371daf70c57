"""Accelerators by name: structures that spare a ray most of the triangles.

Stage: accelerate. Takes corners (N, 3, 3), N > 0, gives a `Grid` or a `Bvh`; `kernels.walk` goes through either.

>>> build("bvh", np.eye(3)[None]).items.tolist()
[0]
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.bvh import Bvh
from raytracer.accel.grid import Grid, build_grid
from raytracer.accel.ploc import build_bvh
from raytracer.accel.space import WORKING
from raytracer.errors import SceneError

Corners = NDArray[np.floating]


def build(
    accel: str, corners: Corners, precision: str = "f32", across: int | None = None, backend: str = "numpy"
) -> Grid | Bvh:
    """Build the accelerator of this name for a kernel that works at `precision`; SceneError for an unknown name.

    A grid has `across` cells along each axis, None for as many as suit the triangles. Builders with kernels run them on
    `backend`; the result does not depend on it.
    """
    check(accel)
    if accel == "bvh":
        return build_bvh(corners, WORKING.get(precision, np.float32), backend)
    if accel == "grid":
        return build_grid(corners.astype(np.float32), across=across)
    # A grid of one empty cell with every triangle outside of it: a ray tries all of them.
    items = np.arange(len(corners), dtype=np.int32)
    cells = np.full((1, 1, 1, 2), len(items), dtype=np.int32)
    return Grid(np.zeros(3), np.ones(3), (1, 1, 1), cells, items, len(items))


def check(accel: str, *others: str) -> None:
    """Raise SceneError if there is no accelerator of this name, nor is it one of the other names."""
    if accel in ("bvh:sah", "bvh:ploc"):
        raise SceneError(f'the hierarchy has one builder now: accel="bvh", not {accel!r}')
    if accel not in (*ACCELERATORS, *others):
        names = ", ".join(map(repr, [*ACCELERATORS, *others, "ldc:1024"]))
        raise SceneError(f"the accelerator is one of {names}, not {accel!r}")


ACCELERATORS = ("bvh", "grid", "brute")
"""The hierarchy of boxes; the uniform grid; every triangle, for judging the others."""
INSTANCES = "instances"
"""The accelerator of two levels, for pictures of instances."""
MOVABLE = ("bvh", "grid")
"""The accelerators in which objects can move, or beside which they can."""
