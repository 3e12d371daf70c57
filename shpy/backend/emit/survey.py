"""The places where the values and variables of a function are made, used and touched.

Stage: emit, first. A region is known by its number, counted in program order: the body is 0. A place is a statement:
the number of its region, and its index there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Final, Literal

from shpy.ir.nodes import Function, If, Let, Loop, Region, Return, Stmt, Store, Variable
from shpy.ir.traverse import changed_variables, regions_of, uses

Place = tuple[int, int]
"""A statement: the number of its region, and its index in it."""

REPEATED: Final = frozenset({"load", "param", "table_size", "grid_index", "grid_line", "grid_shape"})
"""Operations that only name something: written at every use."""


class Survey:
    """The facts of one function, found by one walk over it."""

    def __init__(self, function: Function, callees: Mapping[str, Function]) -> None:
        self.callees = callees
        self.uses: Counter[int] = Counter()
        """The number of uses of each value."""
        self.lets: dict[int, Let] = {}
        self.inner: dict[Place, tuple[int, ...]] = {}
        """The numbers of the regions inside a statement."""
        self.regions: list[Region] = []
        self.stored: dict[Place, frozenset[int]] = {}
        """The variables that an If or Loop may change."""
        self.stored_in: dict[int, frozenset[int]] = {}
        """The variables that a region may change."""
        self.touched: dict[int, dict[Place, None]] = {}
        """The statements that load, store or hand on a variable; a Return reads the outputs."""
        self.counters: set[int] = set()
        """The variables that the last statement of some loop's continuing part stores."""
        self._made_in: dict[int, int] = {}
        self._used_in: dict[int, int] = {}
        self._around: list[tuple[Place, ...]] = []
        """By region, the statements around it, from the outermost one in."""
        self._outputs = [o.id for o in function.outputs]
        self._region(function.body, ())

    def statement(self, place: Place) -> Stmt:
        """Return the statement at a place."""
        return self.regions[place[0]][place[1]]

    def following(self, place: Place) -> Stmt | None:
        """Return the statement after a place in the same region."""
        region, index = self.regions[place[0]], place[1] + 1
        return region[index] if index < len(region) else None

    # The walk

    def _region(self, region: Region, around: tuple[Place, ...]) -> int:
        number = len(self.regions)
        self.regions.append(region)
        self._around.append(around)
        stored: set[int] = set()
        for index, s in enumerate(region):
            self._statement(s, number, index, stored)
        self.stored_in[number] = frozenset(stored)
        return number

    def _statement(self, s: Stmt, number: int, index: int, stored: set[int]) -> None:
        match s:
            case Let():
                for value in s.args:
                    self.uses[value] += 1
                    self._used_in[value] = number
                self.lets[s.value.id] = s
                self._made_in[s.value.id] = number
                if s.op == "load" and isinstance(s.attr, int):
                    self.touched.setdefault(s.attr, {})[number, index] = None
                return
            case Loop():
                self._loop(s, number, index)
            case _:
                for value in uses(s, self.callees):
                    self.uses[value] += 1
                    self._used_in[value] = number
                if isinstance(s, If):
                    self._inside(s, number, index)
        if (inner := self.inner.get((number, index))) is not None:
            changed = frozenset().union(*(self.stored_in[r] for r in inner))
            self.stored[number, index] = changed
        else:
            changed = frozenset(changed_variables(s, self.callees))
            for variable in (*changed, *(self._outputs if isinstance(s, Return) else ())):
                self.touched.setdefault(variable, {})[number, index] = None
        stored |= changed

    def _inside(self, s: Stmt, number: int, index: int) -> None:
        around = (*self._around[number], (number, index))
        self.inner[number, index] = tuple([self._region(r, around) for r in regions_of(s)])

    def _loop(self, s: Loop, number: int, index: int) -> None:
        self._inside(s, number, index)
        if s.until is not None:
            # The test is at the end of the iteration: its region is the one that made the value, if it is inside.
            inner = self.inner[number, index]
            self.uses[s.until] += 1
            region = self._made_in.get(s.until, number)
            self._used_in[s.until] = region if region in inner else inner[0]
        if s.continuing and isinstance(s.continuing[-1], Store):
            self.counters.add(s.continuing[-1].variable)

    # Values

    def region_of(self, value: int) -> int:
        """Return the number of the region in which an operation makes a value; the outermost one's for an input."""
        return self._made_in.get(value, 0)

    def loop_of(self, value: int) -> Place | None:
        """Return the innermost loop in which an operation makes a value; None outside all loops."""
        around = self._around[self.region_of(value)]
        return next((at for at in reversed(around) if isinstance(self.statement(at), Loop)), None)

    def may_inline(self, value: int) -> bool:
        """Return whether the value can be written where it is used: then it costs nothing and reads well."""
        let = self.lets[value]
        if let.op in REPEATED and not let.args:
            return True
        if let.op == "const":
            return let.value.name is None
        if self.uses[value] != 1:
            return self._is_glimpse(let)
        return let.value.name is None and self._used_in[value] == self._made_in[value]

    def _is_glimpse(self, let: Let) -> bool:
        """Return whether it is a component or splat of something that has a name or is a number."""
        if let.value.name is not None or let.op not in ("swizzle", "splat"):
            return False
        source = self.lets.get(let.args[0])
        if source is None or source.op in ("const", "load"):
            return True
        return not self.may_inline(let.args[0]) or self._is_glimpse(source)

    # Results

    def final_stores(self, result: int) -> tuple[set[Place], bool]:
        """Return the stores of the result that end the function, and whether no other statement touches the result."""
        stores: set[Place] = set()
        ended, others = self._final_stores(0, result, stores, tail=True)
        touched = self.touched.get(result, {}).keys() - stores
        return stores, ended and not others and all(isinstance(self.statement(at), Return) for at in touched)

    def _final_stores(self, number: int, result: int, stores: set[Place], *, tail: bool) -> tuple[bool, bool]:
        """Return whether a region is always left by such a store, and whether a Return in it follows none.

        `tail`: the function ends where the region does.
        """
        region, ended, others = self.regions[number], False, False
        end = len(region)
        while end and isinstance(region[end - 1], Return):
            end -= 1
        for index in range(end):
            s, last = region[index], index + 1 == end
            if isinstance(s, Store) and s.variable == result and is_whole(s) and last and (tail or end < len(region)):
                stores.add((number, index))
                ended = True
            elif isinstance(s, If | Loop):
                last = last and isinstance(s, If)
                inner = [self._final_stores(n, result, stores, tail=tail and last) for n in self.inner[number, index]]
                ended = isinstance(s, If) and all(e for e, _ in inner)
                others = others or any(o for _, o in inner)
            if ended:
                break
        return ended, others or (end < len(region) and not ended)

    # Variables

    def place(self, variable: Variable, *, output: bool) -> tuple[Place, bool] | None:
        """Return before which statement to declare a variable, and whether as zero; None if nothing touches it."""
        touched = list(self.touched.get(variable.id, ()))
        if output:
            touched.append((0, len(self.regions[0])))
        if not touched:
            return None
        marks = self._marked(touched)
        home = 0  # the innermost region around all that touches it
        while len(marks[home]) == 1 and len(inside := marks.keys() & self.inner.get((home, marks[home][0]), ())) == 1:
            (home,) = inside
        while variable.length is not None or self._first_access(home, variable.id, marks) != "stored":
            outer = self._outside_loops(home)
            if outer == home:
                return (home, marks[home][0]), True
            home = outer
        return (home, marks[home][0]), False

    def touches_inside(self, place: Place, variable: int) -> int:
        """Count the statements inside an If or Loop that touch a variable."""
        return sum(place in self._around[region] for region, _ in self.touched.get(variable, ()))

    def _marked(self, touched: list[Place]) -> dict[int, list[int]]:
        """Return the statements that touch the variable, or hold one that does, by region and in order."""
        marks: dict[int, set[int]] = {}
        for region, index in {at for place in touched for at in (*self._around[place[0]], place)}:
            marks.setdefault(region, set()).add(index)
        return {region: sorted(indices) for region, indices in marks.items()}

    def _first_access(
        self, number: int, variable: int, marks: Mapping[int, list[int]]
    ) -> Literal["stored", "read", "nothing"]:
        """Return what a region does to the variable first, on every way; only a store of the whole is a store."""
        region = self.regions[number]
        for index in marks.get(number, []):
            if index == len(region):
                return "read"
            match region[index]:
                case Store(v, components=None, index=None) if v == variable:
                    return "stored"
                case If():
                    ways = {self._first_access(r, variable, marks) for r in self.inner[number, index]}
                    if ways == {"stored"}:
                        return "stored"
                    if ways != {"nothing"}:
                        return "read"
                case _:
                    return "read"
        return "nothing"

    def _outside_loops(self, region: int) -> int:
        """Return the region that holds the outermost loop around this one; itself if there is none."""
        return next((at[0] for at in self._around[region] if isinstance(self.statement(at), Loop)), region)


def is_whole(store: Store) -> bool:
    """Return whether all of a variable is stored."""
    return store.components is None and store.index is None
