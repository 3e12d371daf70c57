"""The loop that calls a function for the lanes of a packet one after the other, or two at a time.

Stage: emit. Varying arguments are stored to arrays, one number per lane. The function of one element is called for each
active lane, or for two of them, and its results are loaded from arrays. Inactive lanes give 0.

    calls = LaneCalls(active, [x], [length], [table], 16, names.take)
    block = calls.one_by_one("find_alone")
    block = calls.two_by_two("find_two")        # see passes/pairing.py
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from shpy.backend.emit import tree
from shpy.backend.emit.tree import BOOL, INT, Block, Expr, Literal, Name, number
from shpy.backend.opencl.packets.prologue_wide import LONGEST
from shpy.backend.opencl.packets.widen import lanes_of
from shpy.ir.types import Base, Type
from shpy.passes.pairing import OTHER


class LaneCalls:
    """The calls of a function for the lanes of the mask `active`, a parameter of the function that is written.

    `inputs` and `outputs` are its other parameters, as names with the types of one element. A single result is
    returned; several are stored through pointers. `context` are arguments that all lanes share. `take` gives a name
    that is not in use.
    """

    def __init__(
        self,
        active: Name,
        inputs: Sequence[Name],
        outputs: Sequence[Name],
        context: Sequence[Name],
        lanes: int,
        take: Callable[[str], str],
    ) -> None:
        self.active, self.inputs, self.outputs = active, inputs, outputs
        self.context, self.lanes, self.take = context, lanes, take
        self.arrays = {e: Name(e.type, take(f"{e.text}_of")) for e in (*inputs, active, *outputs)}
        self.lane = Name(INT, take("k"))

    def one_by_one(self, one: str) -> Block:
        """Return the statements that call `one` for each active lane."""
        results = self._results("")
        args: list[Expr] = self._arguments(self.lane)
        if len(results) == 1:
            called: tree.Stmt = tree.Assign(results[0], tree.call(one, results[0].type, *args, *self.context))
        else:
            called = tree.Do(tree.call(one, BOOL, *args, *(tree.prefix("&", r) for r in results), *self.context))
        declared = [tree.Declare(r.type, r.text) for r in results]
        call = (*declared, called, *self._keep(results, self.lane))
        return self._through_arrays(self._each_active(call))

    def two_by_two(self, two: str) -> Block:
        """Return the statements that call `two` for two active lanes at a time; the last may be without another."""
        lanes, count, n = (Name(INT, self.take(name)) for name in ("lanes", "lane_count", "n"))
        there, other = Name(BOOL, self.take("there")), Name(INT, self.take(f"{OTHER}{self.lane.text}"))
        following = tree.infix("+", n, number(1))
        pairs = [self._results(""), self._results(OTHER)]
        results = [r for pair in pairs for r in pair]
        args = [*self._arguments(self.lane), there, *self._arguments(other)]
        call: Block = (
            tree.Declare(INT, self.lane.text, tree.Index(INT, lanes, n)),
            tree.Declare(BOOL, there.text, tree.infix("<", following, count, BOOL)),
            tree.Declare(INT, other.text, tree.choice(there, tree.Index(INT, lanes, following), self.lane)),
            *(tree.Declare(r.type, r.text) for r in results),
            tree.Do(tree.call(two, BOOL, *args, *(tree.prefix("&", r) for r in results), *self.context)),
            *self._keep(pairs[1], other),  # before the rest: without another lane it is the lane itself
            *self._keep(pairs[0], self.lane),
        )
        return self._through_arrays(
            tree.Declare(INT, lanes.text, length=self.lanes),
            tree.Declare(INT, count.text, number(0)),
            self._each_active((tree.Assign(tree.Index(INT, lanes, count), self.lane), _increased(count))),
            tree.Loop(
                call, (tree.Declare(INT, n.text, number(0)),), tree.infix("<", n, count, BOOL), _increased(n, by=2)
            ),
        )

    def _through_arrays(self, *work: tree.Stmt) -> Block:
        """Return `work` after the arguments are stored to arrays, and before the results are loaded from arrays."""
        lanes = self.lanes
        begin: list[tree.Stmt] = []
        for e in (*self.inputs, self.active):
            begin.append(tree.Declare(_element_type(e.type), self.arrays[e].text, length=lanes))
            begin.append(tree.Do(_memory("vstore", lanes, e.type, e, number(0), self.arrays[e])))
        begin += [tree.Declare(_element_type(e.type), self.arrays[e].text, number(0), lanes) for e in self.outputs]
        loaded = [_loaded(self.arrays[e], lanes) for e in self.outputs]
        if len(loaded) == 1:
            return (*begin, *work, tree.Exit("return", loaded[0]))
        stores = [tree.Assign(tree.prefix("*", e), value) for e, value in zip(self.outputs, loaded, strict=True)]
        return (*begin, *work, *stores)

    def _each_active(self, block: Block) -> tree.Loop:
        """Return the loop that does `block` for each active lane."""
        there = tree.Index(BOOL, self.arrays[self.active], self.lane)
        within = tree.infix("<", self.lane, number(self.lanes), BOOL)
        begin = (tree.Declare(INT, self.lane.text, number(0)),)
        return tree.Loop((tree.If(there, block),), begin, within, _increased(self.lane))

    def _arguments(self, lane: Name) -> list[Expr]:
        """Return a lane's arguments."""
        elements = [tree.Index(e.type, self.arrays[e], lane) for e in self.inputs]
        return [tree.infix("!=", e, number(0)) if e.type is BOOL else e for e in elements]

    def _results(self, prefix: str) -> list[Name]:
        """Return the names of one lane's results."""
        return [Name(e.type, self.take(f"{prefix}{e.text}_one")) for e in self.outputs]

    def _keep(self, results: Sequence[Name], lane: Name) -> Block:
        """Return the stores of a lane's results."""
        kept: list[tree.Stmt] = []
        for e, r in zip(self.outputs, results, strict=True):
            value = tree.prefix("-", tree.Cast(INT, r)) if e.type is BOOL else r
            kept.append(tree.Assign(tree.Index(e.type, self.arrays[e], lane), value))
        return tuple(kept)


def _increased(e: Name, by: int = 1) -> tree.Assign:
    return tree.Assign(e, tree.infix("+", e, number(by)))


def _element_type(type: Type) -> Type:
    """Return the type of a lane's number in an array: bools are stored as masks, which are ints."""
    return type.based(Base.I) if type.is_bool else type


def _memory(way: str, lanes: int, type: Type, *args: Expr) -> Expr:
    """Return the call of OpenCL's function that loads or stores `lanes` numbers (`way`: `vload` or `vstore`)."""
    return tree.call(f"{way}{lanes}", type, *args)


def _loaded(array: Name, lanes: int) -> Expr:
    """Return the expression that loads an array as a packet."""
    type = lanes_of(array.type.base, lanes)
    if lanes <= LONGEST:
        return _memory("vload", lanes, type, number(0), array)
    parts = [_memory("vload", LONGEST, type, Literal(INT, k), array) for k in range(lanes // LONGEST)]
    return tree.Construct(type, tuple(parts))
