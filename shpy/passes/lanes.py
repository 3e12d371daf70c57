"""Build code for many lanes: track varying values, choose slots of variables, and compute masks.

Stage: improve. Part of `vectorize`, whose class extends `LaneBuilder` by the translation of statements.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from shpy.ir.builder import Builder
from shpy.ir.constants import Base, vec
from shpy.ir.nodes import Attr, Function, Let, Stmt, Variable
from shpy.ir.traverse import rewrite
from shpy.ir.types import Type
from shpy.passes.liveness import Note
from shpy.passes.slots import Slots
from shpy.passes.uniformity import LoopFacts, varies

BOOL = vec(Base.B)


@dataclass(slots=True)
class Here:
    """The state of the current region.

    `mask`: the active lanes (None: all). `whole`: they are all the lanes left in the iteration. `kept`: the variables
    that lanes masked off by an If still need. `thinned`: lanes have left since the region began.
    """

    mask: int | None
    whole: bool
    kept: frozenset[int] = frozenset()
    thinned: bool = False


@dataclass(slots=True)
class MaskScope:
    """The state of the current loop, or of the function, which has no note.

    `live`, `iterating`: slots with the masks of the lanes still in the loop and still in this iteration.
    `inner`: the variables that have a slot of their own in the loop. `kept`: the variables needed by lanes that skip
    the rest of the iteration. `continued`: some lanes may be skipping it. `left`: an exit for all lanes was translated.
    `late`: a later one brought a variable that varies, which the first did not spread.
    """

    facts: LoopFacts
    live: Variable
    iterating: Variable
    note: Note | None = None
    outer: MaskScope | None = None
    inner: frozenset[int] = frozenset()
    kept: set[int] = field(default_factory=set)
    continued: bool = False
    left: bool = False
    late: bool = False


def of_all_lanes(function: Function) -> Function:
    """Return a pure function with `lane_any` for `any_lane`: it has no mask, so all lanes count as active."""

    def change(s: Stmt) -> Stmt:
        return replace(s, op="lane_any") if isinstance(s, Let) and s.op == "any_lane" else s

    body = rewrite(function.body, change)
    return function if body is function.body else replace(function, body=body)


class LaneBuilder:
    """Builds lane operations, loads and stores for `vectorize`.

    `varying_inputs` are the ids of the varying inputs; `state` are the variables that vary at the current point.
    """

    def __init__(self, function: Function, varying_inputs: frozenset[int]) -> None:
        self.function = function
        self.varying_inputs = varying_inputs
        variables = (*function.outputs, *function.variables)
        self.arrays = frozenset(v.id for v in variables if v.length is not None)
        self.slots = Slots(variables)
        self.facts = LoopFacts()
        self.varying_arrays: set[int] = set()
        self.always: set[int] = set()
        self.variables = [v.id for v in variables if v.length is None]
        self.begin()

    def begin(self) -> None:
        """Reset the state of a walk over the function."""
        self.b = Builder(function=self.function)
        self.varying = set(self.varying_inputs)
        self.same: dict[int, int] = {}
        self.state = set(self.always)
        running = self.slots.mask("running", -1)
        self.scope = MaskScope(self.facts, running, running)

    def let(self, op: str, *args: int, type: Type | None = None, attr: Attr = None, name: str | None = None) -> int:
        """Append an operation that the source does not have; return its id."""
        value = self.b.let(op, *args, type=type, attr=attr, name=name).id
        if varies(op, (a in self.varying for a in args)):
            self.varying.add(value)
        return value

    def load(self, slot: Variable, index: int | None = None) -> int:
        """Append a load of a slot; return its id."""
        value = self.b.load(slot, index).id
        if slot.id in self.slots.varying or index in self.varying:
            self.varying.add(value)
        return value

    def both(self, mask: int | None, condition: int, name: str | None = None) -> int:
        """Return the lanes of `mask` for which `condition` holds."""
        return condition if mask is None else self.let("and", mask, condition, name=name)

    def none(self, mask: int) -> int:
        """Return whether no lane of `mask` is set."""
        return self.let("not", self.let("lane_any", mask, type=BOOL))

    def lanes(self, variable: int, scope: MaskScope | None = None) -> Variable:
        """Return the lanes slot of a variable in the current scope, or in the given one."""
        scope = scope or self.scope
        while scope.outer is not None and variable not in scope.inner:
            scope = scope.outer
        return self.slots.lanes(variable, None if scope.outer is None else id(scope.note))

    def current(self, variable: int) -> Variable:
        """Return the slot that holds a variable at this point."""
        return self.lanes(variable) if variable in self.state else self.slots.uniform(variable)

    def spread(self, variable: int) -> None:
        """Copy a variable's uniform slot to its lanes slot."""
        self.b.store(self.lanes(variable), self.load(self.slots.uniform(variable)))

    def select(self, mask: int, new: int, old: int) -> int:
        """Return `new` in the lanes of `mask`, else `old`."""
        size = self.b.type_of(new).size
        wide = mask if size == 1 else self.let("splat", mask, type=BOOL.sized(size))
        return self.let("cond", wide, new, old)

    def kept(self, here: Here) -> frozenset[int]:
        """Return the variables that masked-off lanes still need."""
        return frozenset() if here.mask is None else here.kept | self.scope.kept

    def meet(self, facts: set[int], stored: frozenset[int], live: frozenset[int]) -> None:
        """Join control flow: add the variables that vary here to `facts`, and spread the others in `facts`."""
        facts |= self.state & stored & live
        for variable in sorted(facts - self.state):
            self.spread(variable)

    def meet_outside(self, stored: frozenset[int], live: frozenset[int]) -> None:
        """Join control flow where all lanes leave the loop, or the function, together."""
        scope = self.scope
        scope.late |= scope.left and not self.state & stored & live <= scope.facts.exit
        scope.left = True
        self.meet(scope.facts.exit, stored, live)
