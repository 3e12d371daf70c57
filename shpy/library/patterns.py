"""Patterns in one to three dimensions: sums of noise, cells, distances to scattered points.

Stage: record. Each is a subroutine over `sh.noise` and `sh.hash`. Where a coordinate is beyond the ints, its cell is
the last one; a coordinate that is NaN is in cell 0.

Sources: turbulence: Perlin 1985; fbm: Musgrave 1994 (Texturing and Modeling, chapter 16); cells and distances: Worley
1996; cellnoise: RenderMan.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

from shpy.errors import ShpyTypeError
from shpy.ir.constants import is_int
from shpy.ir.types import Base, vec
from shpy.lang.functions.subroutine import Subroutine
from shpy.lang.library import hash, noise, pcg
from shpy.lang.programs.control import SH_BREAK, SH_FOR, SH_IF
from shpy.lang.recording.location import here
from shpy.lang.values.builtins import abs, any, cond, floor, isnan, length, max, min, unit_float
from shpy.lang.values.types import Attrib1f, Attrib1i, Attrib2f, Attrib3f
from shpy.lang.values.value import CLASSES
from shpy.library.operands import vector

_POINTS: Final = {1: Attrib1f, 2: Attrib2f, 3: Attrib3f}
_SHIFT: Final = 0.37
"""Moves the octaves apart: all of them are zero at the origin otherwise."""


def _point(p: Any, what: str) -> Any:
    v = vector(p, (1, 2, 3), what)
    return _POINTS[v.size](v)


def _octaves(name: str, shape: Callable[[Any], Any]) -> Callable[..., Any]:
    def total(p: Any, octaves: Any, lacunarity: Attrib1f, gain: Attrib1f) -> Any:
        result = Attrib1f(0)
        weight = Attrib1f(1)
        place = p.copy()
        with SH_FOR(0, octaves):
            result += weight * shape(noise(place))
            place[:] = lacunarity * place + _SHIFT
            weight *= gain
        return result

    by_size = {size: Subroutine(total, f"{name}{size}") for size in _POINTS}

    def pattern(p: Any, octaves: Any, lacunarity: Any, gain: Any) -> Any:
        point = _point(p, f"sh.library.{name}")
        constant = is_int(octaves)
        if not (constant and -(1 << 31) <= octaves < 1 << 31) and getattr(octaves, "type", None) != vec(Base.I):
            raise ShpyTypeError(
                f"sh.library.{name} takes an int or an i of octaves, not {octaves!r}",
                loc=here(),
                cure=f"sh.library.{name}(p, 6), or sh.Attrib1i(octaves)",
            )
        return by_size[point.size](point, octaves, lacunarity, gain)

    return pattern


_FBM: Final = _octaves("fbm", lambda height: height)
_TURBULENCE: Final = _octaves("turbulence", abs)


def fbm(p: Any, octaves: Any = 6, lacunarity: Any = 2.0, gain: Any = 0.5) -> Any:
    """Return fractal Brownian motion: the sum of gain**i * noise(p_i), over the octaves i.

    p_0 is p, and p_i+1 is lacunarity * p_i + 0.37. A point of 1 to 3 dimensions gives one float. `octaves` is an int or
    an `sh.Attrib1i`; the others are numbers or floats. The shift keeps the zeros of the octaves apart.
    """
    return _FBM(p, octaves, lacunarity, gain)


def turbulence(p: Any, octaves: Any = 6, lacunarity: Any = 2.0, gain: Any = 0.5) -> Any:
    """Return turbulence: the sum of gain**i * abs(noise(p_i)), with the points of `fbm`.

    It is 0 or more, with creases where a noise is zero.
    """
    return _TURBULENCE(p, octaves, lacunarity, gain)


def _cells(p: Any) -> list[Any]:
    """Return the ints of the cell that holds p."""
    return [Attrib1i(c) for c in floor(p)] if p.size > 1 else [Attrib1i(floor(p))]


def _numbers(word: Any, count: int) -> list[Any]:
    """Return `count` numbers in [0, 1) from a hash."""
    return [unit_float(pcg(word + k)) for k in range(count)]


def cellnoise(p: Any, components: int = 1) -> Any:
    """Return random numbers in [0, 1), 1 to 4 of them, that are constant in each cell between whole numbers.

    A point of 1 to 3 dimensions. Number k is unit_float(pcg(hash(cell) + k)), with the cell floor(p).
    """
    _check_count(components, "sh.library.cellnoise", "components")
    point = _point(p, "sh.library.cellnoise")
    vector_type = CLASSES["Attrib", components, Base.F]
    return vector_type(*_numbers(hash(*_cells(point)), components))


_METRICS: Final[dict[str, Callable[[Any], Any]]] = {
    "euclidean": length,
    "manhattan": lambda v: sum(abs(c) for c in v) if v.size > 1 else abs(v),
    "chebyshev": lambda v: max(*(abs(c) for c in v)) if v.size > 1 else abs(v),
}
_RINGS: Final = 3
"""Rings of cells around that of a point which hold its four nearest, in three dimensions, in every metric."""


def _worley(p: Any, metric: str, count: int) -> Any:
    """Return the `count` least distances, from the cells in rings around the point, as far as they can be nearer."""
    cells = _cells(p)
    inside = p - floor(p)
    nearest = [Attrib1f(float("inf")) for _ in range(count)]
    border = min(inside, 1 - inside)
    edge = min(*border) if p.size > 1 else border

    def visit(offset: Sequence[Any]) -> None:
        word = hash(*(c + o for c, o in zip(cells, offset, strict=True)))
        point = _POINTS[p.size](*offset) + _POINTS[p.size](*_numbers(word, p.size))
        distance = _METRICS[metric](point - inside)
        for found in nearest:
            farther = max(found, distance)
            found[:] = min(found, distance)
            distance = farther

    with SH_FOR(0, _RINGS + 1) as ring:
        SH_BREAK(nearest[-1] <= ring - 1 + edge)
        _around(ring, p.size, visit)
    lost = isnan(inside)
    gone = any(lost) if p.size > 1 else lost
    return CLASSES["Attrib", count, Base.F](*(cond(gone, float("nan"), found) for found in nearest))


def _around(ring: Any, dimensions: int, visit: Callable[[Sequence[Any]], None], *offset: Any) -> None:
    """Record loops over the cells whose greatest offset is `ring`."""
    if len(offset) == dimensions:
        sizes = [abs(o) for o in offset]
        with SH_IF((max(*sizes) if dimensions > 1 else sizes[0]) == ring):
            visit(offset)
    else:
        with SH_FOR(-ring, ring + 1) as step:
            _around(ring, dimensions, visit, step, *offset)


_WORLEY: Final = {size: Subroutine(_worley, f"worley{size}") for size in _POINTS}


def worley(p: Any, metric: str = "euclidean", count: int = 1) -> Any:
    """Return the distances from p to the nearest of scattered points, the nearest first; `count` of them, 1 to 4.

    Each cell between whole numbers holds one point, at the cell's first numbers of `cellnoise`. A point p of 1 to 3
    dimensions gives one float, or a vector of `count`. The metric is "euclidean", "manhattan" (the sum of the
    differences) or "chebyshev" (the greatest one). As many cells are visited as the result takes: it is exact but for
    rounding. A coordinate that is infinite or NaN gives NaN.
    """
    if not isinstance(metric, str) or metric not in _METRICS:
        cure = " or ".join(f'metric="{name}"' for name in _METRICS)
        raise ShpyTypeError(f"sh.library.worley has no metric {metric!r}", loc=here(), cure=cure)
    _check_count(count, "sh.library.worley", "distances")
    point = _point(p, "sh.library.worley")
    return _WORLEY[point.size](point, metric, count)


def _check_count(count: Any, what: str, of: str) -> None:
    if isinstance(count, bool) or count not in (1, 2, 3, 4):
        raise ShpyTypeError(f"{what} gives 1 to 4 {of}, not {count!r}", loc=here(), cure=f"{what}(p, …, 2)")
