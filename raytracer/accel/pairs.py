"""Kernels that find which neighbours on a curve make small boxes together, and that join them.

Stage: accelerate. Boxes are six arrays (N,) of float32: three lower sides, and three upper ones with the opposite sign.
So the box around two has the lower of each two numbers. All backends give the same bits.

>>> sides = [np.float32([0, 1, 5, 6])] * 3 + [np.float32([-1, -2, -6, -7])] * 3
>>> partners(sides, "numpy").tolist()
[1, 0, 3, 2]
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.accel.bounds import lower
from raytracer.accel.planes import constant
from raytracer.accel.programs import LateProgram
from shpy import SH_FOR

Sides = Sequence[NDArray[np.float32]]
Side = sh.Table[sh.Attrib1f]
Numbers = sh.Table[sh.Attrib1i]

REACH = 8
"""Neighbours on either side among which a box looks for its partner."""
THIN = 2.0**-60
"""Extent, in times of the scene's, below which a box is flat: of smaller ones a product may vanish on a GPU."""
TURNED = 4
"""Bit of a join's axis: the second box lies lower along it."""


def partners(sides: Sides, backend: str) -> NDArray[np.int32]:
    """Return for each of N boxes the place of the neighbour with which it makes the smallest box; its own if N = 1.

    Of pairs of the same surface those count that are closer, then those that begin at an even place, then the first.
    All boxes agree on this order, so two find each other at least; and of equal boxes all do.
    """
    return np.asarray(partner.on(backend)(*_tables(sides), shape=len(sides[0])))


def joined(
    sides: Sides, partner: NDArray[np.int32], places: NDArray[np.integer], backend: str
) -> tuple[Sides, NDArray[np.int32]]:
    """Return the boxes around those at `places` and their partners, and the axis on which each two are farthest apart.

    A box that is its own partner stays unchanged. Distances are between middles; `TURNED` is added to the axis if the
    partner is the lower box.
    """
    indices = np.asarray(places, np.int32)
    *boxes, axis = join.on(backend)(indices, sh.Table(partner, sh.Attrib1i), *_tables(sides))
    return boxes, axis


def _tables(sides: Sides) -> list[Any]:
    return [sh.Table(constant(side), sh.Attrib1f, copy=False) for side in sides]


@LateProgram
def partner(x: Side, y: Side, z: Side, past_x: Side, past_y: Side, past_z: Side) -> sh.Attrib1i:
    """Return the place of a box's partner; see `partners`."""
    sides = x, y, z, past_x, past_y, past_z
    place = sh.grid_index(1)
    (total,) = x.shape
    own = [side[place] for side in sides]
    least = sh.Attrib1f(np.inf)
    nearest = sh.Attrib1i(place)

    def compare(apart: Any, is_tie: Any = False) -> None:
        before = _surface(own, [side[place - apart] for side in sides])
        after = _surface(own, [side[place + apart] for side in sides])
        nearer = (place >= apart) & (before < least)
        least[:] = sh.cond(nearer, before, least)
        nearest[:] = sh.cond(nearer, place - apart, nearest)
        nearer = ((after < least) | (after == least) & is_tie) & (place + apart < total)
        least[:] = sh.cond(nearer, after, least)
        nearest[:] = sh.cond(nearer, place + apart, nearest)

    compare(1, place % 2 == 0)
    with SH_FOR(2, REACH + 1) as apart:
        compare(apart)
    return nearest


def _surface(one: Sequence[Any], other: Sequence[Any]) -> Any:
    """Return half the surface of the box around two."""
    low = list(map(lower, one, other))
    extents = [low[axis] + low[axis + 3] for axis in range(3)]  # negative all three
    x, y, z = (sh.cond(extent > -THIN, 0.0, extent) for extent in extents)
    return x * (y + z) + y * z


class Join(NamedTuple):
    """A box around two boxes, and the axis along which these two are farthest apart."""

    x: sh.Attrib1f
    y: sh.Attrib1f
    z: sh.Attrib1f
    past_x: sh.Attrib1f
    past_y: sh.Attrib1f
    past_z: sh.Attrib1f
    axis: sh.Attrib1i


@LateProgram
def join(
    place: sh.Attrib1i,
    partner: Numbers,
    x: Side,
    y: Side,
    z: Side,
    past_x: Side,
    past_y: Side,
    past_z: Side,
) -> Join:
    """Return the box around a box and its partner."""
    sides = x, y, z, past_x, past_y, past_z
    other = partner[place]
    one, two = [side[place] for side in sides], [side[other] for side in sides]
    # Twice the way from middle to middle.
    way = [(two[axis] - two[axis + 3]) - (one[axis] - one[axis + 3]) for axis in range(3)]
    farthest = sh.Attrib1i(0)
    along = way[0]
    for axis in (1, 2):
        farther = abs(along) < abs(way[axis])
        farthest = sh.cond(farther, axis, farthest)
        along = sh.cond(farther, way[axis], along)
    turned = sh.cond(along < 0, TURNED, 0)
    box = list(map(lower, one, two))
    return Join(box[0], box[1], box[2], box[3], box[4], box[5], farthest + turned)
