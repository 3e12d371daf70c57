"""Accelerators by name: structures that spare a ray most of the triangles.

Stage: accelerate. Takes corners (N, 3, 3), N > 0, gives a `Grid` or a `Bvh`; `kernels.walk` goes through either.

>>> build("bvh", np.eye(3)[None]).items.tolist()
[0]
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import DTypeLike, NDArray

from raytracer.accel.bvh import Bvh, build_bvh
from raytracer.accel.grid import Grid, build_grid
from raytracer.accel.ploc import build_ploc
from raytracer.accel.space import WORKING
from raytracer.errors import SceneError

Corners = NDArray[np.floating]


def build(
    accel: str, corners: Corners, precision: str = "f32", across: int | None = None, backend: str = "numpy"
) -> Grid | Bvh:
    """Build the accelerator of this name for a kernel that works at `precision`; SceneError for an unknown name.

    A grid has `across` cells along each axis, None for as many as suit the triangles. Builders that have kernels of
    their own run them on `backend`, which makes no difference to what they build.
    """
    check(accel)
    if accel in HIERARCHIES:
        return HIERARCHIES[accel](corners, WORKING.get(precision, np.float32), backend)
    if accel == "grid":
        return build_grid(corners.astype(np.float32), across=across)
    # A grid of one empty cell with every triangle outside of it: a ray tries all of them.
    items = np.arange(len(corners), dtype=np.int32)
    cells = np.full((1, 1, 1, 2), len(items), dtype=np.int32)
    return Grid(np.zeros(3), np.ones(3), (1, 1, 1), cells, items, len(items))


def check(accel: str) -> None:
    """Raise SceneError if there is no accelerator of this name."""
    if accel not in ACCELERATORS and accel not in HIERARCHIES:
        names = ", ".join(map(repr, dict.fromkeys([*HIERARCHIES, *ACCELERATORS, "ldc:1024"])))
        raise SceneError(f"the accelerator is one of {names}, not {accel!r}")


ACCELERATORS = ("bvh", "grid", "brute")
"""The hierarchy of boxes; the uniform grid; every triangle, for judging the others."""
LARGE = 1 << 17
"""Triangles from which on `suited` builds from the bottom up. That saves a quarter of a second here and 3.5 s at 10**6,
and pays up to about 100 incoherent rays for a triangle, which take 1.02 to 1.06 times as long afterwards."""


def suited(corners: Corners, dtype: DTypeLike, backend: str) -> Bvh:
    """Build the hierarchy with the builder that suits the number of triangles, on every backend the same one."""
    return HIERARCHIES["bvh:ploc" if len(corners) >= LARGE else "bvh:sah"](corners, dtype, backend)


HIERARCHIES: dict[str, Callable[[Corners, DTypeLike, str], Bvh]] = {
    "bvh": suited,
    "bvh:sah": lambda corners, dtype, _: build_bvh(corners, dtype),
    "bvh:ploc": build_ploc,
}
"""The hierarchy: with the builder that suits, from the top down, or from the bottom up, which takes less time."""
MOVABLE = (*HIERARCHIES, "grid")
"""The accelerators in which objects can move, or beside which they can."""
