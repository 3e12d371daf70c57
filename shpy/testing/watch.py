"""A program that watches itself: every statement that computes or stores becomes an event that can be asked for.

Stage: test. Takes a recorded module, gives one with one more input, `target`, and more outputs. Events are counted as
they happen; `trail` is a hash of every event up to `target`, so that two backends that agree on it have gone the same
way so far, and a search by halves finds the first event at which they part. Nothing of the control flow changes:

    %t.3: f = mul %a.1, %b.2          %t.3: f = mul %a.1, %b.2
                               ->     $trail = cond($count <= target, hash($trail, site, bits of %t.3), $trail)
                                      $site  = cond($count == target, site, $site)
                                      $count = $count + 1

For the sites that are `looked` at, the value, the operands and the iterations of the loops around them are outputs as
well. On request, `nan` and `infinite` count the events up to the first that gives NaN, or infinity, where no operand is
NaN, or not finite.
"""

from __future__ import annotations

import functools
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

from shpy.ir.builder import Builder
from shpy.ir.nodes import Call, Function, If, Let, Loc, Loop, Module, Port, Region, Stmt, Store, Value, Variable
from shpy.ir.text import components_text
from shpy.ir.traverse import defined, walk
from shpy.ir.types import WIDEST_PORT, Base, Type, vec
from shpy.passes.exits import make_exits_explicit

OPERANDS = 4
"""The limit of operands that an event keeps."""

_SILENT = frozenset({"const", "param", "lane_mask", "table_size"})
"""Operations that are no events: errors there show where they are used."""

_U, _F, _D = vec(Base.U), vec(Base.F), vec(Base.D)
_FAMILY = {Base.F: Base.F, Base.H: Base.F, Base.D: Base.D, Base.I: Base.U, Base.U: Base.U, Base.B: Base.U}
"""The base in which values of a base are kept, exactly."""

_LOOPS = 4
"""The limit of enclosing loops whose iterations an event keeps, from the innermost outwards."""


@dataclass(frozen=True, slots=True)
class Site:
    """A watched statement: its name, its text, and the types of its value and its operands."""

    number: int
    loc: Loc | None
    name: str | None
    text: str
    type: Type
    operands: tuple[tuple[str, int, Type], ...] = ()
    """The name (or the number, `%7`), id and type of each operand."""
    loops: tuple[Loc | None, ...] = ()
    """The lines of the loops around it in its function, the innermost first."""


@dataclass(frozen=True, slots=True)
class WatchedModule:
    """A module that also outputs the values of its statements; `outputs` has the name and type of each, in order."""

    module: Module
    sites: tuple[Site, ...]
    outputs: tuple[tuple[str, Type], ...]


def watch(
    module: Module,
    loop_limit: int | None,
    looked: Collection[int] = (),
    *,
    wide: bool = False,
    finiteness: bool = False,
) -> WatchedModule:
    """Watch every statement of the module; those of the sites in `looked` in full. `wide`: f is binary64.

    With `finiteness`, the outputs `nan` and `infinite` are numbers of events, from 1; 0 for no such event.

    Discards and loops that run out of iterations become plain exits, so that the outputs seen until then are written:
    the module is to be compiled without a limit of its own.
    """
    plan = _WatchPlan(module, frozenset(looked), wide, finiteness)
    functions = tuple(f if f.pure else _Watcher(f, plan).run() for f in module.functions)
    outputs = [(name, type) for name, type in plan.slots.items()]
    watched = replace(
        module,
        inputs=(*module.inputs, Port("target", "Attrib1u")),
        outputs=(*module.outputs, *(Port(name, _kind(type)) for name, type in outputs)),
        functions=functions,
    )
    ending = make_exits_explicit(watched, loop_limit)
    watched = ending.module
    if ending.status:
        outputs.append(("status", vec(Base.I)))
        watched = replace(watched, outputs=(*watched.outputs, Port("status", "Attrib1i")))
    return WatchedModule(watched, tuple(plan.sites), tuple(outputs))


def _kind(type: Type) -> str:
    return f"Attrib{type.size}{type.base.value}"


@dataclass
class _WatchPlan:
    """The state that all functions share: the sites so far, and the slots that they pass on."""

    module: Module
    looked: frozenset[int]
    wide: bool
    finiteness: bool
    sites: list[Site] = field(default_factory=list)
    slots: dict[str, Type] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.slots = {"count": _U, "trail": _U, "site": _U}
        if self.finiteness:
            self.slots |= {"nan": _U, "infinite": _U}
        if self.looked:
            self.slots["iterations"] = vec(Base.U, _LOOPS)
            bases = sorted({_FAMILY[v.type.base] for f in self.module.functions for v in defined(f)})
            places = ["value", *(f"operand{n}" for n in range(OPERANDS))]
            self.slots |= {f"{place}_{base.value}": vec(base, 4) for place in places for base in bases}


class _Watcher:
    """Copies one function, with what watches it."""

    def __init__(self, function: Function, plan: _WatchPlan) -> None:
        self.function = function
        self.plan = plan
        self.b = Builder(function=function)
        self.values = {v.id: v for v in defined(function)}
        self.stored_as = _stored_names(function)
        self.loops: list[tuple[Variable, Loc | None]] = []

    def run(self) -> Function:
        b = self.b
        if self.function is self.plan.module.entry:
            self.slots = {name: b.output(type, name) for name, type in self.plan.slots.items()}
        else:
            self.slots = {name: b.reference(type, name) for name, type in self.plan.slots.items()}
        self.target = b.input(_U, "target")
        self.one, self.shift, self.factor = (b.const(_U, [n]) for n in (1, 15, 0x9E3779B1))
        self.region(self.function.body)
        return b.finish()

    def region(self, region: Region) -> None:
        for statement in region:
            self.statement(statement)

    def nested(self, region: Region) -> Region:
        self.b.push()
        self.region(region)
        return self.b.pop()

    def statement(self, s: Stmt) -> None:
        match s:
            case Let():
                self.b.append(s)
                if s.op not in _SILENT:
                    self.event(self.site_of(s), s.value, None if s.op == "load" else s.args)
            case Store():
                self.b.append(s)
                self.event(*self.after_store(s))
            case Call(name, args, results):
                handed = (*(slot.id for slot in self.slots.values()), self.target.id)
                self.b.append(replace(s, args=args + handed))
                for result in results:
                    self.event(self.site(s.loc, result.name, f"call {name}", result.type), result, args)
            case If(_, then, orelse):
                then = self.nested(then)
                self.b.append(replace(s, then=then, orelse=self.nested(orelse)))
            case Loop():
                self.loop(s)
            case _:
                self.b.append(s)

    def loop(self, s: Loop) -> None:
        b = self.b
        iteration = b.variable(_U, name="iteration")
        b.store(iteration, b.const(_U, [0]))
        self.loops.insert(0, (iteration, s.loc))
        b.push()
        b.store(iteration, b.let("add", b.load(iteration), self.one))
        self.region(s.body)
        body = b.pop()
        continuing = self.nested(s.continuing)
        b.append(replace(s, body=body, continuing=continuing))
        self.loops.pop(0)

    # Events

    def site_of(self, s: Let) -> Site:
        name = s.value.name or self.stored_as.get(s.value.id)
        operands = tuple((self.called(a), a, self.values[a].type) for a in s.args)
        operation = s.op
        if s.op == "load" and isinstance(s.attr, int):
            operation, name = f"load {self.b.slot(s.attr).name or f'${s.attr}'}", name or self.b.slot(s.attr).name
        elif isinstance(s.attr, str):
            operation = f"{s.op} {s.attr}"
        elif s.op == "swizzle" and isinstance(s.attr, tuple):
            operation = f".{components_text(s.attr)}"
        listed = f"({', '.join(o[0] for o in operands)})" if operands else ""
        return self.site(s.value.loc, name, operation + listed, s.value.type, operands)

    def called(self, value: int) -> str:
        name = self.values[value].name or self.stored_as.get(value)
        return name if name is not None else f"%{value}"

    def site(
        self, loc: Loc | None, name: str | None, text: str, type: Type, operands: tuple[tuple[str, int, Type], ...] = ()
    ) -> Site:
        around = tuple(loop for _, loop in self.loops)
        site = Site(len(self.plan.sites) + 1, loc, name, text, type, operands[:OPERANDS], around)
        self.plan.sites.append(site)
        return site

    def after_store(self, s: Store) -> tuple[Site, Value]:
        """Return the site and the value of the variable after a store."""
        slot = self.b.slot(s.variable)
        place = slot.name or f"${slot.id}"
        if s.components is not None:
            place += f".{components_text(s.components)}"
        elif s.index is not None:
            place += f"[{self.called(s.index)}]"
        value = self.b.load(slot, s.index, loc=s.loc)
        operands = ((self.called(s.value), s.value, self.values[s.value].type),)
        return self.site(s.loc, slot.name, f"store {place}", slot.type, operands), value

    def event(self, site: Site, value: Value, args: tuple[int, ...] | None = None) -> None:
        """Count an event; `args` are the operands of one that computes its value."""
        b = self.b
        b.loc = site.loc
        count, target = b.load(self.slots["count"]), self.target
        trail = old = b.load(self.slots["trail"])
        number = b.const(_U, [site.number])
        for word in (*self.words(value), number):
            mixed = b.let("mul", b.let("xor", trail, word), self.factor)
            name = f"@{site.number}" if word is number else None  # the interpreter's trace finds it by name
            trail = b.let("xor", mixed, b.let("shr", mixed, self.shift), name=name)
        within = b.let("le", count, target)
        b.store(self.slots["trail"], b.let("cond", within, trail, old))
        hit = b.let("eq", count, target)
        self.store_where(hit, "site", number)
        if site.number in self.plan.looked:
            self.look(hit, site, value)
        after = b.let("add", count, self.one)
        b.store(self.slots["count"], after)
        if self.plan.finiteness and args is not None and value.type.is_float:
            operands = [v for a in args if (v := self.values.get(a)) and v.type.is_float]  # no references
            for slot, op in (("nan", "isnan"), ("infinite", "isinf")):
                self.store_where(self.begins(op, slot, value, operands), slot, after)
        b.loc = None

    def begins(self, op: str, slot: str, value: Value, operands: list[Value]) -> Value:
        """Return whether a value is the first of its element that is NaN (or infinite), and comes of others."""
        b = self.b
        first = b.let("and", self.any(op, value), b.let("eq", b.load(self.slots[slot]), b.const(_U, [0])))
        for operand in operands:
            odd = self.any("isnan", operand)
            if op == "isinf":
                odd = b.let("or", odd, self.any("isinf", operand))
            first = b.let("and", first, b.let("not", odd))
        return first

    def any(self, op: str, value: Value) -> Value:
        """Return whether a test holds for a component."""
        parts = [self.b.let(op, part) for part in self.parts(value)]
        return functools.reduce(lambda one, two: self.b.let("or", one, two), parts)

    def words(self, value: Value) -> list[Value]:
        """Return the bits of each component, as u; above binary32, those of the rounded value and of the rest."""
        b, base = self.b, value.type.base
        words = [self.bits(value)]
        if base in (Base.F, Base.D):
            high = b.let("float_from_bits", words[0])
            if base is Base.D:
                high = b.let("convert", high, type=value.type)
            rest = b.let("sub", value, high)
            if base is Base.D or self.plan.wide:
                words.append(self.bits(rest))
        return [part for whole in words for part in self.parts(whole)]

    def bits(self, value: Value) -> Value:
        type = value.type
        if type.is_float:
            return self.b.let("bits_from_float", value)
        return value if type.base is Base.U else self.b.let("convert", value, type=type.based(Base.U))

    def parts(self, value: Value) -> list[Value]:
        if value.type.size == 1:
            return [value]
        return [self.b.swizzle(value, [c]) for c in range(value.type.size)]

    def store_where(self, hit: Value, slot: str, value: Value) -> None:
        """Store into a slot where the event is the one that is asked for."""
        b, variable = self.b, self.slots[slot]
        where = b.splat(hit, variable.type.size)
        b.store(variable, b.let("cond", where, value, b.load(variable)))

    def look(self, hit: Value, site: Site, value: Value) -> None:
        """Keep the value, the operands and the iterations."""
        b = self.b
        self.keep_padded(hit, "value", value)
        for n, (_, id, _) in enumerate(site.operands):
            self.keep_padded(hit, f"operand{n}", self.values[id])
        if self.loops:
            iterations = [b.load(iteration) for iteration, _ in self.loops[:_LOOPS]]
            self.store_where(hit, "iterations", self.padded(iterations, _U))

    def keep_padded(self, hit: Value, place: str, value: Value) -> None:
        base = _FAMILY[value.type.base]
        exact = value = value if value.type.size <= WIDEST_PORT else self.b.swizzle(value, range(WIDEST_PORT))
        if value.type.base is not base:
            exact = self.b.let("convert", value, type=value.type.based(base))
        self.store_where(hit, f"{place}_{base.value}", self.padded([exact], vec(base)))

    def padded(self, parts: list[Value], scalar: Type) -> Value:
        """Return a vector of four of these parts and zeros."""
        room = 4 - sum(p.type.size for p in parts)
        if not room and len(parts) == 1:
            return parts[0]
        zeros = [self.b.const(scalar, [0])] * room
        return self.b.let("construct", *parts, *zeros, type=scalar.sized(4))


def _stored_names(function: Function) -> Mapping[int, str]:
    """Return for each value the name of the variable that it is stored into first: a name that the user knows."""
    slots = {
        v.id: v.name for v in (*function.inputs, *function.outputs, *function.variables) if isinstance(v, Variable)
    }
    names: dict[int, str] = {}
    for s in walk(function.body):
        if isinstance(s, Store) and s.components is None and slots[s.variable]:
            names.setdefault(s.value, slots[s.variable] or "")
    return names
