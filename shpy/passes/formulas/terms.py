"""Terms: values with Python's operators, in which the pure functions of `library` and `strict` are written.

Stage: improve. A `Term` is a value of a function under construction; Python's operators append operations to it:

    define("halved1", lambda x: x * 0.5, (vec(Base.F),))      # function halved1(%x.0: f) { %2: f = mul %x.0, %1 ... }
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Literal, Self

from shpy.ir.builder import Builder
from shpy.ir.formula import Formula
from shpy.ir.nodes import Function, Let, Stmt, Value
from shpy.ir.traverse import rewrite
from shpy.ir.types import Base, Type, vec


class DefinitionBuilder(Builder):
    """Builds a definition; `names` are the names of its values. `fused`: `mul_add` rounds once."""

    def __init__(self, name: str = "main", *, fused: bool = False, function: Function | None = None) -> None:
        super().__init__(name, function=function)
        self.pure = function is None
        self.fused = fused
        self.names: dict[int, str] = {}

    def finish(self) -> Function:
        """Return the function, with the names that its terms have."""
        function = super().finish()
        return replace(function, body=rewrite(function.body, self._named))

    def _named(self, s: Stmt) -> Stmt:
        if not isinstance(s, Let) or s.value.id not in self.names:
            return s
        return replace(s, value=replace(s.value, name=self.names[s.value.id]))


class Term(Formula):
    """A value that is written with Python's operators; numbers and scalars broadcast to the other operand's type."""

    def __init__(self, builder: DefinitionBuilder, value: Value) -> None:
        self.builder = builder
        self.value = value

    @property
    def type(self) -> Type:
        """The value's type."""
        return self.value.type

    @property
    def size(self) -> int:
        """The number of components."""
        return self.value.type.size

    @property
    def precision(self) -> Literal["f", "d"]:
        """The base of arithmetic: "d" for binary64, else "f", since an earlier pass has lowered binary16."""
        return "d" if self.type.base is Base.D else "f"

    def _like(self, value: Value) -> Self:
        """Return a value as a term of this class."""
        return self.__class__(self.builder, value)

    def op(self, name: str, *others: Term | float, type: Type | None = None) -> Term:
        """Return the operation `name` applied to this term and the others."""
        terms = [o if isinstance(o, Term) else self.constant(o) for o in others]
        return self._like(self.builder.let(name, self.value, *(t.value for t in terms), type=type))

    def binary(self, name: str, other: Term | float) -> Term:
        """Return the operation on two operands; a scalar beside a vector is splatted."""
        if not isinstance(other, Term):
            return self.op(name, other)
        size = max(self.size, other.size)
        return self.wide(size).op(name, other.wide(size))

    def named(self, name: str) -> Term:
        """Return this term; the emitted text names it so."""
        self.builder.names[self.value.id] = name
        return self

    def constant(self, number: float) -> Term:
        """Return a constant of this term's type."""
        scalar = self._like(self.builder.const(self.type.scalar, [number]))
        return scalar.wide(self.size)

    def wide(self, size: int) -> Self:
        """Return a scalar as a vector of `size` components; a vector as it is."""
        return self._like(self.builder.splat(self.value, size)) if self.size < size else self

    def choose(self, a: Term | float, b: Term | float) -> Term:
        """`where(self, a, b)`."""
        return where(self, a, b)

    def __getitem__(self, key: int | list[int]) -> Term:
        """Return a component; a swizzle of several."""
        if self.size == 1:
            return self
        return self._like(self.builder.swizzle(self.value, (key,) if isinstance(key, int) else key))

    def __lshift__(self, count: int) -> Term:
        return self.binary("shl", count)

    def __rshift__(self, count: int) -> Term:
        return self.binary("shr", count)

    def mul_add(self, factor: Term | float, term: Term | float) -> Term:
        """Return self * factor + term, as a fused operation if the definition is for a device with fast fma."""
        if self.builder.fused:
            return self.op("fma", factor, term)
        return self * factor + term

    def equals(self, other: Term | float) -> Term:
        """Return whether both are the same number."""
        return self.binary("eq", other)

    def differs(self, other: Term | float) -> Term:
        """Return whether both are different numbers."""
        return self.binary("ne", other)

    def based(self, base: Base) -> Term:
        """Return this term converted to a base; itself where it has that base."""
        return self if self.type.base is base else self.op("convert", type=self.type.based(base))


def where(c: Term, a: Term | float, b: Term | float) -> Term:
    """Return a where c holds, else b; c is one bool or a bool per component. At least one of a and b is a Term."""
    model = a if isinstance(a, Term) else b
    assert isinstance(model, Term)
    first, second = (t if isinstance(t, Term) else model.constant(t) for t in (a, b))
    return c.wide(model.type.size).op("cond", first, second)


def joined(*parts: Term) -> Term:
    """Return the vector of these scalars, or the scalar if there is only one."""
    first, *others = parts
    return first.op("construct", *others, type=first.type.sized(len(parts))) if others else first


def replaced(c: Term, values: Mapping[str, Term], make: Callable[[], Iterable[Term]]) -> list[Term]:
    """Return the values, replaced by those of `make` where c holds; these run only if c holds for an active element.

    `values` are keyed by their names in the text. `c`, which is named too, and all values have the same size.
    """
    b = c.builder
    slots = [b.variable(value.type, name=name) for name, value in values.items()]
    for slot, value in zip(slots, values.values(), strict=True):
        b.store(slot, value.value)
    one = c if c.type.size == 1 else c.op("any")
    with b.when(one.op("any_lane", type=vec(Base.B)).value):
        for slot, value, replacement in zip(slots, values.values(), make(), strict=True):
            b.store(slot, where(c, replacement, value).value)
    return [Term(b, b.load(slot)) for slot in slots]


def define(name: str, meaning: Callable[..., Term], types: tuple[Type, ...], *, fused: bool = False) -> Function:
    """Return the pure function that computes `meaning` for inputs of these types, named as the parameters of `meaning`.

    `fused`: `Term.mul_add` rounds once.
    """
    builder = DefinitionBuilder(name, fused=fused)
    names = inspect.signature(meaning).parameters
    terms = [Term(builder, builder.input(t, n)) for n, t in zip(names, types, strict=True)]
    result = meaning(*terms)
    builder.store(builder.output(result.type, "result"), result.value)
    return builder.finish()
