"""The kernel that links the nodes of a hierarchy for rays of each octant of directions.

Stage: accelerate. Each row names a node's children and its parent. The node to visit after a subtree follows from a
walk towards the root: it is the far child of the first ancestor whose near child lies on the way. That ancestor is two
levels up on average. All backends give the same numbers.

>>> links(np.int32([[1, 2, 0, -1], [-9, -1, -1, 0], [-17, -1, -1, 0]]), "numpy")[:2, 0].tolist()
[[1, -1], [2, -1]]
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.accel.bvh import END
from raytracer.accel.planes import constant
from shpy import SH_BREAK, SH_IF, SH_WHILE


def links(rows: NDArray[np.int32], backend: str) -> NDArray[np.int32]:
    """Return the links (8, M, 2) of a `Bvh` of M nodes, given `rows` (M, 4) that describe the nodes.

    The row of an inner node holds its two children, the axis along which the first child lies lower, and its parent, -1
    for the root. The row of a leaf holds its own link, two numbers that are not read, and its parent.
    """
    table = sh.Table(constant(rows), sh.Attrib4i, copy=False)
    return np.asarray(_compiled(backend)(table, shape=(8, len(rows))))


@cache
def _compiled(backend: str) -> Any:
    @sh.program
    def link(rows: sh.Table[sh.Attrib4i]) -> sh.Attrib2i:
        octant, node = sh.grid_index(2)
        own = rows[node]
        first = sh.cond((own.x >= 0) & _is_turned(own, octant), own.y, own.x)
        past = sh.Attrib1i(END)
        below = sh.Attrib1i(node)
        above = sh.Attrib1i(own.w)
        with SH_WHILE(lambda: above >= 0):
            row = rows[above]
            turned = _is_turned(row, octant)
            with SH_IF(sh.cond(turned, row.y, row.x) == below):
                past[:] = sh.cond(turned, row.x, row.y)
                SH_BREAK()
            below[:] = above
            above[:] = row.w
        return sh.Attrib2i(first, past)

    return link.compile(backend, loop_limit=None)


def _is_turned(row: Any, octant: Any) -> Any:
    """Return whether rays of an octant visit the second child of a node first."""
    return (octant >> row.z & 1) != 0
