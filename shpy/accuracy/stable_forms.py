"""Stable forms: sums of a program that may cancel, written so that they do not.

Stage: measure; for `rounding_lines`. Takes a module; yields modules in which another form replaces one statement. The
two are equal in real numbers; which of them loses fewer digits depends on the inputs, so the caller measures both.

    cos(x) - 1, exp(x) - 1, log(1 + x)       -> -2 * sin(x / 2) ** 2, expm1(x), log1p(x)
    sqrt(x + 1) - sqrt(x), sqrt(b*b - c) - b -> 1 / (sqrt(x + 1) + sqrt(x)), -c / (sqrt(b*b - c) + b)
    x * x - y * y, 1 / (x + 1) - 1 / x       -> (x - y) * (x + y), -1 / ((x + 1) * x)
    log(a) - log(b), sin(a) - sin(b)         -> log1p((a - b) / b), 2 * cos((a + b) / 2) * sin((a - b) / 2)
    dot(v, v) - 4 * m * m, m the mean of v   -> dot(v - m, v - m)
    Heron's area by s = (a + b + c) / 2      -> Kahan's (Miscalculating Area and Angles of a Needle-like Triangle, 2014)

Most of them are problems of Hamming's (Numerical Methods for Scientists and Engineers, 1987, chapter 3).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from math import isfinite
from operator import mul

from shpy.ir.constants import decode
from shpy.ir.nodes import Function, Let, Loc, Module, Stmt, Value
from shpy.ir.ops import OPS
from shpy.ir.traverse import defined, rewrite, variables_of, walk
from shpy.passes.formulas.terms import DefinitionBuilder, Term

Signed = tuple[int, int]
"""A term of a sum: 1 or -1, and the id of a value."""

_SYMBOLS = {"add": ("+", 1), "sub": ("-", 1), "mul": ("*", 2), "div": ("/", 2)}
"""The symbols of operations, and how tightly they bind."""
_CALL = 4
_DEPTH = 8
"""The most operations within operations that are read as one sum or product, or written as one text."""


@dataclass(frozen=True)
class StableForm:
    """A form for an expression at `loc`: the texts of both, and the module with the form."""

    loc: Loc | None
    old: str
    new: str
    module: Module = field(repr=False)


def stable_forms(module: Module) -> Iterator[StableForm]:
    """Yield a form for each statement that is in the table; the module has to be optimised."""
    for k, function in enumerate(module.functions):
        lets = {s.value.id: s for s in walk(function.body) if isinstance(s, Let)}
        names = {v.id: v.name for v in (*defined(function), *function.inputs)}
        for s in lets.values():
            if not s.value.type.is_float or s.op not in ("add", "sub", "log", "sqrt"):
                continue
            site = _Site(function, s, lets, names)
            for form in site.forms():
                old, new = site.spelled(s, 0, _DEPTH), site.written(form.value.id, 0)
                if old is not None and new is not None:
                    functions = (*module.functions[:k], site.replaced(), *module.functions[k + 1 :])
                    yield StableForm(s.value.loc, old, new, replace(module, functions=functions))


class _Site:
    """A statement, the values that it is computed from, and the statements of a form under construction."""

    def __init__(self, function: Function, let: Let, lets: Mapping[int, Let], names: Mapping[int, str | None]) -> None:
        self.function = function
        self.let = let
        self.lets = lets
        self.names = names
        self.statements: Sequence[Stmt] = ()

    @cached_property
    def b(self) -> DefinitionBuilder:
        """The builder of the forms; most statements have none."""
        b = DefinitionBuilder(function=self.function)
        b.loc = self.let.value.loc
        self.statements = b.region
        return b

    def replaced(self) -> Function:
        """Return the function with the latest form in place of the statement."""
        *before, last = self.b.region
        assert isinstance(last, Let)
        new = (*before, replace(last, value=self.let.value))
        return replace(self.function, body=rewrite(self.function.body, lambda s: new if s is self.let else s))

    # Values

    def term(self, value: int) -> Term:
        """Return a value as a term of the form."""
        return Term(self.b, Value(value, self.b.type_of(value)))

    def of(self, value: int, *ops: str) -> tuple[int, ...]:
        """Return the operands of a value that one of these operations computes, else ()."""
        let = self.lets.get(value)
        return let.args if let is not None and let.op in ops else ()

    def number(self, value: int) -> float | None:
        """Return the number that a value is in all components."""
        let = self.let_of(value)
        if let is not None and let.op == "splat":
            return self.number(let.args[0])
        if let is None or let.op != "const" or not isinstance(let.attr, tuple):
            return None
        numbers = set(decode(let.value.type, let.attr))
        return float(numbers.pop()) if len(numbers) == 1 else None

    def let_of(self, value: int) -> Let | None:
        """Return the statement that computes a value, of the function or of the forms."""
        return self.lets.get(value) or next(
            (s for s in self.statements if isinstance(s, Let) and s.value.id == value), None
        )

    def sum(self, value: int, sign: int = 1, depth: int = _DEPTH) -> list[Signed]:
        """Return the terms of a sum."""
        let = self.lets.get(value)
        if let is None or let.op not in ("add", "sub", "neg") or depth == 0:
            return [(sign, value)]
        signs = (-sign,) if let.op == "neg" else (sign, -sign if let.op == "sub" else sign)
        return [term for a, s in zip(let.args, signs, strict=True) for term in self.sum(a, s, depth - 1)]

    def factors(self, value: int, depth: int = _DEPTH) -> list[int]:
        """Return the factors of a product."""
        args = self.of(value, "mul") if depth else ()
        return [f for a in args for f in self.factors(a, depth - 1)] if args else [value]

    def root(self, value: int) -> Term | None:
        """Return the square root of a square, or of a positive number."""
        number, args = self.number(value), self.of(value, "mul")
        if number is not None and number > 0:
            return self.term(value).constant(number**0.5)
        return self.term(args[0]) if args and args[0] == args[1] else None

    def total(self, terms: Sequence[Signed]) -> Term:
        """Return the sum of terms, those to be added first."""
        (sign, first), *others = sorted(terms, key=lambda term: -term[0])
        start = signed(sign, self.term(first))
        return reduce(
            lambda sum_, term: sum_ + self.term(term[1]) if term[0] > 0 else sum_ - self.term(term[1]), others, start
        )

    def difference(self, a: int, b: int) -> Term:
        """Return a - b, without the terms that both have."""
        terms = self.sum(a)
        for sign, value in self.sum(b, -1):
            number = self.number(value)
            common = [(s, v) for s, v in terms if s != sign and (v == value or self.number(v) == number is not None)]
            if common:
                terms.remove(common[0])
            else:
                terms.append((sign, value))
        if not terms or len(terms) == len(self.sum(a) + self.sum(b)):
            return self.term(a) - self.term(b)
        return self.total(terms)

    # Forms

    def forms(self) -> Iterator[Term]:
        """Yield the forms of the statement."""
        args = self.let.args
        if self.let.op == "sqrt":
            yield from self._heron(self.factors(args[0]))
        elif self.let.op == "log":
            terms = self.sum(args[0])
            for (s, one), (t, x) in (terms, terms[::-1]) if len(terms) == 2 else ():
                if s == 1 and self.number(one) == 1:
                    yield signed(t, self.term(x)).op("log1p")
        else:
            first = self._signed(args[0], 1)
            second = self._signed(args[1], 1 if self.let.op == "add" else -1)
            for pair in ((first, second), (second, first)):
                yield from self._less_one(*pair)
                yield from self._conjugate(*pair)
                if pair[0][0] > pair[1][0]:
                    yield from self._difference(pair[0][1], pair[1][1])

    def _signed(self, value: int, sign: int) -> Signed:
        inner = self.of(value, "neg")
        return (-sign, inner[0]) if inner else (sign, value)

    def _less_one(self, one: Signed, two: Signed) -> Iterator[Term]:
        """Yield forms of f(x) - 1 and 1 - f(x)."""
        (s, p), (t, q) = one, two
        number = self.number(q)
        if number is None or t * number != -s:
            return
        for x in self.of(p, "cos"):
            half = (self.term(x) / 2).op("sin")
            yield self.term(x).constant(-2 * s) * (half * half)
        for x in self.of(p, "exp"):
            yield signed(s, self.term(x).op("expm1"))

    def _conjugate(self, one: Signed, two: Signed) -> Iterator[Term]:
        """Yield sqrt(p * p + r) + t * p, where p may be a number, as r / (sqrt(p * p + r) - t * p)."""
        (s, root), (t, p) = one, two
        for under in self.of(root, "sqrt"):
            terms = self.sum(under)
            for k, (sign, square) in enumerate(terms):
                number = self.number(p)
                same = self.of(square, "mul") == (p, p) if number is None else self.number(square) == number * number
                if sign > 0 and same and len(terms) > 1:
                    rest = terms[:k] + terms[k + 1 :]
                    down = all(r < 0 for r, _ in rest)
                    above = self.total([(-r, v) for r, v in rest] if down else rest)
                    x, y = self.term(root), self.term(p)
                    below = x + y if s != t else x - y
                    yield signed(-s if down else s, above) / below

    def _difference(self, p: int, q: int) -> Iterator[Term]:
        """Yield forms of p - q."""
        a, b = self.root(p), self.root(q)
        if a is not None and b is not None:
            yield self.difference(a.value.id, b.value.id) * (a + b)
        op = self.lets[p].op if p in self.lets else ""
        match op, self.of(p, op), self.of(q, op):
            case "sqrt", (x,), (y,):
                yield self.difference(x, y) / (self.term(p) + self.term(q))
            case "log", (x,), (y,):
                yield (self.difference(x, y) / self.term(y)).op("log1p")
            case "sin" | "cos", (x,), (y,):
                apart, middle = self.difference(x, y) / 2, (self.term(x) + self.term(y)) / 2
                factor = apart.constant(2) * middle.op("cos") if op == "sin" else apart.constant(-2) * middle.op("sin")
                yield factor * apart.op("sin")
            case "div", (n, x), (m, y) if n == m or self.number(n) == self.number(m) is not None:
                above = self.difference(y, x)
                yield (above if self.number(n) == 1 else self.term(n) * above) / (self.term(x) * self.term(y))
            case "tan", (x,), () if self.of(q, "sin") == (x,):
                half = (self.term(x) / 2).op("sin")
                yield self.term(p).constant(2) * self.term(p) * (half * half)
        yield from self._variance(p, q)

    def _variance(self, p: int, q: int) -> Iterator[Term]:
        """Yield dot(v, v) - q, where q has a factor m * m, as the sum of the squares of v - m."""
        squares, *scale = self.of(p, "div") or (p,)
        vector = self.of(squares, "dot")
        if not vector or vector[0] != vector[1]:
            return
        v = self.term(vector[0])
        means = [m for m, times in Counter(self.factors(q)).items() if times == 2 and self.b.type_of(m).size == 1]
        for m in means[:1]:
            away = v - self.term(m).wide(v.size)
            yield away.op("dot", away) / self.term(scale[0]) if scale else away.op("dot", away)

    def _heron(self, factors: Sequence[int]) -> Iterator[Term]:
        """Yield the area of a triangle, with each of its sides as the longest."""
        for s in factors if len(factors) == 4 else ():
            sides = [self.of(f, "sub")[1] for f in factors if self.of(f, "sub")[:1] == (s,)]
            whole, half = self.of(s, "div", "mul") or (s, s)
            if (
                len(sides) == 3
                and sorted(v for _, v in self.sum(whole)) == sorted(sides)
                and self.number(half) in (2, 0.5)
            ):
                for k in range(3):
                    a, b, c = (self.term(v) for v in sides[k:] + sides[:k])
                    product = reduce(mul, (a + (b + c), c - (a - b), c + (a - b), a + (b - c)))
                    yield product.op("sqrt") / 4

    # Text

    def written(self, value: int, level: int, depth: int = _DEPTH) -> str | None:
        """Return a value as Python text, in brackets if it binds less tightly than `level`; None for a long text."""
        if self.names.get(value):
            return self.names[value]
        let = self.let_of(value)
        return None if let is None or depth == 0 else self.spelled(let, level, depth)

    def spelled(self, let: Let, level: int, depth: int) -> str | None:
        """Return the text of a statement's right side."""
        number = self.number(let.value.id)
        if number is not None and not isfinite(number):
            return None
        if let.op == "load" and not let.args:
            return next((v.name for v in variables_of(self.function) if v.id == let.attr), None)
        inner = [self.written(a, n, depth - 1) for a, n in zip(let.args, _levels(let), strict=True)]
        if None in inner:
            return None
        own = _CALL
        match let.op:
            case _ if number is not None:
                text, own = f"{number:.9g}", _CALL if number >= 0 else 2
            case "param":
                text = str(let.attr)
            case "splat":
                return self.written(let.args[0], level, depth - 1)
            case "swizzle" if isinstance(let.attr, tuple):
                text = f"{inner[0]}.{''.join('xyzw'[k] for k in let.attr)}"
            case "neg":
                text, own = f"-{inner[0]}", 2
            case "mul" if let.args[0] == let.args[1]:
                text, own = f"{self.written(let.args[0], _CALL, depth - 1)} ** 2", 3
            case op if op in _SYMBOLS:
                text, own = f"{inner[0]} {_SYMBOLS[op][0]} {inner[1]}", _SYMBOLS[op][1]
            case op if op in OPS and OPS[op].symbol is None:
                text = f"sh.{op}({', '.join(map(str, inner))})"
            case _:
                return None
        return f"({text})" if own < level else text


def signed(sign: int, term: Term) -> Term:
    """Return a term or its negative."""
    return term if sign > 0 else -term


def _levels(let: Let) -> tuple[int, ...]:
    """Return how tightly the operands of an operation have to bind."""
    if let.op in _SYMBOLS:
        own = _SYMBOLS[let.op][1]
        return own, own + 1
    return (2 if let.op == "neg" else _CALL if let.op == "swizzle" else 0,) * len(let.args)
