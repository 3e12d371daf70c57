"""The cases of the conformance list.

A case is a program with the arrays to run it on. The interpreter computes the expected result; every target must agree,
to the bit. Where that is known without it, `expected` has the results, a function of the inputs, or the syntax of the
program: tests compare the interpreter with these.

    @case(x=[1.0, -0.0, np.nan], expected=lambda x: np.sign(x))
    def signs(x: sh.Attrib1f) -> sh.Attrib1f:
        return sh.sign(x)
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

import shpy as sh
from shpy.backend.base import Array
from shpy.ir.constants import DTYPES
from shpy.ir.ops import Tolerance
from shpy.ir.types import Base
from shpy.lang.data.tables import TableType
from shpy.lang.data.textures import TextureType
from shpy.lang.programs.record import InputType
from shpy.lang.values.structure import leaves as leaves_of
from shpy.testing.arrays import differing, flat_leaves
from shpy.testing.denormals import meets_denormals
from shpy.testing.observers import Setting
from shpy.testing.reference import INTERPRETER, PREPARED, flushes, kernel

F = TypeVar("F", bound=Callable[..., Any])
EXACT = Tolerance()
COUNT = 48
INTERPRETED = (INTERPRETER, PREPARED)
THIN = 11


@dataclass(frozen=True)
class Outcome:
    """The results of a run: the leaves of its outputs, which elements were written, how many ran out of iterations."""

    outputs: list[Array]
    written: Array
    stopped: int = 0
    line: int | None = None


@dataclass(eq=False)
class Case:
    """`inputs` are arrays by name; those left out are made up by `data`. `outs` fills `out` with sevens first.

    `refused` is the word in the error of a target that cannot compile it; `bound` is how far `expected` may be off.
    With `meaning` the reference is computed at once, for there are many elements; the interpreter then runs some of
    them.
    """

    name: str
    build: Callable[[], sh.Program]
    inputs: Mapping[str, Any] = field(default_factory=dict)
    shape: tuple[int, ...] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    bound: Tolerance = EXACT
    refused: Mapping[str, str] = field(default_factory=dict)
    expected: Any = None
    outs: bool = False
    meaning: Callable[[Mapping[str, Array]], list[Array]] | None = None

    @functools.cached_property
    def program(self) -> sh.Program:
        """The recorded program."""
        return self.build()

    @functools.cached_property
    def arrays(self) -> dict[str, Any]:
        """Every input."""
        types: Mapping[str, InputType] = self.program.recorded.inputs
        arrays = {}
        for n, (name, type_) in enumerate(types.items()):
            arrays[name] = self.inputs[name] if name in self.inputs else made_up(type_, n)
        return arrays

    def run(self, backend: str, **more: Any) -> Outcome:
        """Run it there; `more` are options of compiling beside its own, such as the device."""
        if self.meaning is not None and backend in INTERPRETED:
            thinned = {name: array[::THIN] for name, array in self.arrays.items()}
            result = kernel(self.program, backend, **self.options).run(**thinned)
            return Outcome(flat_leaves(result.outputs), result.written)
        compiled = kernel(self.program, backend, **{**self.options, **more})
        out = None
        if self.outs:
            blank = compiled.run(**self.arrays, shape=self.shape).outputs
            out = tree_map(lambda a: np.full_like(a, True if a.dtype == bool else 7), blank)
        try:
            result = compiled.run(**self.arrays, shape=self.shape, out=out)
        except sh.LoopLimitExceeded as error:
            line = error.loc.line if error.loc else None
            return Outcome(flat_leaves(error.result.outputs), error.result.written, error.count, line)
        return Outcome(flat_leaves(result.outputs), result.written)

    @functools.cached_property
    def reference(self) -> Outcome:
        """Return the interpreter's result."""
        if self.meaning is not None:
            outputs = self.meaning(self.arrays)
            return Outcome(outputs, np.ones(len(outputs[0]), np.bool_))
        return self.run(INTERPRETER)

    @functools.cached_property
    def denormals(self) -> Array:
        """The elements on whose way a denormal arises."""
        return meets_denormals(Setting(self.program, (), self.arrays, self.shape, self.options))

    def check(self, outcome: Outcome, who: str) -> None:
        """Raise AssertionError unless the outcome of the target `who` equals the reference's."""
        wrong = self.difference(outcome, who)
        if wrong is not None:
            raise AssertionError(wrong)

    def difference(self, result: Outcome, who: str, **more: Any) -> str | None:
        """Describe how a target's outcome differs from the reference's; None if it does not. `more` as for `run`.

        Elements that meet a denormal on their way may differ on a device that flushes denormals.
        """
        expected = self.reference
        if self.meaning is not None and who in INTERPRETED:
            expected = Outcome([a[::THIN] for a in expected.outputs], expected.written[::THIN])
        if (result.stopped, result.line) != (expected.stopped, expected.line):
            return (
                f"{self.name} on {who}: {result.stopped} elements stopped in a loop at line {result.line}, "
                f"not {expected.stopped} at line {expected.line}"
            )
        if not np.array_equal(result.written, expected.written):
            return f"{self.name} on {who}: written {result.written}, not {expected.written}"
        shapes = [[(a.dtype, a.shape) for a in outcome.outputs] for outcome in (result, expected)]
        if shapes[0] != shapes[1]:
            return f"{self.name} on {who}: outputs of {shapes[0]}, not {shapes[1]}"
        for n, (a, b) in enumerate(zip(result.outputs, expected.outputs, strict=True)):
            wrong = differing(a, b)
            rank = expected.written.ndim
            elements = wrong.any(axis=tuple(range(rank, wrong.ndim))).ravel()
            for k in np.flatnonzero(elements):
                if flushes(who, more.get("device")) and self.denormals[k]:
                    continue
                inputs = {name: element(array, int(k), expected.written.shape) for name, array in self.arrays.items()}
                x, y = (element(v, int(k), expected.written.shape) for v in (a, b))
                return f"{self.name} on {who}, output {n}, for {inputs}: {x!r}, not {y!r}"
        return None


def element(array: Any, k: int, shape: tuple[int, ...]) -> Any:
    """Return the k-th element of an array over `shape`, for a message."""
    values = np.asarray(array)
    if values.dtype == object or values.ndim < len(shape) or values.shape[: len(shape)] != shape:
        return array
    return values[np.unravel_index(k, shape)]


def tree_map(f: Callable[[Array], Array], outputs: Any) -> Any:
    """Return the outputs' structure with `f` of each array."""
    if isinstance(outputs, tuple | list):
        parts = [tree_map(f, part) for part in outputs]
        return type(outputs)(*parts) if hasattr(outputs, "_fields") else type(outputs)(parts)
    if isinstance(outputs, dict):
        return {name: tree_map(f, part) for name, part in outputs.items()}
    return f(outputs)


SPECIAL: dict[Base, Array] = {
    Base.F: np.array([
        0.0, -0.0, 1, -1, 0.5, -0.5, 1.5, 2.5, -2.5, 3.5, 0.1, 2, -3, 7, 3.7, -7.3, 0.99999994, 1.0000001, 1e-45,
        -1e-40, 1.1754944e-38, -1.1754942e-38, 1e-7, 1e10, -1e10, 2**31, -(2**31), 2**31 - 128, 2**31 + 256, 2**32,
        4294967040, 2**24 + 2, 8388607.5, 4194304.5, 0.49999997, 65519.9, 65520, 6e-8, 1.7e38,
        3.4028235e38, -3.4028235e38, np.inf, -np.inf, np.nan,
    ]).astype(np.float32),
    Base.I: np.array([
        0, 1, -1, 2, -2, 3, -3, 7, -7, 31, 32, 33, 63, -32, 12345, -54321, 0x55555555, 2**24 + 1, 2**31 - 1, 2**31 - 2,
        -(2**31), 1 - 2**31,
    ]).astype(np.int32),
    Base.U: np.array([
        0, 1, 2, 3, 7, 31, 32, 33, 63, 255, 12345, 0x55555555, 0xAAAAAAAA, 2**24 + 1, 2**31 - 1, 2**31, 2**32 - 2,
        2**32 - 1,
    ]).astype(np.uint32),
    Base.B: np.array([False, True]),
}  # fmt: skip
SPECIAL[Base.D] = np.concatenate([SPECIAL[Base.F].astype(np.float64), [1e300, -1e-310, 5e-324, 0.1, 1 / 3, 2**53 + 2]])
SPECIAL[Base.H] = np.array([
    0.0, -0.0, 1, -1, 0.5, 1.5, 2.5, -2.5, 0.1, 3.7, 6e-8, -6e-8, 6.1e-5, 6.09e-5, 2048, 2049, 1024.5, 65504, -65504,
    np.inf, -np.inf, np.nan,
]).astype(np.float16)  # fmt: skip


def data(base: Base, size: int, count: int = COUNT, seed: int = 0) -> Array:
    """Elements that are ordinary, some with special values among their components."""
    rng = np.random.default_rng([seed, size, count, list(Base).index(base)])
    shape = (count, size) if size > 1 else (count,)
    ordinary = rng.integers(0 if base is Base.U else -6, 7, shape)
    drawn = rng.uniform(-4, 4, shape) if base in (Base.F, Base.D, Base.H) else ordinary
    whole = (drawn > 0) if base is Base.B else drawn.astype(DTYPES[base])
    return np.where(rng.random(shape) < 0.2, rng.choice(SPECIAL[base], shape), whole)


def made_up(type_: InputType, seed: int) -> Any:
    """Elements for an input; its leaves differ."""
    assert not isinstance(type_, TableType | TextureType), "a case gives its tables"
    flat = [data(cls.base, cls.size, seed=31 * seed + n) for n, (_, _, cls) in enumerate(leaves_of(type_, "input"))]
    return flat[0] if len(flat) == 1 else flat


def by_decorator(cases: list[Case]) -> Callable[..., Callable[[F], F]]:
    """Return the decorator that adds a function, to be recorded when it is needed, to a list of cases."""

    def case(
        *,
        expected: Any = None,
        shape: tuple[int, ...] | None = None,
        options: Mapping[str, Any] | None = None,
        ulp: float = 0,
        absolute: float = 0,
        refused: Mapping[str, str] | None = None,
        outs: bool = False,
        **inputs: Any,
    ) -> Callable[[F], F]:
        bound = Tolerance(ulp, absolute)

        def add(function: F) -> F:
            instance = Case(
                function.__name__, lambda: sh.program(function), inputs, shape, options or {}, bound,
                refused or {}, expected, outs,
            )  # fmt: skip
            cases.append(instance)
            return function

        return add

    return case
