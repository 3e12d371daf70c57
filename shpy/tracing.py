"""A trace: the steps of one element of a run, in the reference interpreter.

Stage: above the host's checks, below programs. Takes a recorded program, its inputs and the place of one element; gives
the value of each name at each step.

    for step in trace(recorded, (), {"x": image}, at=(3, 4)):
        print(step)                  # shade.py:12 [iteration 2, 1]: depth = 0.25
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from shpy.errors import ShpyTypeError
from shpy.ir.constants import dtypes_at, is_int
from shpy.ir.nodes import Function, Loc, Loop, Module, Store
from shpy.ir.traverse import grid_rank, walk
from shpy.lang.data.tables import TableType
from shpy.lang.data.textures import TextureType
from shpy.lang.programs.record import RecordedProgram
from shpy.lang.recording.location import here
from shpy.lang.values.coerce import sequence
from shpy.run.host import bind, common_shape, streams, tables, uniforms
from shpy.streams.elements import Shape
from shpy.streams.stream import Stream


@dataclass(frozen=True)
class Step:
    """One step of a trace: the user's line, the name of the computed or stored value, and the value.

    `iterations` are the numbers of the iterations of the loops around the step, counted from 1, the outermost loop
    first; empty outside of loops. A loop around the call of a subroutine is around the subroutine's steps too.
    """

    loc: Loc | None
    name: str | None
    value: Any
    iterations: tuple[int, ...] = ()

    def __str__(self) -> str:
        iteration = f" [iteration {', '.join(map(str, self.iterations))}]" if self.iterations else ""
        return f"{self.loc}{iteration}: {self.name or '·'} = {self.value}"


def trace(recorded: RecordedProgram, args: Sequence[Any], named: Mapping[str, Any], shape: Any, at: Any) -> list[Step]:
    """Run the element at index `at` of a run over these inputs and give its steps, as `Program.trace` describes."""
    inputs = {
        name: value.numpy() if isinstance(value, Stream) and not _is_table(recorded, name) else value
        for name, value in bind(recorded, args, named).items()
    }
    dtypes = dtypes_at("f32")
    leaves = streams(recorded.inputs, inputs, "f32")
    whole = common_shape(leaves, shape)
    index = _index(recorded, whole, at)
    flat = [np.broadcast_to(leaf.array, whole + leaf.array.shape[len(leaf.shape) :])[index] for leaf in leaves]
    data = {n: t.data(dtypes[t.type.base]) for n, t in tables(recorded.inputs, inputs, recorded.tables).items()}
    params = uniforms(recorded.params, "f32", "strict")
    steps: list[Step] = []

    def note(loc: Loc | None, name: str | None, value: Any, iterations: tuple[int, ...]) -> None:
        if name is not None:
            steps.append(Step(loc, name, np.array(value)[()], iterations))

    from shpy.ir.interpreter import Interpreter  # here: few programs are traced

    Interpreter(_without_counters(recorded.module)).run_element(flat, params, data, index, whole, trace=note)
    return steps


def _without_counters(module: Module) -> Module:
    """Take away the names of the counters of SH_FOR: in each iteration its variable, of the same name, is stored."""

    def unnamed(function: Function) -> Function:
        alike = Counter((v.name, v.loc) for v in function.variables)
        loops = (s for s in walk(function.body) if isinstance(s, Loop) and s.until is None)
        counters = {s.variable for loop in loops for s in loop.continuing if isinstance(s, Store)}
        variables = (
            replace(v, name=None) if v.id in counters and alike[v.name, v.loc] > 1 else v for v in function.variables
        )
        return replace(function, variables=tuple(variables))

    return replace(module, functions=tuple(map(unnamed, module.functions)))


def _is_table(recorded: RecordedProgram, name: str) -> bool:
    return isinstance(recorded.inputs[name], TableType | TextureType)


def _index(recorded: RecordedProgram, shape: Shape, at: Any) -> tuple[int, ...]:
    """Return the index of the element to trace; raise ShpyTypeError where `at` or the shape does not fit."""
    name, rank = recorded.module.name, grid_rank(recorded.module)
    if rank is not None and rank != len(shape):
        raise ShpyTypeError(
            f"{name} uses grid_index({rank}) and is traced over the shape {shape}",
            loc=here(),
            cure=f"shape={_tuple('ndhw'[-rank:])}, at={_tuple('nzyx'[-rank:])}",
        )
    if 0 in shape:
        cure = "one element at least"
        raise ShpyTypeError(f"there is no element to trace: the shape is {shape}", loc=here(), cure=cure)
    index = _given_index(at, shape)
    example = f"at={_spoken((0,) * len(shape))}, one index for each axis of the shape"
    if index is None:
        count = math.prod(shape)
        raise ShpyTypeError(
            f"trace runs one element, and there are {count}, of the shape {shape}", loc=here(), cure=example
        )
    if len(index) != len(shape):
        indices = f"{len(index)} {'index' if len(index) == 1 else 'indices'}"
        axes = f"{len(shape)} {'axis' if len(shape) == 1 else 'axes'}"
        raise ShpyTypeError(f"at={at!r} has {indices}, and the shape {shape} has {axes}", loc=here(), cure=example)
    if not all(0 <= n < extent for n, extent in zip(index, shape, strict=True)):
        first, last = _spoken((0,) * len(shape)), _spoken(tuple(extent - 1 for extent in shape))
        cure = f"at={first} to at={last}"
        raise ShpyTypeError(f"at={at!r} is not inside the shape {shape}", loc=here(), cure=cure)
    return index


def _given_index(at: Any, shape: Shape) -> tuple[int, ...] | None:
    """Return `at` as a tuple; None if it is missing and the shape has several elements."""
    if at is None:
        return (0,) * len(shape) if math.prod(shape) == 1 else None
    indices = [at] if is_int(at) else sequence(at)
    if indices is None or not all(map(is_int, indices)):
        raise ShpyTypeError(f"at={at!r} is neither an int nor a tuple of ints", loc=here(), cure="at=(y, x)")
    return tuple(int(n) for n in indices)


def _tuple(names: str) -> str:
    """Return single letters as the text of a tuple."""
    return f"({names},)" if len(names) == 1 else f"({', '.join(names)})"


def _spoken(index: tuple[int, ...]) -> str:
    """Return the text of an index as a user would write it: an int for one axis."""
    return str(index[0]) if len(index) == 1 else str(index)
