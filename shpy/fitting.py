"""The gradient of a sum over all elements by Params and Tables, for fitting them to data.

Stage: above programs, streams and collectives. The kernel computes each element's value and derivatives, and for each
read of a Table the place of its element. The sums are those of `Stream.sum` and `sh.scatter`, whose orders are fixed:
all backends give the same bits.

    step = sh.value_and_gradient(error, (gain, heights))
    value, (d_gain, d_heights) = step(uv=places, target=picture)
    gain.value -= 0.1 * d_gain
    heights.update(heights.host_array() - 0.1 * d_heights)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from shpy.collectives import scatter
from shpy.collectives.programs import annotated, sums
from shpy.errors import ShpyTypeError
from shpy.gradients.sums import SummedLeaves, summed_leaves
from shpy.ieee import in_ieee_arithmetic
from shpy.ir.constants import dtypes_at
from shpy.lang.data.tables import Table, TableType
from shpy.lang.data.textures import Texture, TextureType
from shpy.lang.recording.location import here
from shpy.lang.values.structure import build_arrays, layout_of, leaves
from shpy.lang.values.types import Attrib1i
from shpy.passes.modes import Precision
from shpy.programs import Program, check_program
from shpy.run.host import bind, table_of
from shpy.streams.stream import Stream, streams_in


def value_and_gradient(
    program: Program, wrt: Any, *, mode: Literal["forward", "reverse"] = "reverse", most: int | None = None
) -> ValueAndGradient:
    """Return the function that runs a program and returns the sum of its output over all elements, and its gradient.

    The output is one float. `wrt` is a Param, a Table or a Texture, or its name, or a tuple of them for a tuple of
    gradients; inputs that are Tables or Textures are named, too. A gradient is an array of the shape of the Param or
    the data, of a struct a named tuple. `mode` and `most` are those of `sh.gradient`; Tables take reverse mode.

    The function takes the inputs of the program, arrays or streams, and `backend=`, `device=`, `precision=`, `shape=`
    and `where=` as `Program.compile` and `Kernel.run` do. Elements that are discarded do not count. A read of a Table
    out of range counts for the nearest element, which it reads. Divide by the number of elements for a mean.

    Of the reads of a Table in loops a run of the kernel gives 16, so many reads take several runs.

    Raises ShpyTypeError for a program with other outputs, and for other inputs; RecordError where the output does not
    depend on one of `wrt`, and for a loop without a bound.
    """
    check_program(program)
    several = isinstance(wrt, tuple | list)
    entries = [_entry(program, w) for w in (wrt if several else (wrt,))]
    are_tables = [isinstance(w, Table) or (isinstance(w, str) and w in program.inputs) for w in entries]
    tables = _checked(program, [w for w, is_table in zip(entries, are_tables, strict=True) if is_table], mode)
    params = [w for w, is_table in zip(entries, are_tables, strict=True) if not is_table]
    summed = summed_leaves(program.recorded, params, tables, mode, most)
    return ValueAndGradient(program, Program(summed.recorded), summed, tables, are_tables, several)


@dataclass(frozen=True)
class ValueAndGradient:
    """The function that `value_and_gradient` returns; it can be pickled.

    `flat` is the program of `summed`. `tables` are those of `wrt`, and `are_tables` has for each of `wrt` whether it is
    one.
    """

    program: Program
    flat: Program
    summed: SummedLeaves
    tables: Sequence[str | Table]
    are_tables: Sequence[bool]
    several: bool

    @in_ieee_arithmetic
    def __call__(
        self,
        *args: Any,
        backend: str | None = None,
        device: int | None = None,
        precision: Precision = "f32",
        shape: Any = None,
        where: Any = None,
        **inputs: Any,
    ) -> Any:
        """Return the sum and its gradient."""
        summed, flat = self.summed, self.flat
        stream = next(streams_in(chain(args, inputs.values(), flat.recorded.tables.values())), None)
        if stream is not None:
            backend, device, precision = stream.place
        kernel = flat.compile(backend, device=device or None, precision=precision)
        values = bind(self.program.recorded, args, inputs)
        data = [w if isinstance(w, Table) else table_of(w, flat.inputs[w], values[w]) for w in self.tables]
        by_tables = [_zeros(table, precision) for table in data]
        totals: list[Any] = []
        for more, counted in summed.runs():
            outputs = kernel.run(**values, **more, shape=shape, where=where).outputs
            parts = iter([_stream(x, cls, precision) for x, cls in zip(outputs, flat.outputs.values(), strict=True)])
            results = [next(parts) for _ in leaves(summed.layout, "")]
            totals = totals or [x.sum() for x in results]
            _add_reads(by_tables, summed.leaves, parts, counted)
        value, *by_params = build_arrays(summed.layout, iter(totals))
        of_tables = [build_arrays(layout_of(t.type, ""), iter(g)) for t, g in zip(data, by_tables, strict=True)]
        gradients = tuple((of_tables if is_table else by_params).pop(0) for is_table in self.are_tables)
        return value, gradients if self.several else gradients[0]


def _entry(program: Program, w: Any) -> Any:
    """Return a Param or its name, the Table that a program captures, or the name of an input that is one."""
    w = w.table if isinstance(w, Texture) else w
    if isinstance(w, str) and w not in program.inputs:
        w = program.tables.get(w, w)
    type_ = program.inputs.get(w) if isinstance(w, str) else None
    if isinstance(w, Table):
        _check_floats(w.name or "the Table", w.type)
    elif isinstance(type_, TableType | TextureType):
        _check_floats(w, type_.cls)
    elif type_ is not None:
        raise ShpyTypeError(
            f"sh.value_and_gradient takes Params and Tables, and {w} is another input",
            loc=here(),
            cure=f"{program.name}.gradient({w!r}) for the derivative by an input, element by element",
        )
    return w


def _checked(program: Program, tables: list[Any], mode: str) -> list[Any]:
    """Return the tables; ShpyTypeError in forward mode, and where one is named twice."""
    if tables and mode == "forward":
        raise ShpyTypeError("a gradient by a Table takes reverse mode", loc=here(), cure='mode="reverse", the default')
    twice = next((t for k, t in enumerate(tables) if t in tables[:k]), None)
    if twice is not None:
        name = twice.name if isinstance(twice, Table) else twice
        raise ShpyTypeError(f"{name} is named twice in the gradient of {program.name}", loc=here(), cure=f"{name} once")
    return tables


def _check_floats(name: str, element: Any) -> None:
    for path, _, cls in leaves(layout_of(element, name), name):
        if not cls.type.is_float:
            raise ShpyTypeError(
                f"{path} is a Table of {cls.__name__}, which has no derivative, it moves in steps",
                loc=here(),
                cure=f"a Table of sh.Attrib{cls.size}f",
            )


def _stream(x: Any, cls: Any, precision: Precision) -> Stream:
    return x if isinstance(x, Stream) else Stream(x, cls, "numpy", precision=precision)


def _zeros(table: Table, precision: Precision) -> list[NDArray[Any]]:
    """Return a zero for each number of a table, leaf by leaf."""
    return [
        np.zeros((*table.shape, *([cls.size] if cls.size > 1 else [])), dtypes_at(precision)[cls.type.base])
        for _, _, cls in leaves(layout_of(table.type, ""), "")
    ]


def _add_reads(
    totals: Sequence[list[NDArray[Any]]], moved: Sequence[tuple[int, int]], parts: Iterator[Stream], counted: int
) -> None:
    """Add the derivatives of a run's reads to those by tables, without the reads before the one numbered `counted`.

    `moved` are the numbers of the table and the leaf of each read, and `parts` are its place and its derivative. The
    derivatives of a read are added in the order of the elements of the run, and these sums in the order of reads.
    """
    for k, (table, leaf) in enumerate(moved):
        place, derivative = next(parts), next(parts)
        if k >= counted:
            total = totals[table][leaf]
            add = sums(derivative.type.size, derivative.type.base, "pairwise").combine
            count = total.size // derivative.type.size
            total += scatter(derivative, _before()(place), count, combine=add).numpy().reshape(total.shape)


@cache
def _before() -> Program:
    """Record the program that makes an index of a place; the index of a read that did not run is -1, out of range."""
    return annotated(lambda place: place - 1, place=Attrib1i, out=Attrib1i)
