"""The programs that collectives run on devices, recorded for each program that combines elements.

Stage: record. One element of a run combines several neighbours, and so computes several levels of the tree at once.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from inspect import Parameter, Signature
from typing import Any, NamedTuple

from shpy.ir.traverse import is_straight, walk
from shpy.ir.types import FLOATS, Base
from shpy.lang.data.tables import TableType
from shpy.lang.functions.array import Array
from shpy.lang.programs.control import SH_ELSE, SH_FOR, SH_IF
from shpy.lang.values.builtins import bits_from_float, cond, grid_index, isinf, isnan, max as larger
from shpy.lang.values.structs import struct
from shpy.lang.values.structure import Group, build_values, layout_from, layout_of, leaves, leaves_of
from shpy.lang.values.types import Attrib1f, Attrib1i, Attrib1u, Attrib4u
from shpy.lang.values.value import CLASSES
from shpy.programs import Program, program

Lift = Callable[[Any, Any], Any]
"""Converts an element and its index to a value that the program combines."""
_WIDTH = 16
_LARGE = 64
"""The least number of statements of a program that a text repeats 3 times instead of _WIDTH - 1 times."""


def width_for(combine: Program) -> int:
    """Return how many neighbours one element combines: a power of two, fewer for large programs."""
    return _WIDTH if sum(1 for f in combine.ir.functions for _ in walk(f.body)) < _LARGE else 4


def annotated(function: Callable[..., Any], **types: Any) -> Program:
    """Record a function as a program whose inputs have these names and types; `out` is the type of the result.

    The function takes any named arguments, since the names of its inputs are known only here.
    """
    parameters = [Parameter(name, Parameter.KEYWORD_ONLY) for name in types if name != "out"]
    function.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    function.__annotations__ = {"return" if name == "out" else name: type_ for name, type_ in types.items()}
    return program(function)


@lru_cache(maxsize=256)
def folding(
    combine: Program, element: Any, value_type: Any, lift: Lift | None, rank: int, width: int, fours: Any = None
) -> Program:
    """Record the program that combines `width` neighbours as a tree, on the only axis or on the middle one of 3.

    `fours` is the type of a second table with one axis, which holds the same scalars as vectors of four, or None.
    """

    def fold(data: Any) -> Any:
        if rank == 1:
            block, extent = grid_index(1), data.shape[0]
        else:
            place = grid_index(3)
            block, extent = place.y, data.shape[1]
        first = block * width

        def read(k: int) -> Any:
            value = data[first + k] if rank == 1 else data[place.x, first + k, place.z]
            return value if lift is None else lift(value, first + k)

        return tree(read, extent - first, 0, width, combine)

    def fold_fours(data: Any, whole: Any) -> Any:
        block, extent = grid_index(1), data.shape[0]
        first = block * width

        def lifted(k: int, value: Any) -> Any:
            return value if lift is None else lift(value, first + k)

        result = zeros(value_type)
        with SH_IF(first + width <= extent):
            vectors = [whole[block * (width // 4) + k] for k in range(width // 4)]
            values = [lifted(k, vectors[k // 4][k % 4]) for k in range(width)]
            store(result, tree(lambda k: values[k], None, 0, width, combine))
        with SH_ELSE():
            store(result, tree(lambda k: lifted(k, data[first + k]), extent - first, 0, width, combine))
        return result

    table = TableType(element, rank)
    if fours is None:
        return annotated(fold, data=table, out=value_type)
    return annotated(fold_fours, data=table, whole=TableType(fours, 1), out=value_type)


@lru_cache(maxsize=64)
def lifting(lift: Lift, element: Any, value_type: Any) -> Program:
    """Record the program that converts each element and its index to a value to combine."""

    def lifted(x: Any, i: Any) -> Any:
        return lift(x, i)

    return annotated(lifted, x=element, i=Attrib1i, out=value_type)


@lru_cache(maxsize=64)
def lifted_pairs(lift: Lift, combine: Program, element: Any, value_type: Any) -> Program:
    """Record one program with two results: a lifted element, and two combined ones; devices use either."""

    def both(x: Any, i: Any, a: Any, b: Any) -> Any:
        return lift(x, i), combine(a, b)

    return annotated(both, x=element, i=Attrib1i, a=value_type, b=value_type, out=tuple[value_type, value_type])


@lru_cache(maxsize=256)
def scanning(combine: Program, element: Any, exclusive: bool) -> Program:
    """Record the down-sweep over four neighbours; `above` holds the inclusive prefixes at ends of blocks of four."""

    def scan(data: Any, above: Any) -> Any:
        result = zeros(element)
        at = grid_index(1) - int(exclusive)
        block, rest = at >> 2, at & 3
        with SH_IF(rest == 3):
            store(result, above[block])
        with SH_ELSE():
            first = block * 4
            store(result, data[first])
            with SH_IF(rest != 0):
                store(result, combine(result, data[first + 1]))
            with SH_IF(block > 0):
                store(result, combine(above[block - 1], result))
            with SH_IF(rest == 2):
                store(result, combine(result, data[first + 2]))
        if exclusive:
            with SH_IF(at < 0):
                store(result, zeros(element))
        return result

    table = TableType(element, 1)
    return annotated(scan, data=table, above=table, out=element)


@lru_cache(maxsize=256)
def scanning_fours(combine: Program, element: Any, fours: Any, exclusive: bool) -> Program:
    """Record the down-sweep that returns four prefixes as a vector: see `scanning`, and `folding` for `whole`."""

    def scan(data: Any, whole: Any, above: Any) -> Any:
        block = grid_index(1)
        x = zeros(fours)
        with SH_IF(block * 4 + 4 <= data.shape[0]):
            x[:] = whole[block]
        with SH_ELSE():
            x[:] = fours(*(data[block * 4 + k] for k in range(4)))
        before, through = above[block - 1], above[block]
        first, second = element(x[0]), element(combine(x[0], x[1]))
        with SH_IF(block > 0):
            first[:] = combine(before, first)
            second[:] = combine(before, second)
        third = combine(second, x[2])
        if not exclusive:
            return fours(first, second, third, through)
        return fours(cond(block > 0, before, zeros(element)), first, second, third)

    table = TableType(element, 1)
    return annotated(scan, data=table, whole=TableType(fours, 1), above=table, out=fours)


def zeros(type_: Any) -> Any:
    """Return a value of a type, all zeros."""
    layout = layout_of(type_, "an element")
    zero = {Base.B: False}
    return build_values(layout, iter([cls(*[zero.get(cls.base, 0)] * cls.size) for _, _, cls in leaves(layout, "")]))


def store(target: Any, value: Any) -> None:
    """Store each leaf of a value into the same leaf of another one."""
    for old, new in zip(leaves_of(target), leaves_of(value), strict=True):
        old[:] = new


def tree(read: Callable[[int], Any], count: Any, start: int, width: int, combine: Program) -> Any:
    """Return the tree over `width` neighbours, of which only the first `count` exist (at least one; None: all).

    A table returns its last element for an index behind it. So a program without control flow is evaluated for all
    neighbours, and its result is dropped if the second one does not exist: that costs less than a branch.
    """
    if width == 1:
        return read(start)
    half = width // 2
    first = tree(read, count, start, half, combine)
    if count is None:
        return combine(first, tree(read, None, start + half, half, combine))
    if is_plain(combine):
        both = combine(first, tree(read, count, start + half, half, combine))
        return chosen(start + half < count, both, first)
    result = copied(first)
    with SH_IF(start + half < count):
        store(result, combine(first, tree(read, count, start + half, half, combine)))
    return result


def is_plain(combine: Program) -> bool:
    """Return whether a program is one function without control flow."""
    return len(combine.ir.functions) == 1 and is_straight(combine.ir.entry.body)


def chosen(condition: Any, a: Any, b: Any) -> Any:
    """Return a value with the leaves of `a` where the condition holds, else with those of `b`."""
    layout = layout_from(b, "an element")
    return build_values(layout, (cond(condition, x, y) for x, y in zip(leaves_of(a), leaves_of(b), strict=True)))


def copied(value: Any) -> Any:
    """Return a copy of a value, to store into."""
    return build_values(layout_from(value, "an element"), iter([v.copy() for v in leaves_of(value)]))


# The reductions of streams: each component of a vector is reduced by itself.


class Reduction(NamedTuple):
    """The programs of a reduction: one lifts each element, one combines two, and one finishes the result.

    `leaf`: the number of the leaf that is the result.
    """

    combine: Program
    value_type: Any
    lift: Lift | None = None
    finish: Program | None = None
    leaf: int | None = None


@lru_cache(maxsize=256)
def over_structs(combine: Program) -> tuple[Program, Any]:
    """Return a program over structs for one that combines NamedTuples, and the type that it combines.

    A Table holds structs. A run returns one stream of structs; for a NamedTuple it returns one stream for each field.
    """
    element, output = next(iter(combine.inputs.values())), combine.recorded.output
    layout = layout_of(element, "an element")
    if not any(isinstance(part, Group) and part.form != "struct" for part in (layout, output)):
        return combine, element
    fields = {f"part{k}": cls for k, (_, _, cls) in enumerate(leaves(layout, ""))}
    structure = struct(type("Element", (), {"__annotations__": fields}))

    def combined(a: Any, b: Any) -> Any:
        arguments = (build_values(layout, iter(leaves_of(x))) for x in (a, b))
        return build_values(layout_of(structure, "an element"), iter(leaves_of(combine(*arguments))))

    return annotated(combined, a=structure, b=structure, out=structure), structure


@lru_cache(maxsize=256)
def sums(size: int, base: Base, method: str) -> Reduction:
    """Return the reduction that adds; bools are added as ints."""
    cls = CLASSES["Attrib", size, Base.I if base is Base.B else base]
    if method == "compensated":
        return _compensated_sums(cls)

    def add(a: Any, b: Any) -> Any:
        return a + b

    return Reduction(annotated(add, a=cls, b=cls, out=cls), cls, _ones if base is Base.B else None)


@lru_cache(maxsize=64)
def wide_sums(size: int, method: str) -> Reduction:
    """Return the reduction that adds binary16 in binary32."""
    kind, wide = sums(size, Base.F, method), CLASSES["Attrib", size, Base.F]

    def widen(x: Any, i: Any) -> Any:
        return wide(x) if kind.lift is None else kind.lift(wide(x), i)

    return kind._replace(lift=widen)


@lru_cache(maxsize=16)
def conversion(size: int, source: Base, target: Base) -> Program:
    """Record the program that converts scalars or vectors from one base to another."""
    target_type = CLASSES["Attrib", size, target]

    def convert(x: Any) -> Any:
        return target_type(x)

    return annotated(convert, x=CLASSES["Attrib", size, source], out=target_type)


def _compensated_sums(cls: Any) -> Reduction:
    pair = struct(type("Sum", (), {"__annotations__": {"value": cls, "error": cls}}))

    def start(x: Any, i: Any) -> Any:
        return pair(cls(x), zeros(cls))

    def add(a: Any, b: Any) -> Any:
        value = a.value + b.value
        back = value - a.value
        error = (a.value - (value - back)) + (b.value - back)
        return pair(value, (a.error + b.error) + error)

    def finish(x: Any) -> Any:
        unbounded = isnan(x.value) | isinf(x.value)
        return cond(unbounded, x.value, x.value + x.error)

    return Reduction(annotated(add, a=pair, b=pair, out=pair), pair, start, annotated(finish, x=pair, out=cls))


@lru_cache(maxsize=256)
def extremes(size: int, base: Base, least: bool, by_bits: bool = False) -> Reduction:
    """Return the reduction that keeps the least element, or the largest one; the first of those that are equal.

    `by_bits`: the bits of 32-bit floats are compared, for a device that flushes denormals.
    """
    cls = CLASSES["Attrib", size, base]

    def keep(a: Any, b: Any) -> Any:
        return cond(_exceeds(b, a, least, by_bits), b, a)

    return Reduction(annotated(keep, a=cls, b=cls, out=cls), cls)


@lru_cache(maxsize=256)
def places(size: int, base: Base, least: bool, by_bits: bool = False) -> Reduction:
    """Return the reduction that keeps the index of the least element, or of the largest one, beside it.

    `by_bits` as in `extremes`.
    """
    cls = CLASSES["Attrib", size, Base.I if base is Base.B else base]
    index = CLASSES["Attrib", size, Base.I]
    entry = struct(type("Entry", (), {"__annotations__": {"value": cls, "index": index}}))

    def start(x: Any, i: Any) -> Any:
        return entry(cls(_ones(x, i) if base is Base.B else x), index(i))

    def keep(a: Any, b: Any) -> Any:
        exceeds = _exceeds(b.value, a.value, least, by_bits)
        return entry(cond(exceeds, b.value, a.value), cond(exceeds, b.index, a.index))

    return Reduction(annotated(keep, a=entry, b=entry, out=entry), entry, start, leaf=1)


@lru_cache(maxsize=256)
def counts(size: int, by_bits: bool = False) -> Reduction:
    """Return the reduction that counts the elements that are not zero; `by_bits` as in `extremes`."""
    lift = _ones_by_bits if by_bits else _ones
    return Reduction(sums(size, Base.I, "pairwise").combine, CLASSES["Attrib", size, Base.I], lift)


@lru_cache(maxsize=256)
def logic(size: int, every: bool, by_bits: bool = False) -> Reduction:
    """Return the reduction to whether any element is not zero, or, for `every`, whether none is zero.

    `by_bits` as in `extremes`.
    """
    cls = CLASSES["Attrib", size, Base.B]

    def join(a: Any, b: Any) -> Any:
        return a & b if every else a | b

    return Reduction(annotated(join, a=cls, b=cls, out=cls), cls, _holds_by_bits if by_bits else _holds)


@lru_cache(maxsize=64)
def quotient(size: int, base: Base) -> Program:
    """Record the program that divides a sum by a number of elements."""
    cls = CLASSES["Attrib", size, base]

    def divide(total: Any, count: Any) -> Any:
        return total / count

    return annotated(divide, total=cls, count=CLASSES["Attrib", 1, base], out=cls)


BLOCK = 1024
"""The number of floats that one element of a run sums exactly; sums of as many 16-bit numbers fit into 32 bits."""
WORDS = 11
"""Words of an exact sum, a two's complement in units of 2**-149; the word after them holds SPECIAL flags."""
SPECIAL = (1, 2, 4)
"""Flags of a sum with infinity, minus infinity and NaN among its numbers."""


@lru_cache(maxsize=2)
def accumulating(rank: int) -> Program:
    """Record the program that sums BLOCK floats exactly, on the only axis or on the middle one of 3.

    A significand, shifted by up to 7 bits, is split into two 16-bit numbers, which are added to sums of weight 256**k.
    """
    words = struct(type("Words", (), {"__annotations__": {"low": Attrib4u, "middle": Attrib4u, "high": Attrib4u}}))

    def accumulate(data: Any) -> Any:
        place = None if rank == 1 else grid_index(3)
        first = (grid_index(1) if place is None else place.y) * BLOCK
        extent = data.shape[rank // 2]
        sums = Array(Attrib1i, 4 * WORDS)
        special = Attrib1u(0)
        with SH_FOR(0, BLOCK) as k, SH_IF(first + k < extent):
            bits = bits_from_float(data[first + k] if place is None else data[place.x, first + k, place.z])
            exponent = Attrib1i((bits >> 23) & 255)
            negative = (bits >> 31) != 0
            with SH_IF(exponent == 255):
                infinity, minus_infinity, nan = map(Attrib1u, SPECIAL)
                special[:] = special | cond((bits << 9) != 0, nan, cond(negative, minus_infinity, infinity))
            with SH_ELSE():
                significand = (bits & 0x7FFFFF) | cond(exponent > 0, Attrib1u(0x800000), Attrib1u(0))
                shift = larger(exponent, 1) - 1
                shifted = significand << Attrib1u(shift & 7)
                low, high = Attrib1i(shifted & 0xFFFF), Attrib1i(shifted >> 16)
                at = shift >> 3
                sums[at] = sums[at] + cond(negative, -low, low)
                sums[at + 2] = sums[at + 2] + cond(negative, -high, high)
        made = Array(Attrib1u, WORDS + 1)
        carry = Attrib1i(0)
        with SH_FOR(0, WORDS) as w:
            word = Attrib1u(0)
            for byte in range(4):
                carry[:] = carry + sums[4 * w + byte]
                word[:] = word | Attrib1u(carry & 255) << 8 * byte
                carry[:] = carry >> 8
            made[w] = word
        made[WORDS] = special
        return words(*(Attrib4u(*(made[k + j] for j in range(4))) for k in (0, 4, 8)))

    return annotated(accumulate, data=TableType(Attrib1f, rank), out=words)


def mapped(x: Any) -> Any:
    """Return an unsigned int with the order of the 32-bit float x; NaN is the greatest, and -0 equals +0."""
    cls = CLASSES["Attrib", x.size, Base.U]
    bits = bits_from_float(x)
    size = bits & 0x7FFFFFFF
    key = cond(bits > size, ~bits, bits | 0x80000000)
    return cond(size > 0x7F800000, cls(Attrib1u(0xFFFFFFFF)), cond(size == 0, cls(Attrib1u(0x80000000)), key))


def _exceeds(b: Any, a: Any, least: bool, by_bits: bool) -> Any:
    """Return whether b precedes a; NaN precedes every number."""
    if by_bits:
        key, other = mapped(b), mapped(a)
        # NaN is the greatest key: 1 more makes it the least.
        return key + 1 < other + 1 if least else key > other
    before = b < a if least else b > a
    return before | (isnan(b) & ~isnan(a)) if b.base in FLOATS else before


def _holds_by_bits(x: Any, i: Any) -> Any:
    return (bits_from_float(x) & 0x7FFFFFFF) != 0


def _ones_by_bits(x: Any, i: Any) -> Any:
    return cond(_holds_by_bits(x, i), 1, 0)


def _holds(x: Any, i: Any) -> Any:
    return x if x.base is Base.B else x != 0


def _ones(x: Any, i: Any) -> Any:
    return cond(_holds(x, i), 1, 0)
