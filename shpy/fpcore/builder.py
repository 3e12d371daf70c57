"""Build the expressions of a program: execute its module with expressions in place of numbers.

Stage: above the passes. A branch executes both of its sides, and what they store is chosen by `if`. After a break,
continue or return that may have been taken, the rest of the region counts only where it was not.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final, Literal

import numpy as np

from shpy.errors import ShpyError, ShpyTypeError
from shpy.fpcore.nodes import Node, Nodes, Scope, State, While, count
from shpy.fpcore.printing import ONCE, PRECISIONS, Printer, laid_out
from shpy.ir.constants import DTYPES, decode
from shpy.ir.formula import Formula
from shpy.ir.nodes import Break, Continue, Discard, If, Let, Loc, Loop, Module, Region, Return, Stmt, Store, Value
from shpy.ir.ops import OPS
from shpy.ir.traverse import walk
from shpy.ir.types import Base, Type
from shpy.passes.modes import Precision

_SAME: Final = frozenset(
    "fma sqrt exp exp2 expm1 log log2 log10 log1p sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh pow "
    "atan2 hypot cbrt erf erfc floor ceil trunc isnan isinf and or not".split()
)
"""Operations that FPCore has under the same name."""
_OTHERS: Final = {
    "neg": "-", "add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<=", "gt": ">", "ge": ">=",
    "eq": "==", "ne": "!=", "abs": "fabs", "min": "fmin", "max": "fmax", "round": "nearbyint",
}  # fmt: skip
_WHOLE: Final = frozenset("neg add sub mul abs min max lt le gt ge eq ne cond sign".split())
"""Operations on ints that have a meaning for whole numbers."""
_RESERVED: Final = frozenset(
    "E LOG2E LOG10E LN2 LN10 PI PI_2 PI_4 M_1_PI M_2_PI M_2_SQRTPI SQRT2 SQRT1_2 INFINITY NAN TRUE FALSE if let let* "
    "while while* for for* tensor tensor* array ref dim size cast digits FPCore fmod remainder fdim copysign round "
    "isfinite isnormal signbit lgamma tgamma".split()
) | {*_SAME, *_OTHERS.values()}
_FORBIDDEN: Final = re.compile(r"[^A-Za-z0-9~!@$%^&*_\-+=<>.?/:]")

Slots = dict[Any, Nodes]
"""The values of variables by their ids; that of "return", and of the breaks and continues of each loop, is a bool."""


class FPCoreBuilder:
    """Executes a module on expressions in place of numbers."""

    def __init__(self, module: Module, precision: Precision) -> None:
        self.module = module
        self.base = {"f16": Base.H, "f32": Base.F, "f64": Base.D}[precision]
        self.scope = Scope()
        self.values: dict[int, Nodes] = {}
        self.types: dict[int, Type] = {}
        self.loc: Loc | None = None
        self.names: set[str] = set(_RESERVED)
        self.arguments: list[str] = []
        self.leaves: dict[str, Nodes] = {}
        self.loads = [s.attr for s in walk(module.entry.body) if isinstance(s, Let) and s.op == "load"]
        self.true, self.false = (self.node(text, base=Base.B) for text in ("TRUE", "FALSE"))

    # Expressions

    def node(self, head: str, *args: Node, base: Base, loop: While | None = None) -> Node:
        """Return a new node of the present scope."""
        return Node(head, args, base, self.scope, loop=loop)

    def number(self, value: Any, base: Base) -> Node:
        """Return a number or bool as it stands in a text."""
        if base is Base.B:
            return self.true if value else self.false
        if base in (Base.I, Base.U):
            return self.node(str(int(value)), base=base)
        rounded = np.asarray(value, DTYPES[base])[()]
        size = abs(rounded)
        text = "NAN" if size != size else "INFINITY" if np.isinf(size) else re.sub(r"\.0$", "", str(size))
        if not np.signbit(rounded) or size != size:
            return self.node(text, base=base)
        if size > 0 and not np.isinf(size):
            return self.node(f"-{text}", base=base)
        return self.node("-", self.node(text, base=base), base=base)

    def choose(self, c: Node, a: Node, b: Node) -> Node:
        """Return the expression of a choice, shorter where bools are constants."""
        if a is b or c is self.true:
            return a
        if c is self.false:
            return b
        if a.base is Base.B:
            if a is self.true or a is c:
                return self.either(c, b)
            if a is self.false:
                return self.both(self.negated(c), b)
            if b is self.false:
                return self.both(c, a)
        return self.node("if", c, a, b, base=a.base)

    def negated(self, c: Node) -> Node:
        """Return whether a bool does not hold."""
        if c is self.true or c is self.false:
            return self.false if c is self.true else self.true
        return c.args[0] if c.head == "not" else self.node("not", c, base=Base.B)

    def both(self, a: Node, b: Node) -> Node:
        """Return whether two bools hold."""
        if a is self.false or b is self.true:
            return a
        return b if a is self.true or b is self.false else self.node("and", a, b, base=Base.B)

    def either(self, a: Node, b: Node) -> Node:
        """Return whether one of two bools holds."""
        if a is self.true or b is self.false:
            return a
        return b if a is self.false or b is self.true else self.node("or", a, b, base=Base.B)

    def refuse(self, what: str, cure: str) -> ShpyError:
        """Return the error of something that FPCore lacks, at the user's line."""
        return ShpyError(f"FPCore has {what}", loc=self.loc, cure=cure)

    def apply(self, op: str, args: Sequence[Nodes], base: Base) -> Nodes:
        """Return the components of an operation of the table."""
        row = OPS[op]
        if row.definition is not None:
            within = Base.F if base is Base.H and op != "mad" else base
            result: Nodes = row.definition(*(_Term(self, a, within) for a in args)).nodes
            return tuple(self.node("cast", n, base=base) for n in result) if within is not base else result
        if op in ("any", "all"):
            whole = args[0][0]
            for other in args[0][1:]:
                whole = (self.either if op == "any" else self.both)(whole, other)
            return (whole,)
        return tuple(self.scalar(op, row, base) for row in zip(*args, strict=True))

    def scalar(self, op: str, args: Nodes, base: Base) -> Node:
        """Return an operation on numbers."""
        of = args[-1].base
        if of is Base.U or (of is Base.I and op not in (*_WHOLE, "ldexp")):
            raise self.refuse(f"no {op} of ints", "floats, of which FPCore computes everything")
        if op == "cond":
            return self.choose(*args)
        if op == "not":
            return self.negated(args[0])
        if op == "sign":
            zero = self.number(0, of)
            signs = [self.number(n, base) for n in (1, -1, 0)]
            above, below = (self.node(sign, args[0], zero, base=Base.B) for sign in "><")
            return self.choose(above, signs[0], self.choose(below, signs[1], signs[2]))
        if of is Base.B and op in ("xor", "ne", "eq"):
            a, b = args
            same = self.choose(a, b, self.negated(b))
            return same if op == "eq" else self.negated(same)
        if op in _SAME or op in _OTHERS or op in ONCE:
            return self.node(_OTHERS.get(op, op), *args, base=base)
        raise self.refuse(f"no {op}", "floats and their operations, without the bits of numbers")

    def convert(self, x: Node, base: Base) -> Node:
        """Return a number in another base: rounded where that may lose bits."""
        if x.base is Base.U or base is Base.U:
            raise self.refuse("no unsigned ints", "ints of type i")
        if base is Base.B:
            return self.node("!=", x, self.number(0, x.base), base=base)
        if x.base is Base.B:
            return self.choose(x, self.number(1, base), self.number(0, base))
        if base is Base.I:
            return self.node("trunc", x, base=base)
        widens = (x.base, base) in ((Base.H, Base.F), (Base.H, Base.D), (Base.F, Base.D))
        return x if widens or x.base is base else self.node("cast", x, base=base)

    # Statements

    def region(self, region: Region, slots: Slots, path: Node) -> None:
        """Execute statements; `path` holds where they are reached."""
        for n, s in enumerate(region):
            self.statement(s, slots, path)
            left = self.left(slots)
            if isinstance(s, If | Loop) and left is not self.false:
                rest = {**slots, **dict.fromkeys(self.exits(), (self.false,))}
                self.region(region[n + 1 :], rest, self.both(path, self.negated(left)))
                self.join(slots, left, dict(slots), rest)
                return

    def exits(self) -> tuple[Any, ...]:
        """Return the keys of the bools that tell which exits were taken."""
        return "return", ("break", self.scope), ("continue", self.scope)

    def left(self, slots: Slots) -> Node:
        """Return whether an exit was taken."""
        whole = self.false
        for key in self.exits():
            whole = self.either(whole, slots.get(key, (self.false,))[0])
        return whole

    def join(self, slots: Slots, c: Node, then: Slots, orelse: Slots) -> None:
        """Set each variable to its value in `then` where c holds, else to that in `orelse`."""
        for key in {**then, **orelse}:
            a, b = (side.get(key, (self.false,)) for side in (then, orelse))
            slots[key] = tuple(self.choose(c, x, y) for x, y in zip(a, b, strict=True))

    def statement(self, s: Stmt, slots: Slots, path: Node) -> None:
        """Execute a statement, and for a branch or loop those inside it."""
        self.loc = s.value.loc if isinstance(s, Let) else s.loc or self.loc
        match s:
            case Let(value):
                self.types[value.id] = value.type
                self.values[value.id] = self.let(s, slots)
            case Store(variable, value, components, None):
                stored = self.values[value]
                if components is None:
                    slots[variable] = tuple(self.called(n, variable, k, len(stored)) for k, n in enumerate(stored))
                else:
                    new = list(slots[variable])
                    for k, n in zip(components, stored, strict=True):
                        new[k] = n
                    slots[variable] = tuple(new)
            case If(condition, then, orelse):
                (c,) = self.values[condition]
                sides = dict(slots), dict(slots)
                self.region(then, sides[0], self.both(path, c))
                self.region(orelse, sides[1], self.both(path, self.negated(c)))
                self.join(slots, c, *sides)
            case Loop():
                self.loop(s, slots, path)
            case Break() | Continue():
                slots["break" if isinstance(s, Break) else "continue", self.scope] = (self.true,)
            case Return():
                slots["return"] = (self.true,)
            case Discard():
                raise self.refuse("no results that are not written", "a program without SH_DISCARD")
            case _:
                raise self.refuse("no arrays that change", "a variable for each element")

    def called(self, n: Node, variable: int, k: int, size: int) -> Node:
        """Return the node with the name of the variable that holds it."""
        name = self.slot_names.get(variable)
        if name and not n.name and not n.is_atom:
            n.name = name if size == 1 else f"{name}.{'xyzw'[k] if size <= 4 else k}"
        return n

    def let(self, s: Let, slots: Slots) -> Nodes:
        """Return the components of the right side of a Let."""
        args = [self.values[a] for a in s.args]
        type = s.value.type
        match s.op:
            case "const":
                assert isinstance(s.attr, tuple)
                return tuple(self.number(v, type.base) for v in decode(type, s.attr))
            case "load" if not args:
                return slots[s.attr]
            case "param":
                return self.argument(str(s.attr), type)
            case "construct":
                return tuple(n for a in args for n in a)
            case "splat":
                return args[0] * type.size
            case "swizzle":
                assert isinstance(s.attr, tuple)
                return tuple(args[0][k] for k in s.attr)
            case "component":
                *others, last = enumerate(args[0])
                chosen = last[1]
                for k, n in reversed(others):
                    least = self.node("<=", args[1][0], self.number(k, Base.I), base=Base.B)
                    chosen = self.choose(least, n, chosen)
                return (chosen,)
            case "convert":
                return tuple(self.convert(n, type.base) for n in args[0])
        if s.op in OPS:
            return self.apply(s.op, args, type.base)
        if s.op == "load":
            raise self.refuse("no arrays that change", "a variable for each element")
        raise self.refuse(f"no {s.op.replace('_', ' ')}", "an input, from which the program gets this value")

    def loop(self, s: Loop, slots: Slots, path: Node) -> None:
        """Execute a loop: its variables become the states of a `while`."""
        inside = list(walk((*s.body, *s.continuing)))
        changed: list[Any] = list(dict.fromkeys(t.variable for t in inside if isinstance(t, Store)))
        if any(isinstance(t, Return) for t in inside):
            changed.append("return")
            slots.setdefault("return", (self.false,))
        outer = self.scope
        loop = While(Scope(), Scope(), path)
        self.scope = loop.scope
        states: Slots = {}
        for key in changed:
            name = self.slot_names.get(key) or ("done" if key == "return" else "state")
            states[key] = tuple(
                Node("", (), n.base, self.scope, name if len(slots[key]) == 1 else f"{name}.{'xyzw'[k]}")
                for k, n in enumerate(slots[key])
            )
        inner = {**slots, **states, "return": (self.false,)}
        header = self.header(s, loop, dict(inner))
        self.region(s.body[: header - 1] + s.body[header:] if header else s.body, inner, self.true)
        inner.pop(("continue", self.scope), None)
        left = self.left(inner)
        after = dict(inner)
        self.region(s.continuing, after, self.negated(left))
        self.join(inner, left, dict(inner), after)
        ends = self.either(left, self.values[s.until][0] if s.until is not None else self.false)
        for key in changed:
            self.define(loop, states[key], slots[key], inner[key])
        if ends is not self.false:
            going = Node("", (), Base.B, self.scope, "going")
            self.define(loop, (going,), (self.true,), (self.negated(ends),))
            self.scope = loop.tests
            loop.condition = self.both(loop.condition, going)
        self.scope = outer
        whole = self.node("while", base=Base.F, loop=loop)
        for key in changed:
            slots[key] = tuple(self.node("last", whole, leaf, base=leaf.base) for leaf in states[key])

    def define(self, loop: While, leaves: Nodes, first: Nodes, update: Nodes) -> None:
        """Add states to a loop."""
        for row in zip(leaves, first, update, strict=True):
            row[0].state = State(*row)
            loop.states.append(row[0].state)

    def header(self, s: Loop, loop: While, slots: Slots) -> int:
        """Return how many statements of the body come up to the test that begins it, 0 for a body without a test.

        The test becomes the condition of the `while`. It reads no variable that the statements before it change.
        """
        for n, t in enumerate(s.body):
            if isinstance(t, If) and not t.orelse and len(t.then) == 1 and isinstance(t.then[0], Break):
                before = s.body[:n]
                own = {b.variable for b in before if isinstance(b, Store)}
                loads = [b.attr for b in before if isinstance(b, Let) and b.op == "load"]
                if any(self.loads.count(v) != loads.count(v) for v in own):
                    return 0
                scope, self.scope = self.scope, loop.tests
                self.region(before, slots, self.true)
                loop.condition = self.both(loop.condition, self.negated(self.values[t.condition][0]))
                self.scope = scope
                return n + 1
            if not isinstance(t, Let | Store):
                return 0
        return 0

    # The text

    def unique(self, name: str) -> str:
        """Return a name that nothing else has, of the letters that FPCore allows."""
        plain = _FORBIDDEN.sub("_", name)
        plain = plain if plain and not plain[0].isdigit() and plain[0] not in "-+." else f"_{plain}"
        whole, n = plain, 2
        while whole in self.names:
            whole, n = f"{plain}_{n}", n + 1
        self.names.add(whole)
        return whole

    def argument(self, name: str, type: Type) -> Nodes:
        """Return the components of an input or Param, which is an argument of the FPCore."""
        if name not in self.leaves:
            if type.is_bool or type.base is Base.U:
                raise self.refuse(f"no arguments of type {type.base.value}", "a float or an int, compared with 0")
            own = self.unique(name)
            sized = f"{own} {type.size}" if type.size > 1 else own
            precision = f"! :precision {PRECISIONS[type.base]} " if type.base is not self.base else ""
            self.arguments.append(f"({precision}{sized})" if precision or type.size > 1 else own)
            leaf = Node(own, (), type.base, self.top)
            places = [(leaf, Node(str(k), (), Base.I, self.top)) for k in range(type.size)]
            parts = tuple(Node("ref", place, type.base, self.top, f"{own}.{place[1].head}") for place in places)
            self.leaves[name] = parts if type.size > 1 else (leaf,)
        return self.leaves[name]

    def text(self, domain: Mapping[str, Any]) -> str:
        """Return the FPCore."""
        entry, self.top = self.module.entry, self.scope
        self.slot_names = {v.id: v.name for v in (*entry.outputs, *entry.variables) if v.name}
        slots: Slots = {
            v.id: tuple(self.number(0, v.type.base) for _ in range(v.type.size))
            for v in (*entry.outputs, *entry.variables)
            if v.length is None
        }
        for port, value in zip(self.module.inputs, entry.inputs, strict=True):
            assert isinstance(value, Value)
            self.loc = value.loc or entry.loc
            self.values[value.id] = self.argument(port.name, value.type)
        self.region(entry.body, slots, self.true)
        ports = list(zip(self.module.outputs, entry.outputs, strict=False))
        parts = [(port, slots[slot.id]) for port, slot in ports]
        results = [n for _, nodes in parts for n in nodes]
        pre = self.preconditions(domain)
        root = results[0] if len(results) == 1 else self.node("array", *results, base=self.base)
        head = [f"(FPCore {self.unique(self.module.name)} ({' '.join(self.arguments)})"]
        head += [f'  :name "{self.module.name}"', f"  :precision {PRECISIONS[self.base]}", "  :round nearestEven"]
        if len(parts) > 1:
            sizes = [(p.name, k, len(nodes)) for p, nodes in parts for k in range(len(nodes))]
            names = ", ".join(name if size == 1 else f"{name}.{'xyzw'[k]}" for name, k, size in sizes)
            head.append(f'  :description "results: {names}"')
        if pre:
            whole = pre[0] if len(pre) == 1 else f"(and {' '.join(pre)})"
            head.append(f"  :pre {whole}")
        count(root, self.top)
        return "\n".join([*head, f"  {laid_out(Printer(self.unique).scope(self.top, root, self.base), 2)})\n"])

    def preconditions(self, domain: Mapping[str, Any]) -> list[str]:
        """Return the tests that arguments lie in their domains, and Params in their ranges."""
        ranges = {
            p.name: p.about.range for p in self.module.params if p.about.range is not None and p.name in self.leaves
        }
        for name, given in domain.items():
            ends = given[:2] if isinstance(given, Sequence) and not isinstance(given, str) else None
            if name not in self.leaves or ends is None or not all(isinstance(v, int | float) for v in ends):
                cure = f'{{"{next(iter(self.leaves), "x")}": (-1, 1)}}, lower ends and upper ends of inputs'
                raise ShpyTypeError(f"{name!r}: {given!r} is no domain of an input", cure=cure)
            ranges[name] = (ends[0], ends[1])
        rows = [(leaf, *ends) for name, ends in ranges.items() for leaf in self.leaves[name]]
        texts = [
            (leaf.head if leaf.is_atom else f"(ref {leaf.args[0].head} {leaf.args[1].head})", *e) for leaf, *e in rows
        ]
        return [f"(<= {low:.17g} {text} {high:.17g})" for text, low, high in texts]


class _Term(Formula):
    """A value of a definition: its components."""

    def __init__(self, builder: FPCoreBuilder, nodes: Nodes, working: Base) -> None:
        self.builder, self.nodes, self.working = builder, nodes, working

    def op(self, name: str, *others: Any) -> _Term:
        """Apply an operation of the table, component by component."""
        terms = [self, *(o if isinstance(o, _Term) else self.constant(o) for o in others)]
        gives = OPS[name].gives
        base = (
            Base.B
            if gives in ("B", "b")
            else terms[-1].nodes[0].base
            if terms[-1].nodes[0].base is Base.I
            else self.working
        )
        return _Term(self.builder, self.builder.apply(name, [t.nodes for t in terms], base), self.working)

    def binary(self, name: str, other: Any) -> _Term:
        """Return the operation; a scalar beside a vector is repeated."""
        other = other if isinstance(other, _Term) else self.constant(other)
        a, b = self.nodes, other.nodes
        size = max(len(a), len(b))
        wide = [_Term(self.builder, n * size if len(n) < size else n, self.working) for n in (a, b)]
        return wide[0].op(name, wide[1])

    def constant(self, number: float) -> _Term:
        """Return a number of this value's type for each component."""
        base = self.nodes[0].base
        base = self.working if base in (Base.B, Base.H) else base
        return _Term(self.builder, (self.builder.number(number, base),) * len(self.nodes), self.working)

    def choose(self, a: Any, b: Any) -> _Term:
        """Return one of two values, component by component."""
        like = next(v for v in (a, b) if isinstance(v, _Term))
        sides = [v if isinstance(v, _Term) else like.constant(v) for v in (a, b)]
        size = max(len(v.nodes) for v in sides)
        wide = [v.nodes * size if len(v.nodes) < size else v.nodes for v in (self, *sides)]
        return _Term(self.builder, self.builder.apply("cond", wide, like.nodes[0].base), self.working)

    def __getitem__(self, key: int | list[int]) -> _Term:
        nodes = (self.nodes[key],) if isinstance(key, int) else tuple(self.nodes[k] for k in key)
        return _Term(self.builder, nodes, self.working)

    @property
    def size(self) -> int:
        """The number of components."""
        return len(self.nodes)

    @property
    def precision(self) -> Literal["f", "d"]:
        """The base of arithmetic."""
        return "d" if self.working is Base.D else "f"
