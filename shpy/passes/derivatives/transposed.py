"""Run statements that are linear in some values backwards: from the cotangent of their result to those of the values.

Stage: improve; for `reverse`. The rule of an operation is linear in the tangents of its operands. So reverse mode emits
it with placeholders for these, and transposes the statements that depend on a placeholder:

    %3 = cos %x                        %3 = cos %x
    %4 = mul %dx, %3         ->        %bar_x = mul %bar_4, %3

The operations that rules apply to tangents are few, and have their transposes here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from shpy.ir.nodes import Let, Stmt
from shpy.passes.derivatives.linear import Live, Tangent, TangentBuilder, Zero, dense, joined


class Transposition:
    """The transpose of statements; `bars` has the cotangents of the placeholders after `run`."""

    def __init__(self, b: TangentBuilder, placeholders: set[int]) -> None:
        self.b = b
        self.placeholders = placeholders
        self.bars: dict[int, Tangent] = {}

    def run(self, statements: Sequence[Stmt], results: Mapping[int, Tangent]) -> None:
        """Append the statements that depend on no placeholder as they are, then the others backwards.

        `results` are the cotangents of the results.
        """
        linear = set(self.placeholders)
        moving: list[Let] = []
        for s in statements:
            if isinstance(s, Let) and any(a in linear for a in s.args):
                linear.add(s.value.id)
                moving.append(s)
            else:
                self.b.append(s)
        self.bars.update(results)
        for let in reversed(moving):
            own = self.bars.pop(let.value.id, None)
            if own is not None and not isinstance(own, Zero):
                self._let(let, own, linear)

    def _add(self, value: int, bar: Tangent) -> None:
        if not isinstance(bar, Zero):
            before = self.bars.get(value)
            self.bars[value] = bar if before is None else before + bar

    def _let(self, let: Let, bar: Any, linear: set[int]) -> None:
        """Add to the cotangents of the operands of one statement."""
        b, args = self.b, let.args
        first = args[0] in linear
        moving = args[0 if first else -1]
        other = b.live(args[-1 if first else 0])  # of two operands, the one that is no tangent
        match let.op:
            case "neg":
                self._add(args[0], -bar)
            case "add" | "sub":
                if first:
                    self._add(args[0], bar)
                if args[1] in linear:
                    self._add(args[1], bar if let.op == "add" else -bar)
            case "mul":
                self._add(moving, bar * other)
            case "div":
                self._add(args[0], bar / other)
            case "cond":
                c = b.live(args[0])
                for a, chosen in ((args[1], (bar, Zero(b, bar.type))), (args[2], (Zero(b, bar.type), bar))):
                    if a in linear:
                        self._add(a, c.choose(*chosen))
            case "dot":
                self._add(moving, bar.wide(other.size) * other)
            case "cross":
                whole: Live = dense(bar)
                self._add(moving, other.op("cross", whole) if first else whole.op("cross", other))
            case "ldexp":
                self._add(args[0], dense(bar).op("ldexp", other))
            case _:
                spread(b, let, bar, self._add)


def spread(b: TangentBuilder, let: Let, bar: Any, add: Callable[[int, Tangent], None]) -> None:
    """Add the cotangent of a structural operation to those of its operands, by `add`."""
    first = let.args[0]
    size = b.type_of(first).size
    match let.op:
        case "splat":
            total = bar[0]
            for k in range(1, bar.size):
                total = total + bar[k]
            add(first, total)
        case "swizzle":
            parts: list[Any] = [Zero(b, bar.type.scalar)] * size
            assert isinstance(let.attr, tuple)
            for k, picked in enumerate(let.attr):
                parts[picked] = parts[picked] + bar[k]
            add(first, joined(parts))
        case "construct":
            at = 0
            for a in let.args:
                count = b.type_of(a).size
                add(a, bar[list(range(at, at + count))] if count > 1 else bar[at])
                at += count
        case "component":
            index = b.live(let.args[1]).op("clamp", 0, size - 1)
            add(first, joined([index.equals(k).choose(bar, Zero(b, bar.type)) for k in range(size)]))
        case "convert":
            add(first, bar.based(b.type_of(first).base))
        case _:
            raise AssertionError(f"no transpose of {let.op}")
