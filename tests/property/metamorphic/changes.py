"""The changes: each takes a function apart somewhere, at random, and leaves every result as it was.

Stage: test. A change gives the function, or None where it finds no place for itself.
"""

from __future__ import annotations

from collections.abc import Callable

from property.metamorphic.surgery import Place, Surgeon, leaves_a_loop

from shpy.ir.builder import Builder
from shpy.ir.nodes import EXITS, Break, Function, If, Let, Loop, Region, Stmt, Store, Value
from shpy.ir.ops import LANE_OPS, OPS
from shpy.ir.traverse import uses, walk
from shpy.ir.types import Base, Type, vec

Change = Callable[[Surgeon], Function | None]

_B, _I = vec(Base.B), vec(Base.I)


def dead_code(surgeon: Surgeon) -> Function | None:
    """Insert computations, a branch and a loop whose results nobody reads."""
    place = surgeon.place(0)
    if place is None:
        return None
    b, rng = surgeon.b, surgeon.rng
    seen = [v for v in place.seen if v.type.base in (Base.F, Base.I, Base.U)]
    value = rng.choice(seen) if seen else None
    b.push()
    if value is None:
        value = b.const(_I, [3])
    slot = b.variable(value.type)
    changed = b.let(
        rng.choice(("add", "mul", "sub", "max")),
        value,
        rng.choice([v for v in seen if v.type is value.type] or [value]),
    )
    kind = rng.randrange(3)
    if kind == 0:
        b.store(slot, changed)
    elif kind == 1:
        with b.when(truth(b, value)):
            b.store(slot, changed)
    else:
        with b.loop(turns=2) as loop:
            held = b.load(slot)
            b.store(slot, b.let("add", held, changed))
            loop.until(b.let("eq", b.const(_I, [1]), b.const(_I, [1])))
    return surgeon.replaced(place, b.pop())


def one_iteration(surgeon: Surgeon) -> Function | None:
    """Put statements into a loop of one iteration."""
    place = surgeon.place(6, lambda statements: not leaves_a_loop(statements))
    if place is None:
        return None
    b = surgeon.b
    inside, loads, renamed = surgeon.carried(place.statements)
    b.push()
    until: int | None = None
    if not isinstance(inside[-1], EXITS) and surgeon.rng.random() < 0.5:
        inside += (Break(),)
    else:
        until = b.const(_B, [True]).id
    b.append(Loop(inside, (), until, 1))
    return surgeon.replaced(place, b.pop() + loads, renamed)


def opaque_true(surgeon: Surgeon) -> Function | None:
    """Statements under a condition that always holds, which is not to be seen; the other side spoils everything."""
    place = surgeon.place(6)
    if place is None:
        return None
    b, rng = surgeon.b, surgeon.rng
    if not place.seen:
        return None
    inside, loads, renamed = surgeon.carried(place.statements)
    b.push()
    condition = truth(b, rng.choice(place.seen))
    b.push()
    for slot in rng.sample(b.variables, min(3, len(b.variables))):
        if slot.length is None:
            b.store(slot, b.const(slot.type, [1] * slot.type.size))
    spoiled = b.pop()
    b.append(If(condition.id, inside, spoiled))
    return surgeon.replaced(place, b.pop() + loads, renamed)


def truth(b: Builder, value: Value) -> Value:
    """Return a condition on a value that always holds."""
    type = value.type
    if type.is_bool:
        holds = b.let("or", value, b.let("not", value))
    elif type.is_float:
        holds = b.let("not", b.let("lt", value, value))
    else:
        three = b.const(type, [3] * type.size)
        holds = b.let("le", b.let("and", value, three), three)
    return holds if type.size == 1 else b.let("all", holds)


def split_vector(surgeon: Surgeon) -> Function | None:
    """Split an operation on vectors, or a store, into its components."""
    place = _where(surgeon, lambda s: (isinstance(s, Let) and _by_component(s)) or _whole_store(surgeon, s))
    if place is None:
        return None
    b, (s,) = surgeon.b, place.statements
    b.push()
    if isinstance(s, Store):
        size = b.type_of(s.value).size
        for c in surgeon.rng.sample(range(size), size):
            b.store(s.variable, b.swizzle(s.value, [c]), (c,))
        return surgeon.replaced(place, b.pop())
    assert isinstance(s, Let)
    parts = []
    for c in range(s.value.type.size):
        args = [b.swizzle(a, [c]) for a in s.args]
        parts.append(b.let(s.op, *args, type=s.value.type.scalar, attr=s.attr))
    b.append(Let(s.value, "construct", tuple(p.id for p in parts)))
    return surgeon.replaced(place, b.pop())


def merged_vectors(surgeon: Surgeon) -> Function | None:
    """Replace two scalar operations of one kind by one operation on vectors."""
    pairs = [(spot, i, j) for spot in surgeon.spots() for i, j in _pairs(surgeon, spot.region, spot.head)]
    if not pairs:
        return None
    spot, i, j = surgeon.rng.choice(pairs)
    b, one, two = surgeon.b, spot.region[i], spot.region[j]
    assert isinstance(one, Let)
    assert isinstance(two, Let)
    b.push()
    args = []
    for a, c in zip(one.args, two.args, strict=True):
        type = b.type_of(a)
        args.append(b.let("construct", a, c, type=type.sized(2)))
    both = b.let(one.op, *args, type=one.value.type.sized(2), attr=one.attr)
    b.append(Let(one.value, "swizzle", (both.id,), (0,)))
    b.append(Let(two.value, "swizzle", (both.id,), (1,)))
    place = Place(spot.region, i, j + 1, ())
    return surgeon.replaced(place, spot.region[i + 1 : j] + b.pop())


def _where(surgeon: Surgeon, fits: Callable[[object], bool]) -> Place | None:
    found = [Place(spot.region, n, n + 1, ()) for spot in surgeon.spots() for n, s in enumerate(spot.region) if fits(s)]
    return surgeon.rng.choice(found) if found else None


def _by_component(s: Let) -> bool:
    return s.value.type.size > 1 and _elementwise(s.op)


def _elementwise(op: str) -> bool:
    return op == "convert" or (op in OPS and OPS[op].componentwise)


def _whole_store(surgeon: Surgeon, s: object) -> bool:
    if not isinstance(s, Store) or s.components is not None or s.index is not None:
        return False
    return surgeon.b.slot(s.variable).type.size > 1


def _pairs(surgeon: Surgeon, region: Region, head: int) -> list[tuple[int, int]]:
    """Return the places of two scalar operations of one kind; nothing between them uses the first."""
    found = []
    for i, one in enumerate(region):
        if i < head or not _scalar(one):
            continue
        assert isinstance(one, Let)
        for j in range(i + 1, min(i + 40, len(region))):
            two = region[j]
            if one.value.id in _reads(surgeon, (two,)):
                break
            if _scalar(two) and _kind(surgeon, one) == _kind(surgeon, two):
                found.append((i, j))
    return found


def _scalar(s: object) -> bool:
    if not isinstance(s, Let) or s.value.type.size != 1 or s.op in LANE_OPS:
        return False
    return _elementwise(s.op)


def _kind(surgeon: Surgeon, s: Stmt) -> tuple[str, tuple[Type, ...]]:
    assert isinstance(s, Let)
    return s.op, (s.value.type, *(surgeon.b.type_of(a) for a in s.args))


def _reads(surgeon: Surgeon, region: Region) -> set[int]:
    return {id for s in walk(region) for id in uses(s, surgeon.functions)}


CHANGES: dict[str, Change] = {
    "dead code": dead_code,
    "one iteration": one_iteration,
    "opaque true": opaque_true,
    "split vectors": split_vector,
    "merged vectors": merged_vectors,
}
