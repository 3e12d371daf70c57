"""Arrays: one element's own random-access storage.

Stage: record. Reads out of range give the nearest element, writes out of range are dropped.

    stack = sh.Array(sh.Attrib1i, 8)
    stack[n] = node
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NoReturn

from shpy.errors import ShpyIndexError, ShpyTypeError
from shpy.ir.constants import is_int
from shpy.ir.nodes import MAX_ARRAY
from shpy.ir.types import Base, vec
from shpy.lang.functions.blocks import CountedLoop
from shpy.lang.mistakes.aliases import check_store
from shpy.lang.recording.location import here
from shpy.lang.recording.recorder import Frame, need_frame
from shpy.lang.recording.symbolic import Symbolic
from shpy.lang.values import arithmetic
from shpy.lang.values.coerce import Literal
from shpy.lang.values.structure import Layout, build_values, flatten, layout_of, leaves
from shpy.lang.values.value import Value


class Array(Symbolic):
    """`Array(type, n)`: n elements, zero at first; `Array(type, values)`: these elements.

    Elements are values, matrices or structs. `a[i]` reads a copy, `a[i] = v` stores one, `a[:] = b` all, `len(a)` is n.
    Raises RecordError outside of a program, ShpyTypeError for a length below 1 or an index that is not an int.
    """

    __hash__ = None  # type: ignore[assignment]

    def __class_getitem__(cls, key: object) -> NoReturn:
        cure = "a: sh.Array, for a parameter of a subroutine"
        raise ShpyTypeError("an Array is annotated without its elements and length", loc=here(), cure=cure)

    def __eq__(self, other: object) -> Any:
        cure = "same &= a[i] == b[i] in a loop, with SH_FOR(0, len(a)) as i"
        raise ShpyTypeError("== compares the elements of no Array", loc=here(), cure=cure)

    __ne__ = __eq__

    def __init__(self, type_: Any, length: int | Sequence[Any]) -> None:
        frame = need_frame("sh.Array")
        count, values = _read_length(length)
        if count < 1:
            raise ShpyTypeError("an Array holds one element or more", loc=here(), cure="sh.Array(sh.Attrib1f, 8)")
        if count > MAX_ARRAY:
            raise ShpyTypeError(
                f"an Array is each element's own and holds at most {MAX_ARRAY}, not {count}",
                loc=here(),
                cure="an sh.Table, for data that all elements share",
            )
        self._frame = frame
        self._length: int = count
        self._layout: Layout = layout_of(type_, "element")
        self._classes = [cls for _, _, cls in leaves(self._layout, "")]
        self._variables = [frame.variable(cls.type, count) for cls in self._classes]
        for i, value in enumerate(values or ()):
            self[i] = value
        if values is None and frame.scope.loops:
            self._clear()
        suffixes = [suffix for suffix, _, _ in leaves(self._layout, "")]
        frame.name_parts(dict(zip(suffixes, self._variables, strict=True)))

    @classmethod
    def _of(cls, frame: Frame, layout: Layout, length: int, variables: list[int]) -> Array:
        array = object.__new__(cls)
        array._frame, array._layout, array._length, array._variables = frame, layout, length, variables
        array._classes = [leaf for _, _, leaf in leaves(layout, "")]
        return array

    def _clear(self) -> None:
        """Store zeros: made in a loop, the array is fresh in each iteration (elsewhere its slot is zero at first)."""
        with CountedLoop(0, self._length, 1) as i:
            index = int(i._read(self._frame))
            for variable, cls in zip(self._variables, self._classes, strict=True):
                zero = self._frame.const(cls.type, (0,) * cls.size)
                self._frame.store(variable, zero, None, index)

    def copy(self) -> Array:
        """Return a new array with the same elements."""
        slots = [self._frame.variable(cls.type, self._length) for cls in self._classes]
        array = Array._of(self._frame, self._layout, self._length, slots)
        with CountedLoop(0, self._length, 1) as i:
            array[i] = self[i]
        return array

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[Any]:
        return (self[i] for i in range(self._length))

    def _index(self, i: Any) -> int:
        frame = need_frame("an Array")
        probe = object.__new__(Value)
        object.__setattr__(probe, "_frame", self._frame)
        object.__setattr__(probe, "_variable", self._variables[0])
        object.__setattr__(probe, "_loc", None)
        probe._check(frame)
        operand = arithmetic.operand(i, "an index")
        arithmetic.check_index(operand)
        if isinstance(operand, Literal):
            k = operand.components[0]
            if not -self._length <= k < self._length:
                raise ShpyIndexError(
                    f"element {k} of an Array of {self._length}", loc=here(), cure=f"0 to {self._length - 1}"
                )
            return int(frame.const(vec(Base.I), (k % self._length,)))
        return int(arithmetic.index(frame, operand))

    def __getitem__(self, i: Any) -> Any:
        index = self._index(i)
        frame = self._frame
        parts = []
        for variable, cls in zip(self._variables, self._classes, strict=True):
            part = arithmetic.make_value(cls.kind, cls.type, frame, frame.let("load", (index,), cls.type, variable))
            parts.append(part._read_from(f"{self._name()}[i]", "array"))
        return build_values(self._layout, iter(parts))

    def _take(self, values: Any) -> None:
        """Store the elements of another Array, tuple or list, of as many."""
        several = isinstance(values, Array | tuple | list)
        if not several or len(values) != self._length:
            amount = f"{len(values)} elements" if several else type(values).__name__
            raise ShpyTypeError(
                f"a[:] of an Array of {self._length} takes as many elements, not {amount}",
                loc=here(),
                cure="an Array, tuple or list of this length",
            )
        for k, value in enumerate(list(values)):  # read before the first store: they may be this Array's own
            self[k] = value

    def _name(self) -> str:
        """Return the name of the whole array; its variables are named after the leaves, too."""
        path = next(iter(leaves(self._layout, "")))[0]
        return (self._frame.names[self._variables[0]] or "").removesuffix(f"_{path}") or "a"

    def __setitem__(self, i: Any, value: Any) -> None:
        if isinstance(i, slice) and i == slice(None):
            self._take(value)
            return
        index = self._index(i)
        check_store(self._frame, self)
        entries = flatten(self._layout, value, "an element")
        for variable, cls, entry in zip(self._variables, self._classes, entries, strict=True):
            handle = arithmetic.convert(self._frame, entry, cls.type, "a store into an Array")
            self._frame.store(variable, handle, None, index)


def _read_length(length: Any) -> tuple[int, list[Any] | None]:
    """Return the number of elements and their values, None where only a number is given; ShpyTypeError for others."""
    if is_int(length):
        return int(length), None
    try:
        several = None if isinstance(length, Value) and length.size == 1 else iter(length)
    except TypeError:
        several = None
    if several is None:
        raise ShpyTypeError(
            f"the length of an Array is an int that is known while recording, not {length!r}",
            loc=here(),
            cure="sh.Array(sh.Attrib1f, 8); sh.Array(sh.Attrib1f, [a, b]) for its elements",
        )
    values = list(several)
    return len(values), values
