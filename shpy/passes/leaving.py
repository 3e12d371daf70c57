"""Translate Break, Continue, Return and Discard that only some lanes may take.

Stage: improve. Part of `vectorize`. An exit that all lanes of an iteration take together stays as it is. Otherwise the
leaving lanes are removed from a mask, and the real exit follows if no lane is left:

    if %c {            |   if lane_any(%leaving) {
      break            |     $n_out = cond(%leaving, $n, $n_out)      (what is needed after the loop)
    }                  |     $live = $live & ~%leaving
                  ->   |     if not lane_any($live) { break }
                       |   }
"""

from __future__ import annotations

from collections.abc import Iterable

from shpy.ir.nodes import Break, Continue, Discard, Function, If, Return, Variable
from shpy.passes.lanes import BOOL, Here, LaneBuilder
from shpy.passes.liveness import Note


class ExitBuilder(LaneBuilder):
    """A LaneBuilder that translates exits; the methods return whether the region ends with the exit."""

    def __init__(self, function: Function, varying_inputs: frozenset[int]) -> None:
        super().__init__(function, varying_inputs)
        self.outputs = tuple(v.id for v in function.outputs)

    def remove(self, slot: Variable, mask: int) -> None:
        """Remove the lanes of `mask` from the mask in `slot`."""
        self.b.store(slot, self.let("and", self.load(slot), self.let("not", mask)))

    def put_aside(self, changed: frozenset[int], needed: frozenset[int], mask: int) -> None:
        """Copy the variables that leaving lanes changed in a loop, and that are needed after it, to the outer slots.

        A needed variable that they did not change is in its outer slot already; other lanes must not change it there.
        """
        scope = self.scope
        assert scope.note is not None
        scope.facts.copied |= (scope.note.stored & needed) - self.arrays
        for variable in sorted((changed & needed) - self.arrays):
            if variable in scope.inner:
                outside = self.lanes(variable, scope.outer)
                kept = self.select(mask, self.load(self.current(variable)), self.load(outside))
                self.b.store(outside, kept)

    def leave_loop(self, s: Break, note: Note, here: Here, needed: Iterable[int] | None = None) -> bool:
        """Translate a Break, or a Discard, after which only the variables `needed` (the status) are needed."""
        scope = self.scope
        assert scope.note is not None
        live = scope.note.after if needed is None else frozenset(needed)
        together = here.whole and not scope.continued
        if together and not scope.facts.varying:
            self.meet_outside(scope.note.stored - self.arrays, live)
            self.b.append(s)
            return True
        mask = self.mask(here)
        self.put_aside(note.dirty, live, mask)
        if together:
            self.b.append(s)
            return True
        scope.facts.varying = True
        self.remove(scope.live, mask)
        self.b.append(If(self.none(self.load(scope.live)), (s,), (), s.loc))
        return self.leave_iteration(mask, here, s)

    def skip_iteration(self, s: Continue, here: Here) -> bool:
        """Translate a Continue."""
        scope = self.scope
        assert scope.note is not None
        if here.whole:
            self.jump(s)
            return True
        scope.facts.continues = True
        scope.continued = True
        scope.kept |= scope.note.inner[1]
        return self.leave_iteration(self.mask(here), here, s)

    def leave_iteration(self, mask: int, here: Here, s: Break | Continue) -> bool:
        """Remove lanes from this iteration, unless removing them from the loop did so already."""
        scope = self.scope
        if scope.iterating is scope.live and not here.whole:
            return False
        if here.whole:
            self.jump(s)
            return True
        self.remove(scope.iterating, mask)
        none = self.none(self.load(scope.iterating))
        self.b.push()
        self.jump(s)
        self.b.append(If(none, self.b.pop(), (), s.loc))
        return False

    def jump(self, s: Break | Continue) -> None:
        """Append a Continue for all lanes of the iteration."""
        note = self.scope.note
        assert note is not None
        self.scope.facts.jumps = True
        self.meet(self.scope.facts.step, note.stored, note.inner[1])
        self.b.append(Continue(s.loc))

    def leave_function(self, s: Return | Discard, here: Here) -> bool:
        """Translate a Return, or a Discard outside loops."""
        scope = self.scope
        if here.whole:
            self.meet_outside(frozenset(self.outputs), frozenset(self.outputs))
            self.b.append(Return(s.loc))
            return True
        scope.facts.varying = True
        scope.kept.update(self.outputs if isinstance(s, Return) else self.outputs[-1:])
        self.remove(scope.live, self.mask(here))
        return False

    def return_if_none(self, mask: int) -> None:
        """Append a Return that is taken if no lane of `mask` is left."""
        none = self.none(mask)
        self.b.push()
        self.meet_outside(frozenset(self.outputs), frozenset(self.outputs))
        self.b.append(Return())
        self.b.append(If(none, self.b.pop()))

    def mask(self, here: Here) -> int:
        """Return the id of the mask of active lanes, also where it is not stored because all lanes are active."""
        return self.let("lane_mask", type=BOOL) if here.mask is None else here.mask
