"""The result of a small program, evaluated directly from its syntax, element by element: the oracle of tests.

It shares nothing with recording, the IR's control flow and the passes; the meaning of each operation is the table's,
and that of a transcendental its formula, operation by operation.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from shpy.ir import meaning
from shpy.ir.constants import DTYPES
from shpy.testing.conformance.exact import exact
from shpy.testing.generated import syntax
from shpy.testing.generated.source import PARAMS, TABLES
from shpy.testing.generated.syntax import FIELDS

DISCARDED, WRITTEN, STOPPED = 0, 1, 2


class Leave(Exception):
    """Control leaves a block: break, continue, return, discard, or a loop that took too many iterations."""

    def __init__(self, kind: str) -> None:
        super().__init__(kind)
        self.kind = kind


class Evaluator:
    """One element. `scope` holds numpy scalars, (size,) arrays, and (length[, size]) arrays."""

    def __init__(self, program: syntax.Tree) -> None:
        self.program = program
        self.functions: dict[str, syntax.Function] = {f.name: f for f in program.functions}

    def run(self, inputs: list[Any]) -> tuple[list[Any], int]:
        """Return the outputs, and DISCARDED, WRITTEN or STOPPED."""
        scope: dict[str, Any] = dict(zip((i.name for i in self.program.inputs), inputs, strict=True))
        scope |= {name: np.asarray(param.value)[()] for name, param in PARAMS.items()}
        for array in self.program.arrays:
            if array.struct:
                for field, type in FIELDS.items():
                    scope[f"{array.name}.{field}"] = self.zeros(syntax.Variable("", type, array.length))
            else:
                scope[array.name] = self.zeros(array)
        with np.errstate(all="ignore"):
            try:
                self.body(self.program.body, scope)
            except Leave as leave:
                return [], STOPPED if leave.kind == "stopped" else DISCARDED
            return [self.value(e, scope) for e in self.program.results], WRITTEN

    @staticmethod
    def zeros(array: syntax.Variable) -> Any:
        """Return the initial contents of an array."""
        tail = (array.type.size,) if array.type.size > 1 else ()
        return np.zeros((array.length or 0, *tail), DTYPES[array.type.base])

    def body(self, block: syntax.Block, scope: dict[str, Any]) -> None:
        """Run a function's body, which a return ends."""
        try:
            self.block(block, scope)
        except Leave as leave:
            if leave.kind != "return":
                raise

    def block(self, block: syntax.Block, scope: dict[str, Any]) -> None:
        """Execute statements in order."""
        for statement in block:
            self.statement(statement, scope)

    def statement(self, s: syntax.Stmt, scope: dict[str, Any]) -> None:
        """Execute one statement."""
        if isinstance(s, syntax.Plain):
            self.plain(s, scope)
            return
        match s:
            case syntax.Call():
                self.call(s, scope)
            case syntax.Lanes(_, condition, name, value):
                if self.value(condition, scope):
                    scope[name] = self.value(value, scope)
            case syntax.If(branches, orelse):
                for condition, body in branches:
                    if self.value(condition, scope):
                        self.block(body, scope)
                        return
                self.block(orelse or (), scope)
            case syntax.Exit(kind, condition):
                if condition is None or self.value(condition, scope):
                    raise Leave(kind)
            case syntax.While() | syntax.Do() | syntax.For():
                self.loop(s, scope)

    def plain(self, s: syntax.Plain, scope: dict[str, Any]) -> None:
        """Execute a statement that is neither control flow nor a call."""
        match s:
            case syntax.Declare(name, value):
                scope[name] = self.value(value, scope)
            case syntax.DeclareMatrix(name, rows):
                scope |= {f"{name}[{r}]": self.value(row, scope) for r, row in enumerate(rows)}
            case syntax.DeclareStruct(name, values):
                scope |= {f"{name}.{f}": self.value(v, scope) for f, v in zip(FIELDS, values, strict=True)}
            case syntax.Assign():
                self.assign(s, scope)
            case syntax.StoreAt(name, index, value):
                scope[name] = scope[name].copy()
                self.put(scope[name], self.value(index, scope), self.value(value, scope))
            case syntax.Write(name, index, value, op):
                at, new = self.value(index, scope), self.value(value, scope)
                if op is not None:
                    new = self.apply(op, [self.at(scope[name], (at,)), new])
                self.put(scope[name], at, new)
            case syntax.WriteStruct(name, index, values):
                at, fields = self.value(index, scope), [self.value(v, scope) for v in values]
                for field, new in zip(FIELDS, fields, strict=True):
                    self.put(scope[f"{name}.{field}"], at, new)
            case syntax.Multiply(name, other):
                right = self.matrix(other, scope)
                products = [self.combine(row, right) for row in self.matrix(name, scope)]
                scope |= {f"{name}[{r}]": row for r, row in enumerate(products)}

    @staticmethod
    def put(array: Any, index: Any, value: Any) -> None:
        """Store into an element of an array, or a component of a vector, that is there."""
        if 0 <= int(index) < len(array):
            array[int(index)] = value

    @staticmethod
    def at(array: Any, index: tuple[Any, ...]) -> Any:
        """Return a copy of the nearest element that is there."""
        return array[tuple(np.clip(int(i), 0, n - 1) for i, n in zip(index, array.shape, strict=False))].copy()

    @staticmethod
    def matrix(name: str, scope: dict[str, Any]) -> list[Any]:
        """Return the rows of a matrix."""
        rows: list[Any] = []
        while f"{name}[{len(rows)}]" in scope:
            rows.append(scope[f"{name}[{len(rows)}]"])
        return rows

    def combine(self, vector: Any, rows: list[Any]) -> Any:
        """Return the row vector times the matrix, summed from the first row on."""
        total = vector[0] * rows[0]
        for number, row in zip(vector[1:], rows[1:], strict=True):
            total = total + number * row
        return total

    def product(self, e: syntax.Product, scope: dict[str, Any]) -> Any:
        """Multiply a matrix and a vector, in the order that the language names."""
        vector, rows = self.value(e.vector, scope), self.matrix(e.matrix, scope)
        return self.combine(vector, rows) if e.left else np.array([self.apply("dot", [r, vector]) for r in rows])

    def assign(self, s: syntax.Assign, scope: dict[str, Any]) -> None:
        """Store into a variable, or into some of its components."""
        old, value = scope[s.name], self.value(s.value, scope)
        if s.picked is None:
            scope[s.name] = self.apply(s.op, [old, value]) if s.op else value
            return
        picked = list(s.picked) if len(s.picked) > 1 else s.picked[0]
        new = old.copy()
        new[picked] = self.apply(s.op, [old[picked], value]) if s.op else value
        scope[s.name] = new

    def call(self, s: syntax.Call, scope: dict[str, Any]) -> None:
        """Call a subroutine: what it stores in a parameter comes back."""
        function = self.functions[s.function]
        inner = {p.name: self.value(a, scope) for p, a in zip(function.params, s.args, strict=True)}
        self.body(function.body, inner)
        for param, arg in zip(function.params, s.args, strict=True):
            if param.name in function.stored:
                assert isinstance(arg, syntax.Name)
                scope[arg.name] = inner[param.name]
        if s.result is not None:
            scope[s.result] = self.value(function.results[0], inner)

    def loop(self, s: syntax.While | syntax.Do | syntax.For, scope: dict[str, Any]) -> None:
        """Run a loop; an iteration is counted once the loop's test has passed."""
        bounds = [int(self.value(b, scope)) for b in s.bounds] if isinstance(s, syntax.For) else []
        indices = iter(range(*bounds)) if isinstance(s, syntax.For) else None
        constant = isinstance(s, syntax.For) and all(isinstance(b, syntax.Const) for b in s.bounds)
        limit = self.program.loop_limit
        count = 0
        while True:
            if indices is not None:
                index = next(indices, None)
                if index is None:
                    return
                scope[s.index] = np.int32(index)  # type: ignore[union-attr]
            if isinstance(s, syntax.While) and not self.value(s.condition, scope):
                return
            if count == limit and not constant:
                raise Leave("stopped")
            count += 1
            try:
                self.block(s.body, scope)
            except Leave as leave:
                if leave.kind == "break":
                    return
                if leave.kind != "continue":
                    raise
            if isinstance(s, syntax.Do) and self.value(s.until, scope):
                return

    def value(self, e: syntax.Expr, scope: dict[str, Any]) -> Any:
        """Return the value of an expression."""
        match e:
            case syntax.Const(type, values):
                array = np.array(values).astype(DTYPES[type.base])
                return array if type.size > 1 else array[0]
            case syntax.Name(_, name):
                return scope[name]
            case syntax.Splat(type, scalar):
                return np.full(type.size, self.value(scalar, scope))
            case syntax.Apply(_, op, args):
                return self.apply(op, [self.value(a, scope) for a in args])
            case syntax.Convert(type, inner):
                return meaning.convert(self.value(inner, scope), DTYPES[type.base])
            case syntax.Construct(_, parts):
                array = np.concatenate([np.atleast_1d(self.value(p, scope)) for p in parts])
                return np.full(e.type.size, array[0]) if len(array) == 1 else array
            case syntax.Swizzle(_, inner, picked):
                return np.atleast_1d(self.value(inner, scope))[list(picked) if len(picked) > 1 else picked[0]]
            case syntax.Component(_, inner, index):
                return self.at(self.value(inner, scope), (self.value(index, scope),))
            case syntax.Read(_, name, index, field):
                key = f"{name}.{field}" if field else name
                data = scope[key] if key in scope else TABLES[name].data(np.float32).array
                return self.at(data, tuple(self.value(i, scope) for i in index))
            case syntax.LaneIndex(_, _, condition):
                self.value(condition, scope)
                return np.int32(7)
            case syntax.Product():
                return self.product(e, scope)

    @staticmethod
    def apply(op: str, args: list[Any]) -> Any:
        """Return the value of an operation of the table."""
        if op == "floordiv" and args[0].dtype.kind == "f":
            return floor_quotient(*args)[()]
        if op == "floormod" and args[0].dtype.kind == "f":
            op = "mod"
        return exact(op)(*args)[()]


def floor_quotient(x: Any, y: Any) -> Any:
    """Return floor(x / y); -1 where the quotient is negative and so small that it is flushed to zero."""
    quotient = np.floor(x / y)
    below = (quotient == 0) & (x != 0) & ((x < 0) != (y < 0)) & ~np.isinf(y)
    return np.where(below, quotient.dtype.type(-1), quotient)


def evaluated(program: syntax.Tree, *inputs: Any) -> tuple[Any, ...]:
    """Return the outputs for arrays of elements, zeros for elements that were discarded or stopped."""
    ends = [Evaluator(program).run(list(element)) for element in zip(*inputs, strict=True)]
    blank = [0] * len(program.results)
    return tuple(map(np.array, zip(*(outputs if end == WRITTEN else blank for outputs, end in ends), strict=True)))
