"""Builds one function: fresh ids, statements in order, nested regions.

Stage: represent. `lang` records with it, `passes` write new code with it; it gives a `Function`. It computes types by
the op table but checks little else: that is the verifier's.

>>> from shpy.ir.types import vec
>>> b = Builder("halve_until_small")
>>> x = b.input(vec("f"), "x")
>>> r = b.output(vec("f"), "r")
>>> b.store(r, x)
>>> with b.loop() as loop:
...     half = b.let("mul", b.load(r), b.const(vec("f"), [0.5]))
...     b.store(r, half)
...     loop.until(b.let("lt", half, b.const(vec("f"), [1.0])))
>>> len(b.finish().body)
2
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

from shpy.ir.constants import encode
from shpy.ir.nodes import (
    Attr,
    Break,
    Call,
    Continue,
    Discard,
    Function,
    If,
    Let,
    Loc,
    Loop,
    Region,
    Return,
    Stmt,
    Store,
    Value,
    Variable,
)
from shpy.ir.ops import OPS, result_type
from shpy.ir.traverse import defined
from shpy.ir.types import Type

Operand = Value | int
"""A value, or its id."""

Slot = Variable | int
"""A variable, or its id."""


def _id(thing: Value | Variable | int) -> int:
    return thing if isinstance(thing, int) else thing.id


class Builder:
    """Appends statements to the innermost open region of one function.

    With `function`, the new function has the same name, inputs, outputs and variables, and an empty body. Ids continue
    after its greatest, and the types of its values are known. `loc` is the default location of statements.
    """

    def __init__(self, name: str = "main", *, function: Function | None = None, loc: Loc | None = None) -> None:
        self.name = function.name if function else name
        self.inputs: list[Value | Variable] = list(function.inputs) if function else []
        self.outputs: list[Variable] = list(function.outputs) if function else []
        self.variables: list[Variable] = list(function.variables) if function else []
        self.pure = function.pure if function else False
        self.alone = function.alone if function else False
        self.tangent = function.tangent if function else None
        self.loc = loc
        self._function_loc = function.loc if function else loc
        self._regions: list[list[Stmt]] = [[]]
        self._types: dict[int, Type] = {v.id: v.type for v in defined(function)} if function else {}
        self._slots: dict[int, Variable] = {}
        for slot in (*self.inputs, *self.outputs, *self.variables):
            if isinstance(slot, Variable):
                self._slots[slot.id] = slot
        self._next_value = max(self._types, default=-1) + 1
        self._next_variable = max(self._slots, default=-1) + 1

    # Values and variables

    def value(self, type: Type, name: str | None = None, loc: Loc | None = None) -> Value:
        """Return a fresh value that no statement assigns yet."""
        value = Value(self._next_value, type, name, loc or self.loc)
        self._next_value += 1
        self._types[value.id] = type
        return value

    def variable(
        self, type: Type, length: int | None = None, name: str | None = None, loc: Loc | None = None
    ) -> Variable:
        """Return a fresh variable, which is zero at the function's start; with `length` it is an array."""
        variable = self._slot(type, length, name, loc)
        self.variables.append(variable)
        return variable

    def input(self, type: Type, name: str | None = None, loc: Loc | None = None) -> Value:
        """Add an input by value."""
        value = self.value(type, name, loc)
        self.inputs.append(value)
        return value

    def reference(
        self, type: Type, name: str | None = None, length: int | None = None, loc: Loc | None = None
    ) -> Variable:
        """Add an input by reference."""
        variable = self._slot(type, length, name, loc)
        self.inputs.append(variable)
        return variable

    def output(self, type: Type, name: str | None = None, loc: Loc | None = None) -> Variable:
        """Add an output."""
        variable = self._slot(type, None, name, loc)
        self.outputs.append(variable)
        return variable

    def _slot(self, type: Type, length: int | None, name: str | None, loc: Loc | None) -> Variable:
        variable = Variable(self._next_variable, type, length, name, loc or self.loc)
        self._next_variable += 1
        self._slots[variable.id] = variable
        return variable

    def type_of(self, value: Operand) -> Type:
        """Return the type of a value of this function; KeyError for an unknown value."""
        return value.type if isinstance(value, Value) else self._types[value]

    def slot(self, variable: Slot) -> Variable:
        """Return the variable with this id."""
        return variable if isinstance(variable, Variable) else self._slots[variable]

    # Statements

    def append(self, statement: Stmt) -> None:
        """Append an existing statement."""
        self._regions[-1].append(statement)

    def extend(self, statements: Iterable[Stmt]) -> None:
        """Append existing statements."""
        self._regions[-1].extend(statements)

    def let(
        self,
        op: str,
        *args: Operand,
        type: Type | None = None,
        attr: Attr = None,
        name: str | None = None,
        loc: Loc | None = None,
    ) -> Value:
        """Append `value = op(args)`. `type` is computed for a row of the op table; a structural op needs it given."""
        if type is None:
            if op not in OPS:
                raise TypeError(f"the type of {op} is not in the table: give type=")
            type = result_type(op, tuple(self.type_of(a) for a in args))
        value = self.value(type, name, loc)
        self.append(Let(value, op, tuple(map(_id, args)), attr))
        return value

    def const(
        self, type: Type, components: Iterable[float | int | bool], name: str | None = None, loc: Loc | None = None
    ) -> Value:
        """Return a constant with these components."""
        return self.let("const", type=type, attr=encode(type, components), name=name, loc=loc)

    def load(
        self, variable: Slot, index: Operand | None = None, name: str | None = None, loc: Loc | None = None
    ) -> Value:
        """Append a load of the variable, or of the array's element at `index`; return the value."""
        slot = self.slot(variable)
        args = () if index is None else (index,)
        return self.let("load", *args, type=slot.type, attr=slot.id, name=name, loc=loc)

    def swizzle(
        self, value: Operand, components: Sequence[int], name: str | None = None, loc: Loc | None = None
    ) -> Value:
        """Append a swizzle, which picks components; return the value."""
        type = self.type_of(value).sized(len(components))
        return self.let("swizzle", value, type=type, attr=tuple(components), name=name, loc=loc)

    def splat(self, value: Operand, size: int, name: str | None = None, loc: Loc | None = None) -> Value:
        """Return a vector of `size` equal components; the scalar itself for 1."""
        if size == 1 and isinstance(value, Value):
            return value
        return self.let("splat", value, type=self.type_of(value).sized(size), name=name, loc=loc)

    def store(
        self,
        variable: Slot,
        value: Operand,
        components: Sequence[int] | None = None,
        index: Operand | None = None,
        loc: Loc | None = None,
    ) -> None:
        """Store into the variable, some of its components, or an element of an array."""
        picked = None if components is None else tuple(components)
        at = None if index is None else _id(index)
        self.append(Store(_id(variable), _id(value), picked, at, loc or self.loc))

    def call(
        self, function: Function, *args: Value | Variable | int, name: str | None = None, loc: Loc | None = None
    ) -> tuple[Value, ...]:
        """Call `function`: by the op if it is pure, else by the statement; return its outputs."""
        if function.pure:
            value = self.value(function.outputs[0].type, name, loc)
            self.append(Let(value, "call", tuple(map(_id, args)), function.name))
            return (value,)
        results = tuple(self.value(output.type, output.name, loc) for output in function.outputs)
        self.append(Call(function.name, tuple(map(_id, args)), results, loc or self.loc))
        return results

    def exit(self, kind: type[Break | Continue | Return | Discard], loc: Loc | None = None) -> None:
        """Append an exit, which must be the last statement of its region."""
        self.append(kind(loc=loc or self.loc))

    # Regions

    @property
    def depth(self) -> int:
        """The number of open regions, the body included."""
        return len(self._regions)

    @property
    def region(self) -> Sequence[Stmt]:
        """The statements of the innermost open region so far."""
        return self._regions[-1]

    def push(self) -> None:
        """Open a region, to which the following statements are appended."""
        self._regions.append([])

    def pop(self) -> Region:
        """Close the innermost region and return its statements, from which the caller makes an If or Loop."""
        if len(self._regions) == 1:
            raise ValueError("the body of the function is closed by finish")
        return tuple(self._regions.pop())

    @contextmanager
    def when(self, condition: Operand, loc: Loc | None = None) -> Iterator[None]:
        """Append an If; the statements of the `with` block are its `then`."""
        self.push()
        yield
        self.append(If(_id(condition), self.pop(), (), loc or self.loc))

    @contextmanager
    def otherwise(self) -> Iterator[None]:
        """Add the statements of the `with` block as `orelse` to the If that was appended last."""
        last = self._regions[-1][-1] if self._regions[-1] else None
        if not isinstance(last, If) or last.orelse:
            raise ValueError("otherwise follows a when")
        self.push()
        yield
        orelse = self.pop()
        self._regions[-1][-1] = If(last.condition, last.then, orelse, last.loc)

    @contextmanager
    def loop(self, turns: int | None = None, loc: Loc | None = None) -> Iterator[LoopBuilder]:
        """Append a Loop whose body is the block; `LoopBuilder` adds `continuing` and `until`."""
        builder = LoopBuilder(self)
        self.push()
        yield builder
        last = self.pop()
        body, continuing = (last, ()) if builder.body is None else (builder.body, last)
        self.append(Loop(body, continuing, builder.condition, turns, loc or self.loc))

    def finish(self) -> Function:
        """Return the function; every pushed region must be closed."""
        if len(self._regions) != 1:
            raise ValueError(f"{len(self._regions) - 1} regions are still open")
        return Function(
            self.name,
            tuple(self.inputs),
            tuple(self.outputs),
            tuple(self.variables),
            tuple(self._regions[0]),
            self.pure,
            self._function_loc,
            self.alone,
            self.tangent,
        )


class LoopBuilder:
    """The loop that is being built: `continuing()` ends its body, `until(c)` names the condition that ends it."""

    def __init__(self, builder: Builder) -> None:
        self.builder = builder
        self.body: Region | None = None
        self.condition: int | None = None

    def continuing(self) -> None:
        """End the body: the following statements of the block go into `continuing`."""
        self.body = self.builder.pop()
        self.builder.push()

    def until(self, condition: Operand) -> None:
        """Set the value that is tested after `continuing`."""
        self.condition = _id(condition)
