"""Histograms: how many elements of a stream lie in each bin.

Stage: run. Each element searches its bin among the edges, so no arithmetic rounds. Where bins have equal widths,
arithmetic guesses the bin, and the search begins with the edges beside the guess: most often it ends there.

    counts = sh.histogram(image, 256, range=(0, 1))
    counts = sh.histogram(ages, [0, 18, 65, 120])
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.collectives.arguments import check_stream
from shpy.collectives.leaves import Leaves, is_mapped, mapping, run_over
from shpy.collectives.programs import annotated, mapped
from shpy.collectives.trees import retyped
from shpy.errors import ShpyError, ShpyTypeError
from shpy.ieee import in_ieee_arithmetic
from shpy.ir.types import Base
from shpy.lang.data.hostdata import as_array
from shpy.lang.data.tables import TableType
from shpy.lang.programs.control import SH_BREAK, SH_ELSE, SH_FOR, SH_IF
from shpy.lang.recording.location import here
from shpy.lang.values.builtins import clamp, cond, min as least
from shpy.lang.values.types import Attrib1i, Attrib1u
from shpy.lang.values.value import CLASSES
from shpy.programs import Program
from shpy.streams.stream import Stream


@in_ieee_arithmetic
def histogram(stream: Stream, bins: int | Sequence[float], range: tuple[float, float] | None = None) -> Stream:
    """Return how many elements lie in each bin: ints, of shape (number of bins,).

    `bins` may be edges in ascending order, one more than bins, or a number of bins of equal width over `range`: the
    edges are those of `np.histogram_bin_edges`. As with `np.histogram`, a bin holds its lower edge and not its upper
    one, but for the last, which holds both. Elements outside of all bins, and NaN, are not counted.
    A number of bins without a range counts the ints 0, 1, up to bins - 1, as `np.bincount` does; floats need a range.
    The stream holds numbers of one component and may have several axes. Raises ShpyTypeError for other streams, edges
    that descend, are NaN or stand beside a range, and numbers of bins below 1.
    """
    elements = check_stream(stream, "histogram")
    base = _base(elements)
    try:
        with np.errstate(all="ignore"):  # the numbers beside the greatest and the least one overflow and underflow
            return _histogram(elements, base, bins, range)
    except (MemoryError, OverflowError) as error:
        raise ShpyError(
            f"a histogram of {bins!r} bins needs more memory than there is", loc=here(), cure="fewer bins"
        ) from error


def _histogram(elements: Stream, base: Base, bins: Any, range: Any) -> Stream:
    leaves = Leaves(elements.place)
    line = retyped(elements, elements.type, (elements.size,))
    if isinstance(bins, int | np.integer) and range is None:
        count = _checked_count(bins)
        if base in (Base.F, Base.D, Base.H):
            raise ShpyTypeError(
                "a histogram of floats needs a range", loc=here(), cure=f"sh.histogram(stream, {bins}, range=(0, 1))"
            )
        numbers = _entry(line)
    else:
        edges = _edges(bins, range, _entry(elements).dtype)
        count = len(edges) - 1
        lower, last = _exact(edges, _entry(elements).dtype)
        if not len(lower) or not line.size:
            return Stream.empty(count, Attrib1i, *elements.place)
        edge: Any = CLASSES["Attrib", 1, base]
        if is_mapped(elements.place, edge):
            keys = mapping().compile("numpy")
            lower, last, edge = keys(lower), keys(last), Attrib1u
        table = Stream(lower, edge, *elements.place)
        inputs = {"x": line, "edges": table, "last": last, "bins": np.array([count], np.int32)}
        equal = isinstance(bins, int | np.integer) and base is Base.F
        if equal:
            inputs |= _spacing(edges)
        numbers = _entry(run_over(elements.place, _locating(line.type, edge, equal), line.size, **inputs))
    return Stream.over(Attrib1i, (count,), elements.place, [leaves.tally(numbers, count)])


def _entry(stream: Stream) -> Any:
    return stream.leaf_entries()[0].memory


def _base(stream: Stream) -> Base:
    entries = stream.leaf_entries()
    type_ = entries[0].memory.type
    if len(entries) != 1 or type_.size != 1 or type_.is_bool:
        raise ShpyTypeError(
            f"histogram takes numbers of one component, not {stream!r}",
            loc=here(),
            cure="a stream of one number an element, which a program computes from it",
        )
    return type_.base


def _checked_count(bins: int | np.integer[Any]) -> int:
    if isinstance(bins, bool) or bins < 1:
        raise ShpyTypeError(f"a histogram of {bins} bins", loc=here(), cure="1 bin or more")
    return int(bins)


def _edges(bins: Any, range: Any, dtype: Any) -> NDArray[Any]:
    """Return the edges of bins as numpy defines them."""
    if isinstance(bins, int | np.integer):
        count = _checked_count(bins)
        try:
            return np.histogram_bin_edges(np.empty(0, dtype), count, range)
        except (TypeError, ValueError) as error:
            narrow = "Too many bins" in str(error)  # the stream's type has no number between two edges
            cure = f"np.linspace(low, high, {count + 1}) for bins, without a range" if narrow else "range=(low, high)"
            raise ShpyTypeError(f"range={range!r}: {error}", loc=here(), cure=cure) from error
    if range is not None:
        raise ShpyTypeError(f"range={range!r} beside edges", loc=here(), cure="no range=, or a number of bins")
    edges = as_array(bins, "bins")
    if edges.ndim != 1 or len(edges) < 2 or edges.dtype.kind not in "iuf" or not np.all(edges[1:] >= edges[:-1]):
        raise ShpyTypeError(
            "bins takes two edges or more in ascending order, or a number of bins",
            loc=here(),
            cure="bins=[0, 1, 2]",
        )
    return edges


def _exact(edges: NDArray[Any], dtype: np.dtype[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return each lower edge rounded up to a number of the dtype, if there is one, and the last edge rounded down.

    Compared with these, numbers of the dtype fall into the same bins as with the original edges.
    """
    wide = edges.astype(np.float64) if edges.dtype.kind == "f" else edges
    if dtype.kind == "f":
        lower, last = wide.astype(dtype), wide[-1:].astype(dtype)
        lower = np.where(lower.astype(np.float64) < wide, np.nextafter(lower, dtype.type(np.inf)), lower)
        last = np.where(last.astype(np.float64) > wide[-1:], np.nextafter(last, dtype.type(-np.inf)), last)
        return lower, last
    bounds = np.iinfo(dtype)
    up, down = np.ceil(wide), np.floor(wide[-1:])
    kept = up[up <= bounds.max]
    if down[0] < bounds.min:
        return kept[:0].astype(dtype), down[:0].astype(dtype)
    return np.maximum(kept, bounds.min).astype(dtype), np.minimum(down, bounds.max).astype(dtype)


def _spacing(edges: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Return the first of equally spaced edges and the number of bins per unit, rounded, since they serve a guess."""
    each = (len(edges) - 1) / (edges[-1] - edges[0])
    return {"begin": edges[:1].astype(np.float32), "each": np.array([np.nan_to_num(np.float32(each))], np.float32)}


@cache
def _locating(element: Any, edge: Any, equal: bool) -> Program:
    """Record the program that returns the bin of an element, or -1; `equal`: all bins have the same width."""

    def locate(x: Any, edges: Any, last: Any, bins: Any, begin: Any = None, each: Any = None) -> Any:
        key = x if x.base is edge.base else mapped(x)
        count = Attrib1i(edges.shape[0])
        low, high = Attrib1i(0), count.copy()
        if equal:
            guess = clamp(Attrib1i((x - begin) * each), 0, count - 1)
            with SH_IF(edges[guess] <= key):
                low[:] = guess + 1
                with SH_IF((low < count) & (edges[low] > key)):
                    high[:] = low
            with SH_ELSE():
                high[:] = guess
                with SH_IF((guess > 0) & (edges[guess - 1] <= key)):
                    low[:] = guess
        with SH_FOR(0, 32):
            SH_BREAK(low >= high)
            half = (low + high) >> 1
            with SH_IF(edges[half] <= key):
                low[:] = half + 1
            with SH_ELSE():
                high[:] = half
        # NaN <= last is false, so a NaN gets -1.
        return cond(key <= last, least(low, bins) - 1, -1)

    types = {"x": element, "edges": TableType(edge, 1), "last": edge, "bins": Attrib1i}
    types |= {"begin": element, "each": element} if equal else {}
    return annotated(locate, **types, out=Attrib1i)
