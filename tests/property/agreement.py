"""Compare every way of running a small program with what its syntax says, bit by bit.

check(program, INPUTS, ("numpy", "opencl"))   # AssertionError with the program's text, the element and both answers

Each backend runs twice: undisturbed, and in the stress mode over many copies of the same elements, for half of the
programs over streams.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from backends.running import differs, flushes_denormals, kernel
from property.evaluate import DISCARDED, STOPPED, WRITTEN, Evaluator
from stress.mode import stressed

import shpy as sh
from shpy.backend.base import Array, Options
from shpy.ir.constants import DTYPES
from shpy.passes.modes import Math
from shpy.run.kernel import Kernel
from shpy.testing.arrays import flat_leaves
from shpy.testing.denormals import meets_denormals
from shpy.testing.generated.source import PARAMS, record, source
from shpy.testing.generated.syntax import Const, Tree
from shpy.testing.observers import Setting

Precision = Literal["f16", "f32", "f64"]
Answers = tuple[list[Array], Array]
LIMIT = 1_048_576
WORKING = {"f16": np.float16, "f32": np.float32, "f64": np.float64}


@dataclass
class Expected:
    """Return the outputs of a program for `inputs`, and how each element ends."""

    program: Tree
    inputs: list[Array]

    @property
    def shape(self) -> tuple[int, ...]:
        return (len(self.inputs[0]),)

    @cached_property
    def recorded(self) -> sh.Program:
        return record(self.program)

    @cached_property
    def answers(self) -> Answers:
        count = len(self.inputs[0])
        evaluator = Evaluator(self.program)
        outputs = [
            np.zeros((count, e.type.size) if e.type.size > 1 else (count,), DTYPES[e.type.base])
            for e in self.program.results
        ]
        ends = np.zeros(count, np.int32)
        for k in range(count):
            found, ends[k] = evaluator.run([a[k] for a in self.inputs])
            for output, one in zip(outputs, found, strict=False):
                output[k] = one
        return outputs, ends

    @property
    def names(self) -> list[str]:
        """The inputs of its kernels."""
        return [i.name for i in self.program.inputs]

    @property
    def given(self) -> list[Array]:
        """The arrays that its kernels take."""
        arrays = {i.name: a for i, a in zip(self.program.inputs, self.inputs, strict=True)}
        return [arrays[name].reshape(*self.shape, *arrays[name].shape[1:]) for name in self.names]

    @property
    def options(self) -> Options:
        return Options(loop_limit=self.program.loop_limit or LIMIT)

    @cached_property
    def denormals(self) -> Array:
        """Return the elements on whose way a denormal arises: a device that flushes them may go another."""
        options = {f.name: getattr(self.options, f.name) for f in fields(self.options)}
        arguments = {name: options[name] for name in ("precision", "math", "fuse", "loop_limit")}
        return meets_denormals(Setting(record(self.program), tuple(self.inputs), {}, None, arguments))

    def compare(self, outputs: list[Array], ends: Array, who: str) -> None:
        """Compare the status of every element and every bit of its outputs; all NaNs are equal."""
        expected, how = self.answers
        wrong = ends != how
        for found, wanted in zip(outputs, expected, strict=True):
            off = differs(found, wanted)
            wrong |= (off.any(axis=-1) if off.ndim > 1 else off) & (how == WRITTEN)
        for k in np.flatnonzero(wrong):
            if flushes_denormals(who) and self.denormals[k]:
                continue
            given = {i.name: a[k].tolist() for i, a in zip(self.program.inputs, self.inputs, strict=True)}
            raise AssertionError(
                f"{who}, for {given}: ended {ends[k]}, not {how[k]} (0 discarded, 1 written, 2 stopped), with\n"
                f"  {[o[k].tolist() for o in outputs]} instead of\n  {[o[k].tolist() for o in expected]}\n"
                f"{source(self.program)}\n{self.compiled(who).source}"
            )

    def compiled(self, who: str) -> Kernel:
        options = self.options
        return kernel(
            self.recorded,
            who,
            precision=options.precision,
            loop_limit=options.loop_limit,
            math=options.math,
            fuse=options.fuse,
        )


class Specialized(Expected):
    """A program in which some inputs are constants, with the values of the first element, and so are its uniforms."""

    def __init__(self, program: Tree, inputs: list[Array], constant: tuple[str, ...]) -> None:
        self.constant = {i.name: a[0] for i, a in zip(program.inputs, inputs, strict=True) if i.name in constant}
        same = [
            np.repeat(a[:1], len(a), axis=0) if i.name in constant else a
            for i, a in zip(program.inputs, inputs, strict=True)
        ]
        super().__init__(program, same)

    @cached_property
    def recorded(self) -> sh.Program:
        recorded = record(self.program)
        uniforms = {n: PARAMS[n].value for n in recorded.params}
        return recorded.specialize(**self.constant, **uniforms)

    @property
    def names(self) -> list[str]:
        return [name for name in super().names if name not in self.constant]


class Interpreted(Expected):
    """The reference results at another precision or in another mode, from the interpreter of the program's IR."""

    def __init__(
        self, program: Tree, inputs: list[Array], precision: Precision, math: Math, *, fuse: bool = False
    ) -> None:
        with np.errstate(over="ignore"):
            working = [a.astype(WORKING[precision]) if a.dtype.kind == "f" else a for a in inputs]
        super().__init__(program, working)
        self.precision, self.math, self.fuse = precision, math, fuse

    @property
    def options(self) -> Options:
        limit = self.program.loop_limit or LIMIT
        return Options(precision=self.precision, math=self.math, fuse=self.fuse, loop_limit=limit)

    @cached_property
    def answers(self) -> Answers:
        stopped: Any = None
        try:
            result = self.compiled("interpreter").run(*self.inputs)
        except sh.LoopLimitExceeded as error:
            result, stopped = error.result, error.count
        ends = np.where(result.written, WRITTEN, STOPPED if stopped else DISCARDED)
        return flat_leaves(result.outputs), ends


SHAPES = ((2100,), (33, 64), (1, 2112), (2112, 1), (48, 44), (3, 24, 30))
"""Shapes of runs in the stress mode: enough elements for several groups of packets, in one line and in many."""


class Repeated(Expected):
    """The same elements again and again, over a shape: enough of them to be split into dispatches."""

    def __init__(self, once: Expected, shape: tuple[int, ...]) -> None:
        self.once = once
        self._shape = shape
        super().__init__(once.program, [self._repeated(a) for a in once.inputs])

    @property
    def shape(self) -> tuple[int, ...]:
        return self._shape

    @property
    def names(self) -> list[str]:
        return self.once.names

    def _repeated(self, array: Array) -> Array:
        return np.resize(array, (int(np.prod(self._shape)), *array.shape[1:]))

    @property
    def recorded(self) -> sh.Program:  # type: ignore[override]
        return self.once.recorded

    @cached_property
    def denormals(self) -> Array:
        return self._repeated(self.once.denormals).ravel()

    @property
    def options(self) -> Options:
        return self.once.options

    @cached_property
    def answers(self) -> Answers:
        outputs, ends = self.once.answers
        return [self._repeated(o) for o in outputs], self._repeated(ends)


def wanted(
    program: Tree, inputs: list[Array], precision: Precision, math: Math = "strict", *, fuse: bool = False
) -> Expected:
    """Return the results of the program at a precision, in a mode."""
    plain = (precision, math, fuse) == ("f32", "strict", False)
    return Expected(program, inputs) if plain else Interpreted(program, inputs, precision, math, fuse=fuse)


def held_in_halves(part: Any) -> Any:
    """Return a part of a program in which the finite constants are those that f16 holds: others are errors there."""
    match part:
        case tuple():
            return tuple(map(held_in_halves, part))
        case Const(type, values) if type.is_float:
            return Const(type, tuple(v if np.isinf(v) else float(np.clip(v, -65504, 65504)) for v in values))
        case _ if is_dataclass(part) and not isinstance(part, Const):
            return replace(part, **{f.name: held_in_halves(getattr(part, f.name)) for f in fields(part)})
    return part


def check(
    program: Tree,
    inputs: list[Array],
    backends: tuple[str, ...],
    precision: Precision = "f32",
    constant: tuple[str, ...] = (),
    *,
    fuse: bool = False,
) -> None:
    """The text of the IR read back, and what each backend gives. Errors come with the program's text.

    The inputs named in `constant` are constants of the program, and so are its uniforms. With `fuse`, the reference is
    the interpreter of the contracted IR.
    """
    program = held_in_halves(program) if precision == "f16" else program
    expected = Specialized(program, inputs, constant) if constant else wanted(program, inputs, precision, fuse=fuse)
    try:
        module = expected.recorded.ir
        assert sh.parse(str(module)) == module
        for backend in backends:
            expected.compare(*ran(expected, backend), backend)
            if backend.partition("-")[0] in STRESSED:
                check_stressed(expected, backend)
    except AssertionError:
        raise
    except Exception as error:
        raise AssertionError(f"{type(error).__name__}: {error}\n{source(program)}") from error


STRESSED = frozenset({"numpy", "opencl", "glsl"})


def check_stressed(expected: Expected, backend: str) -> None:
    """Run once more, disturbed: by the same choices for each text of a program."""
    seed = zlib.crc32(source(expected.program).encode())
    repeated = Repeated(expected, SHAPES[seed % len(SHAPES)])
    with stressed(seed):
        repeated.compare(*ran(repeated, backend, over_streams=seed % 2 == 0), backend)


def ran(expected: Expected, backend: str, *, over_streams: bool = False) -> Answers:
    """Run the program on a backend; return its outputs and the status of each element."""
    stopped: Any = 0
    count = len(expected.inputs[0])
    shape = expected.shape
    kernel, inputs = expected.compiled(backend), expected.given
    if over_streams:
        types = expected.recorded.inputs
        inputs = [sh.Stream(a, types[n], *kernel.place) for n, a in zip(expected.names, inputs, strict=True)]
    try:
        result = kernel.run(*inputs)
    except sh.LoopLimitExceeded as error:
        result, stopped = error.result, error.count
    leaves = [s.numpy() for s in result.outputs] if over_streams else flat_leaves(result.outputs)
    outputs = [o.reshape(count, *o.shape[len(shape) :]) for o in leaves]
    written = np.asarray(result.written).reshape(count)
    ends = np.where(written, WRITTEN, DISCARDED)
    if stopped:
        # Which of the elements not written were stopped is not said; their number is.
        how = expected.answers[1]
        ends = np.where(~written & (how == STOPPED), STOPPED, ends)
        assert stopped == np.count_nonzero(how == STOPPED) or flushes_denormals(backend)
    return outputs, ends
