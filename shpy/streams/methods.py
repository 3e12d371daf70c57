"""The reductions that streams have as methods.

Stage: run. They run programs, which stand above streams, so the module that has them is loaded by its name at the first
use of one. Most programs use none.

    x.sum()                   # a numpy scalar
    x.sum(axis=0)             # a Stream without that axis
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from functools import cache
from typing import Any, Literal

import numpy as np

from shpy.ieee import in_ieee_arithmetic


@cache
def _reduction(name: str) -> Callable[..., Any]:
    """Return the function of a method, which takes the stream as its first argument."""
    return in_ieee_arithmetic(importlib.import_module("shpy.collectives.reducing").METHODS[name])


def _on_host(value: Any) -> Any:
    """Return what numpy's functions get for a stream, or for streams in lists: arrays that nothing can store into."""
    match value:
        case StreamReductions():
            array = np.asarray(value).view()
            array.flags.writeable = False
            return array
        case list() | tuple():
            return [_on_host(entry) for entry in value]
        case dict():
            return {name: _on_host(entry) for name, entry in value.items()}
    return value


class StreamReductions:
    """The methods of a Stream that reduce its elements, all of them or along an axis.

    A reduction of all elements waits for the device and returns a numpy scalar, or an array (N,) of vectors of N
    components, each of which is reduced on its own. A reduction along an axis returns a Stream without that axis.
    Streams of structs and matrices raise ShpyTypeError: `sh.reduce` takes them with a program.
    """

    _reductions: dict[str, tuple[Any, Callable[[], Any]]]
    """Reductions of all elements that a device has prepared, by their names, each with the memories that it reads.

    The last scan is among them, with its program and whether it was exclusive.
    """

    def _reduced(self, name: str, axis: int | None, *options: Any) -> Any:
        """Reduce the elements, as an earlier reduction of all of them has prepared it, or else check everything.

        Microseconds of CPU for the sum of 10**4 numbers on OpenCL, of which an empty launch takes 7: 27 for 58.
        """
        key = f"{name} {options}" if options else name
        prepared = self._reductions.get(key) if axis is None else None
        return _reduction(name)(self, axis, *options, key=key) if prepared is None else prepared[1]()

    def __array_function__(self, function: Callable[..., Any], _: Any, args: Any, named: Any) -> Any:
        return function(*_on_host(args), **_on_host(named))

    def sum(self, method: Literal["pairwise", "compensated", "exact"] = "pairwise", axis: int | None = None) -> Any:
        """Return the sum of the elements: 0 for none. Ints and unsigned ints wrap modulo 2**32; bools are counted.

        "pairwise" adds along the tree of `sh.reduce`: the error grows with log2(n). "compensated" adds pairs (sum,
        error) along the same tree, and the error once at the end: about twice the working precision. "exact" rounds
        the exact sum once to the working precision, so it does not depend on any order. It equals `math.fsum` at f64.
        At f32 it is the exact sum rounded to f32 directly; float32(math.fsum(x)) rounds twice, and differs in rare
        cases. Nothing raises for infinities and NaN: a NaN, or infinities of both signs, give NaN; else infinities
        give infinity, as does an exact sum beyond the largest float. Sources: Knuth, The Art of Computer Programming
        4.2.2 (two-sum); Kulisch (superaccumulators).

        Elements of 16 bits are converted to binary32 first; the sums are taken in binary32, along the same tree, and
        the result is rounded to binary16 once, at the end.
        """
        return self._reduced("sum", axis, method)

    def mean(self, axis: int | None = None) -> Any:
        """Return the pairwise sum divided by the number of elements, which rounds once more; NaN for no elements.

        Of elements of 16 bits, sum and quotient are taken in binary32, and the quotient is rounded to binary16.
        Raises ShpyTypeError for streams of ints and bools.
        """
        return self._reduced("mean", axis)

    def min(self, axis: int | None = None) -> Any:
        """Return the least element. NaN is less than all numbers.

        Of equal elements, -0 and 0 among them, the first is taken; of several NaN, the first.
        Raises ShpyTypeError for no elements.
        """
        return self._reduced("min", axis)

    def max(self, axis: int | None = None) -> Any:
        """Return the largest element. NaN is larger than all numbers.

        Of equal elements, -0 and 0 among them, the first is taken; of several NaN, the first.
        Raises ShpyTypeError for no elements.
        """
        return self._reduced("max", axis)

    def argmin(self, axis: int | None = None) -> Any:
        """Return the index of the first element equal to `min()`, or of the first NaN: along an axis or in C order.

        Raises ShpyTypeError for no elements.
        """
        return self._reduced("argmin", axis)

    def argmax(self, axis: int | None = None) -> Any:
        """Return the index of the first element equal to `max()`, or of the first NaN: along an axis or in C order.

        Raises ShpyTypeError for no elements.
        """
        return self._reduced("argmax", axis)

    def any(self, axis: int | None = None) -> Any:
        """Return whether an element is not zero (NaN is not): False for no elements."""
        return self._reduced("any", axis)

    def all(self, axis: int | None = None) -> Any:
        """Return whether no element is zero: True for no elements."""
        return self._reduced("all", axis)

    def count(self, axis: int | None = None) -> Any:
        """Return how many elements are not zero (NaN is not), as int32: 0 for no elements."""
        return self._reduced("count", axis)
