"""Where a C-like text puts things: which values stand in the expression that uses them, where variables are declared.

Stage: emit, before the first line is printed. Takes a function, gives a `Layout`. A region is known by its number,
counted in program order: the body is 0.

    $n is only used in a loop's body, stored first in each iteration   ->  declared inside the loop
    $n is loaded before it is stored in an iteration                   ->  declared, zero, before the loop
    %p = mul %a, %b has no name and one use, in its own region         ->  printed where it is used
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from shpy.ir.nodes import Call, Function, If, Let, Loop, Region, Return, Stmt, Store, Variable
from shpy.ir.ops import LANE_OPS
from shpy.ir.traverse import regions_of, uses, variables_of, walk

REPEATED: Final = frozenset({"load", "param", "table_size", "grid_index", "grid_shape"})
"""Operations that only name something: printed at every use."""


@dataclass(frozen=True, slots=True)
class Place:
    """A variable's declaration: before the `index`-th statement of a region; `zero` if nothing is stored first."""

    region: int
    index: int
    zero: bool


@dataclass(slots=True)
class Layout:
    """The plan of one function's text."""

    uses: Counter[int] = field(default_factory=Counter)
    inlined: set[int] = field(default_factory=set)
    places: dict[int, Place] = field(default_factory=dict)
    declared: dict[tuple[int, int], list[int]] = field(default_factory=dict)
    """The variables that are declared before the `index`-th statement of a region."""
    inner: dict[tuple[int, int], tuple[int, ...]] = field(default_factory=dict)
    """The numbers of the regions inside the `index`-th statement of a region."""
    accesses: Counter[int] = field(default_factory=Counter)
    """How many statements touch each variable."""
    counters: set[int] = field(default_factory=set)
    """The variables that the last statement of some loop's continuing part stores."""


class After(NamedTuple):
    """What comes after a statement: the rest of its region from `start` on, not copied unless it is asked for."""

    region: Region
    start: int

    @property
    def first(self) -> Stmt | None:
        """The next statement."""
        return self.region[self.start] if self.start < len(self.region) else None

    def all(self) -> Region:
        """All of them."""
        return self.region[self.start :]


def lay_out(function: Function, callees: Mapping[str, Function]) -> Layout:
    """Plan the text of `function`; `callees` are all functions by name."""
    survey = _Survey(function, callees)
    survey.region(function.body, 0, None)
    layout = survey.layout
    for value in survey.values:
        if survey.may_inline(value):
            layout.inlined.add(value)
    slots = [v for v in variables_of(function) if v not in function.inputs]
    for variable in slots:
        place = survey.place(variable, variable in function.outputs)
        if place is not None:
            layout.places[variable.id] = place
            layout.declared.setdefault((place.region, place.index), []).append(variable.id)
    return layout


def stored_variables(region: Region, callees: Mapping[str, Function]) -> frozenset[int]:
    """The variables that the region's statements, nested ones too, may change."""
    return frozenset(v for s in walk(region) for v in changed_variables(s, callees))


def changed_variables(statement: Stmt, callees: Mapping[str, Function]) -> list[int]:
    """The variables that the statement itself may change."""
    match statement:
        case Store(variable):
            return [variable]
        case Call(name, args):
            inputs = callees[name].inputs
            return [a for a, port in zip(args, inputs, strict=True) if isinstance(port, Variable)]
    return []


class _Survey:
    """One walk over a function that notes where everything is made and used."""

    def __init__(self, function: Function, callees: Mapping[str, Function]) -> None:
        self.function = function
        self.callees = callees
        self.layout = Layout()
        self.values: dict[int, Let] = {}
        self.made_in: dict[int, int] = {}
        self.used_in: dict[int, int] = {}
        self.regions: list[Region] = []
        self.parents: list[tuple[int, int, Stmt] | None] = []
        self.touched: dict[int, list[tuple[int, int]]] = {}
        self.marks: dict[int, list[int]] = {}

    def region(self, region: Region, number: int, parent: tuple[int, int, Stmt] | None) -> None:
        """Note a region and those inside it; numbers count up in program order."""
        assert number == len(self.regions)
        self.regions.append(region)
        self.parents.append(parent)
        for index, statement in enumerate(region):
            self._statement(statement, number, index)
            inner = []
            for nested in regions_of(statement):
                inner.append(len(self.regions))
                self.region(nested, inner[-1], (number, index, statement))
            if isinstance(statement, Loop) and statement.until is not None:
                # The test is at the end of the iteration: its region is the one that made the value, if it is inside.
                self.layout.uses[statement.until] += 1
                made = self.made_in.get(statement.until, number)
                self.used_in[statement.until] = made if made in inner else inner[0]
            if isinstance(statement, Loop) and statement.continuing and isinstance(statement.continuing[-1], Store):
                self.layout.counters.add(statement.continuing[-1].variable)
            if inner:
                self.layout.inner[number, index] = tuple(inner)

    def _statement(self, statement: Stmt, region: int, index: int) -> None:
        if not isinstance(statement, Loop):
            for value in uses(statement, dict(self.callees)):
                self.layout.uses[value] += 1
                self.used_in[value] = region
        if isinstance(statement, Let):
            self.values[statement.value.id] = statement
            self.made_in[statement.value.id] = region
        for variable in _touched(statement, self.function, self.callees):
            self.touched.setdefault(variable, []).append((region, index))
            self.layout.accesses[variable] += 1

    def may_inline(self, value: int) -> bool:
        """Whether the value can be printed where it is used: then it costs nothing and reads well."""
        let = self.values[value]
        if let.op in REPEATED and not let.args:
            return True
        if let.op == "const":
            return let.value.name is None
        if let.op in LANE_OPS or self.layout.uses[value] != 1:
            return self._is_glimpse(let)
        return let.value.name is None and self.used_in[value] == self.made_in[value]

    def _is_glimpse(self, let: Let) -> bool:
        """A component or splat of something that has a name or is a number."""
        if let.value.name is not None or let.op not in ("swizzle", "splat"):
            return False
        source = self.values.get(let.args[0])
        if source is None:
            return True
        return source.op in ("const", "load") or source.value.id not in self.layout.inlined or self._is_glimpse(source)

    def place(self, variable: Variable, output: bool) -> Place | None:
        """Where to declare the variable; None if nothing touches it."""
        touched = self.touched.get(variable.id, [])
        if output:
            touched = [*touched, (0, len(self.regions[0]))]
        if not touched:
            return None
        home = self._common([region for region, _ in touched])
        self.marks = self._marked(variable.id)
        while True:
            index = min(self._index_in(home, region, at) for region, at in touched)
            first = self._first_access(home, variable.id)
            if first == "stored" and variable.length is None:
                return Place(home, index, zero=False)
            outer = self._outside_loops(home)
            if outer == home:
                return Place(home, index, zero=True)
            home = outer

    def _marked(self, variable: int) -> dict[int, list[int]]:
        """The statements that touch the variable, or hold one that does, by region and in order."""
        marks: dict[int, set[int]] = {}
        for region, index in self.touched.get(variable, []):
            while index not in marks.setdefault(region, set()):
                marks[region].add(index)
                parent = self.parents[region]
                if parent is None:
                    break
                region, index = parent[0], parent[1]
        return {region: sorted(found) for region, found in marks.items()}

    def _first_access(self, region: int, variable: int) -> str:
        """What a region does to the variable first, on every way: `stored` it whole, `read` it, or `nothing`."""
        for index in self.marks.get(region, []):
            match self.regions[region][index]:
                case Store(v, components=None, index=None) if v == variable:
                    return "stored"
                case If():
                    ways = {self._first_access(inner, variable) for inner in self.layout.inner[region, index]}
                    if ways == {"stored"}:
                        return "stored"
                    if ways != {"nothing"}:
                        return "read"
                case _:
                    return "read"
        return "nothing"

    def _outside_loops(self, region: int) -> int:
        """The region that holds the outermost loop around this one; itself if there is none."""
        result, at = region, self.parents[region]
        while at is not None:
            if isinstance(at[2], Loop):
                result = at[0]
            at = self.parents[at[0]]
        return result

    def _path(self, region: int) -> list[int]:
        path = [region]
        while (parent := self.parents[path[-1]]) is not None:
            path.append(parent[0])
        return path[::-1]

    def _common(self, regions: list[int]) -> int:
        """The innermost region around all of these."""
        common = self._path(regions[0])
        for region in regions[1:]:
            path = self._path(region)
            shared = [a for a, b in zip(common, path, strict=False) if a == b]
            common = shared
        return common[-1]

    def _index_in(self, home: int, region: int, index: int) -> int:
        """The statement of `home` in which statement `index` of `region` is."""
        while region != home:
            parent = self.parents[region]
            assert parent is not None
            region, index = parent[0], parent[1]
        return index


def _touched(statement: Stmt, function: Function, callees: Mapping[str, Function]) -> list[int]:
    """The variables that the statement itself loads, stores or passes on; a Return reads the outputs."""
    match statement:
        case Let(_, "load", _, int(variable)):
            return [variable]
        case Return():
            return [o.id for o in function.outputs]
    return changed_variables(statement, callees)


def access_count(region: Region, variable: int, function: Function, callees: Mapping[str, Function]) -> int:
    """How many statements of the region, nested ones too, touch the variable."""
    return sum(variable in _touched(s, function, callees) for s in walk(region))
