"""A reader and an evaluator of FPCore 2.0, by its standard: what texts of `Program.fpcore` are compared with.

Numbers are float64 that hold the number of their precision, and ints of Python in precision `integer`. A context of
precision `real` computes with mpmath in 300 bits.
"""

from __future__ import annotations

import re
from typing import Any

import mpmath as mp
import numpy as np
from correctly_rounded.multiprecision import EXACT, nearest

from shpy.ir.ops import OPS

DTYPES = {"binary32": np.float32, "binary64": np.float64, "binary16": np.float16}
NAMES = {
    "fabs": "abs",
    "fmin": "min",
    "fmax": "max",
    "nearbyint": "round",
    "+": "add",
    "-": "sub",
    "*": "mul",
    "/": "div",
}
COMPARISONS = {"<": "lt", "<=": "le", ">": "gt", ">=": "ge", "==": "eq", "!=": "ne"}
CONSTANTS = {"TRUE": True, "FALSE": False, "INFINITY": np.inf, "NAN": np.nan}


def read(text: str) -> Any:
    """Return the nested lists of a text; strings keep their quotes."""
    words = re.findall(r'"[^"]*"|[()\[\]]|[^\s()\[\]]+', re.sub(r";.*", "", text))
    stack: list[list[Any]] = [[]]
    for word in words:
        if word in "([":
            stack.append([])
        elif word in ")]":
            last = stack.pop()
            stack[-1].append(last)
        else:
            stack[-1].append(word)
    assert len(stack) == 1
    (core,) = stack[0]
    assert core[0] == "FPCore"
    return core


def parts(core: Any) -> tuple[list[Any], dict[str, Any], Any]:
    """Return the arguments, the properties and the body."""
    rest = core[1:] if isinstance(core[1], list) else core[2:]
    arguments, *properties, body = rest
    return arguments, dict(zip(properties[::2], properties[1::2], strict=True)), body


def evaluate(core: Any, values: dict[str, Any]) -> Any:
    """Return the value of the body; `values` are those of the arguments."""
    arguments, properties, body = parts(core)
    names = {a if isinstance(a, str) else next(w for n, w in enumerate(a) if _is_name(a, n)) for a in arguments}
    assert names == values.keys()
    return _Evaluation().value(body, values, properties[":precision"])


def _is_name(argument: list[Any], n: int) -> bool:
    return argument[n] != "!" and not argument[n].startswith(":") and not (n and argument[n - 1].startswith(":"))


class _Evaluation:
    def value(self, e: Any, names: dict[str, Any], precision: str) -> Any:
        """Return the value of an expression in a context."""
        if isinstance(e, str):
            if e in names:
                return names[e]
            if e == "PI":
                return mp.pi
            return CONSTANTS[e] if e in CONSTANTS else self.number(e, precision)
        head, *args = e
        match head:
            case "!":
                properties = dict(zip(args[:-1:2], args[1:-1:2], strict=True))
                assert properties.keys() == {":precision"}
                return self.value(args[-1], names, properties[":precision"])
            case "if":
                return self.value(args[1] if self.value(args[0], names, precision) else args[2], names, precision)
            case "let*":
                inner = dict(names)
                for name, bound in args[0]:
                    inner[name] = self.value(bound, inner, precision)
                return self.value(args[1], inner, precision)
            case "while" | "while*":
                return self.loop(head, *args, names, precision)
            case "array":
                return [self.value(a, names, precision) for a in args]
            case "ref":
                return self.value(args[0], names, precision)[int(args[1])]
        return self.operation(head, [self.value(a, names, precision) for a in args], precision)

    def loop(self, head: str, test: Any, bindings: Any, body: Any, names: dict[str, Any], precision: str) -> Any:
        inner = {**names, **{name: self.value(first, names, precision) for name, first, _ in bindings}}
        while self.value(test, inner, precision):
            if head == "while*":
                for name, _, update in bindings:
                    inner[name] = self.value(update, inner, precision)
            else:
                inner |= {name: self.value(update, inner, precision) for name, _, update in bindings}
        return self.value(body, inner, precision)

    def number(self, text: str, precision: str) -> Any:
        if precision == "real":
            return mp.mpf(text)
        return int(text) if precision == "integer" else float(DTYPES[precision](text))

    def operation(self, head: str, args: list[Any], precision: str) -> Any:
        """Return the result of an operation, rounded to the precision."""
        if head in COMPARISONS:
            return bool(OPS[COMPARISONS[head]].function(*map(np.float64, args)))
        if head in ("and", "or", "not"):
            assert all(isinstance(a, bool) for a in args)
            return not args[0] if head == "not" else all(args) if head == "and" else any(args)
        if head in ("isnan", "isinf"):
            return bool(getattr(np, head)(args[0]))
        if precision == "real":
            return self.exactly(head, args)
        name = "neg" if head == "-" and len(args) == 1 else NAMES.get(head, head)
        if precision == "integer":
            return int(OPS[name].function(*map(np.float64, args)))
        dtype = DTYPES[precision]
        if head == "cast":
            return nearest(args[0]) if isinstance(args[0], mp.mpf) else float(dtype(args[0]))
        with np.errstate(all="ignore"):
            return float(OPS[name].meaning(*(np.asarray(a, dtype) for a in args)))

    def exactly(self, head: str, args: list[Any]) -> Any:
        with mp.workprec(300):
            a = [+mp.mpf(v) for v in args]
            match head:
                case "/":
                    return a[0] / a[1]
                case "*":
                    return a[0] * a[1]
                case "pow":
                    return mp.power(*a)
            return EXACT[head](a[0]) if head in EXACT else mp.sqrt(a[0])
