"""Check that a module keeps the rules of the IR, and show the first violation inside the listing.

Stage: verify. It takes a module, as recorded, parsed or rewritten by a pass, and returns nothing. It raises
`VerifyError`, whose message ends with the lines around the violation, which is marked. docs/ir.md states the rules.

    there is no value %7
        function main(%x.0: f) -> ($y.0: f) {
          %1: f = add %x.0, %7
          ^^^^^^^^^^^^^^^^^^^^
          store $y.0 = %1
        }
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NoReturn

from shpy.errors import VerifyError, shorten
from shpy.ir.constants import decode
from shpy.ir.nodes import (
    EXITS,
    MAX_ARRAY,
    MAX_LOOP_DEPTH,
    MAX_PART_DEPTH,
    MAX_REGION_DEPTH,
    MAX_TABLE,
    Break,
    Call,
    Continue,
    Function,
    If,
    Let,
    Loc,
    Loop,
    Module,
    Region,
    Stmt,
    Store,
    Value,
    Variable,
)
from shpy.ir.ops import LANE_OPS, OPS, STRUCTURAL, result_type
from shpy.ir.signatures import Declarations, check_constant, check_index, counted, spoken_types, structural_type
from shpy.ir.text import Anchor, Line, components_text, lines, quote
from shpy.ir.traverse import continues
from shpy.ir.types import SIZES, WIDEST_PORT, Base, Type, vec

_BEFORE, _AFTER = 8, 3
_BOOL = vec(Base.B)


def verify(module: Module) -> None:
    """Raise VerifyError for the first violation of a rule."""
    checker = _ModuleCheck(module)
    try:
        checker.check()
    except _Finding as finding:
        shown = _listing(lines(module, locations=False), finding.anchor)
        raise VerifyError(f"{finding.message}\n{shown}", loc=finding.loc, cure=finding.cure) from None


class _Finding(Exception):
    def __init__(self, message: str, anchor: Anchor, loc: Loc | None = None, cure: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.anchor = anchor
        self.loc = loc
        self.cure = cure


def _listing(listed: list[Line], anchor: Anchor) -> str:
    """Return the marked line, the lines around it, and the first lines of the enclosing statements."""
    marked = next((n for n, line in enumerate(listed) if line.anchor == anchor), 0)
    depth = listed[marked].depth
    heads: list[int] = []
    for n in range(marked, -1, -1):
        if listed[n].depth < depth:
            depth = listed[n].depth
            heads.append(n)
    first = max(marked - _BEFORE, heads[-1] if heads else 0)
    chosen = {*heads, *range(first, min(len(listed), marked + _AFTER + 1))}
    shown: list[str] = []
    last = -1
    for n in sorted(chosen):
        if n != last + 1 and listed[n - 1].text:
            shown.append(f"    {'  ' * listed[n].depth}...")
        last = n
        text = shorten(listed[n].text)
        if text:
            shown.append(f"    {'  ' * listed[n].depth}{text}")
        if n == marked:
            shown.append(f"    {'  ' * listed[n].depth}{'^' * min(len(text), 120)}")
    return "\n".join(shown)


def _repeated(names: Iterable[str]) -> tuple[int, str] | None:
    """Return the index of the first repeated name, and the name."""
    seen: set[str] = set()
    for n, name in enumerate(names):
        if name and name in seen:
            return n, name
        seen.add(name)
    return None


class _ModuleCheck:
    """Checks the rules of declarations, and then each function."""

    def __init__(self, module: Module) -> None:
        self.module = module
        self.scope = Declarations()
        self.statements = 0
        self.slots = 0

    def check(self) -> None:
        self.check_names()
        self.check_params()
        self.check_tables()
        if not self.module.functions:
            raise _Finding("a module has at least one function: the last is its entry", ("module", 0))
        for i, function in enumerate(self.module.functions):
            if function.name in self.scope.functions:
                raise _Finding(f"two functions are called {quote(function.name)}", ("function", i), function.loc)
            _FunctionCheck(self, i, function).check()
            self.scope.functions[function.name] = function
        self.check_entry()

    def check_names(self) -> None:
        module = self.module
        for word, declared in (
            ("input", [p.name for p in module.inputs]),
            ("output", [p.name for p in module.outputs]),
            ("param", [p.name for p in module.params]),
            ("table", [t.name for t in module.tables]),
        ):
            twice = _repeated(declared)
            if twice:
                raise _Finding(f"two {word}s are called {quote(twice[1])}", (word, twice[0]))
            deep = next((n for n, name in enumerate(declared) if name.count(".") >= MAX_PART_DEPTH), None)
            if deep is not None and word in ("input", "output"):
                told = f"the structure of this {word} is nested more than {MAX_PART_DEPTH} deep"
                raise _Finding(told, (word, deep), cure="fewer dots in its name")

    def check_params(self) -> None:
        for i, param in enumerate(self.module.params):
            try:
                check_constant(param.type, param.value)
            except TypeError as error:
                raise _Finding(str(error), ("param", i)) from None
            about = param.about
            fault = about.fault(param.type)
            outside = None if fault else about.outside(decode(param.type, param.value))
            if outside is not None and about.range is not None:
                fault = f"{outside} is outside of the range, {about.range[0]} to {about.range[1]}"
            if fault:
                raise _Finding(fault, ("param", i))
            self.scope.params[param.name] = param

    def check_tables(self) -> None:
        for i, table in enumerate(self.module.tables):
            if not 1 <= table.rank <= 3:
                raise _Finding(f"a table has 1 to 3 axes, not {table.rank}", ("table", i))
            if table.size is not None and len(table.size) != table.rank:
                raise _Finding(f"a table of rank {table.rank} has {table.rank} extents", ("table", i))
            if table.size is not None and min(table.size) < 1:
                raise _Finding("a table is not empty", ("table", i))
            if table.size is not None and math.prod(table.size) > MAX_TABLE:
                raise _Finding(
                    f"a table has at most {MAX_TABLE:,} elements, not {math.prod(table.size):,}", ("table", i)
                )
            self.scope.tables[table.name] = table

    def check_entry(self) -> None:
        """Check that the entry has the module's inputs and outputs; a lowered one may have a status, an i, as well."""
        entry, anchor = self.module.entry, ("function", len(self.module.functions) - 1)
        if any(isinstance(port, Variable) for port in entry.inputs):
            raise _Finding("the entry takes its inputs by value", anchor, entry.loc)
        if len(entry.inputs) != len(self.module.inputs):
            told = f"the module has {counted(len(self.module.inputs), 'input')}, its entry {len(entry.inputs)}"
            raise _Finding(told, anchor, entry.loc)
        self.check_ports(entry)
        extra = entry.outputs[len(self.module.outputs) :]
        if len(entry.outputs) < len(self.module.outputs) or [o.type for o in extra] not in ([], [vec(Base.I)]):
            told = f"the module has {counted(len(self.module.outputs), 'output')}, its entry {len(entry.outputs)}"
            raise _Finding(told, anchor, entry.loc)

    def check_ports(self, entry: Function) -> None:
        """Check that vectors of eight stay inside of functions."""
        for word, things in (
            ("input", entry.inputs),
            ("output", entry.outputs),
            ("param", self.module.params),
            ("table", self.module.tables),
        ):
            for i, thing in enumerate(things):
                if thing.type.size > WIDEST_PORT:
                    told = f"the components of this {word} are more than {WIDEST_PORT}"
                    raise _Finding(told, (word, i), cure="two vectors of four")


class _FunctionCheck:
    """Checks the rules of one function, in the order of its text."""

    def __init__(self, parent: _ModuleCheck, index: int, function: Function) -> None:
        self.parent = parent
        self.function = function
        self.scope = Declarations({}, parent.scope.params, parent.scope.tables, parent.scope.functions)
        self.anchor: Anchor = ("function", index)
        self.loc = function.loc
        self.visible: dict[int, Type] = {}
        self.values: set[int] = set()
        self.asking: set[int] = set()  # the results of any_lane
        self.opened: list[list[int]] = [[]]
        self.depth = 0
        self.loops = 0
        self.targets = 0  # the number of these loops that a Break may leave here
        self.in_continuing = False

    def fail(self, message: str, loc: Loc | None = None, cure: str | None = None) -> NoReturn:
        raise _Finding(message, self.anchor, loc or self.loc, cure)

    def check(self) -> None:
        self.check_declarations()
        if self.function.pure:
            self.check_pure()
        if self.function.alone and any(isinstance(p, Variable) and p.length is not None for p in self.function.inputs):
            self.fail("a function that each element runs alone takes no arrays")
        if self.function.tangent is not None:
            self.check_tangent(self.function.tangent)
        self.check_region(self.function.body)

    def check_tangent(self, name: str) -> None:
        """Check that the rule is a function before this one, of the right types."""
        f, rule = self.function, self.scope.functions.get(name)
        if rule is None:
            self.fail(f"no function {name} before this one is the rule of its tangent")
        if any(isinstance(port, Variable) for port in (*f.inputs, *rule.inputs)):
            self.fail("a function with a rule of its tangent, and the rule, take their inputs by value")
        floats = [port.type for port in f.inputs if port.type.is_float]
        outputs = [v.type for v in f.outputs]
        expected = [*outputs, *(port.type for port in f.inputs), *floats], outputs
        if ([port.type for port in rule.inputs], [v.type for v in rule.outputs]) != expected:
            self.fail(
                f"the rule {name} takes the outputs, the inputs, and a tangent of each input of floats, and gives the "
                f"tangents of the outputs"
            )

    def check_declarations(self) -> None:
        for port in self.function.inputs:
            if isinstance(port, Value):
                self.make(port)
            else:
                self.declare(port)
        for slot in self.function.outputs:
            if slot.length is not None:
                self.fail("an output is no array")
            self.declare(slot)
        for slot in self.function.variables:
            self.anchor = ("variable", self.parent.slots)
            self.parent.slots += 1
            self.declare(slot)

    def check_pure(self) -> None:
        """Check that a pure function has one output and inputs by value; `check_in_pure` checks its statements."""
        if len(self.function.outputs) != 1:
            self.fail(f"a pure function has one output, not {len(self.function.outputs)}")
        if any(isinstance(port, Variable) for port in self.function.inputs):
            self.fail("a pure function takes its inputs by value")

    def declare(self, slot: Variable) -> None:
        if slot.id < 0 or slot.id in self.scope.variables:
            self.fail(f"${slot.id} is declared twice" if slot.id >= 0 else "ids count from 0", slot.loc)
        if slot.length is not None and slot.length < 1:
            self.fail("an array has at least one element", slot.loc)
        if slot.length is not None and slot.length > MAX_ARRAY:
            # Drivers take minutes or crash, since each element that runs at the same time has its own array.
            self.fail(
                f"an array of one element's own has at most {MAX_ARRAY} elements, not {slot.length}",
                slot.loc,
                cure="an sh.Table, for data that all elements share",
            )
        self.scope.variables[slot.id] = slot

    def make(self, value: Value) -> None:
        if value.id < 0 or value.id in self.values:
            self.fail(f"%{value.id} is assigned twice" if value.id >= 0 else "ids count from 0", value.loc)
        self.values.add(value.id)
        self.visible[value.id] = value.type
        self.opened[-1].append(value.id)

    def see(self, id: int) -> Type:
        """Return the type of an operand, which must be visible."""
        type = self.visible.get(id)
        if type is None:
            if id in self.values:
                self.fail(f"%{id} is not visible here", cure="store it in a variable where it is made, and load that")
            self.fail(f"%{id} is not assigned before")
        return type

    # Regions

    def check_region(self, region: Region) -> None:
        """Check the statements; the values that they assign stay visible until `close`."""
        if self.depth > MAX_REGION_DEPTH:
            cure = "put the inner part into a subroutine, or test several conditions in one"
            self.fail(f"regions are nested more than {MAX_REGION_DEPTH} deep", cure=cure)
        ended: Stmt | None = None
        for statement in region:
            self.anchor = ("statement", self.parent.statements)
            self.parent.statements += 1
            self.loc = (statement.value.loc if isinstance(statement, Let) else statement.loc) or self.loc
            if ended is not None:
                self.fail(f"this is never reached: {type(ended).__name__.lower()} is the last of its region")
            if isinstance(statement, Let) and not self.function.pure:  # nearly always
                self.check_let(statement)
                continue
            self.check_statement(statement)
            if isinstance(statement, EXITS):
                ended = statement

    def open(self) -> None:
        self.depth += 1
        self.opened.append([])

    def close(self) -> None:
        self.depth -= 1
        for id in self.opened.pop():
            del self.visible[id]

    def check_nested(self, region: Region) -> None:
        self.open()
        self.check_region(region)
        self.close()

    def check_statement(self, statement: Stmt) -> None:
        if self.function.pure:
            self.check_in_pure(statement)
        match statement:
            case Let():
                self.check_let(statement)
            case Store():
                self.check_store(statement)
            case Call():
                self.check_call(statement)
            case If(condition, then, orelse):
                self.check_condition(condition)
                self.check_nested(then)
                self.check_nested(orelse)
            case Loop():
                self.check_loop(statement)
            case _:
                self.check_exit(statement)

    def check_in_pure(self, statement: Stmt) -> None:
        """Check that a statement is straight-line code, or an If of an `any_lane` without `orelse`."""
        if isinstance(statement, Let) and statement.op in LANE_OPS - {"any_lane"}:
            cure = "any_lane of the opposite" if statement.op == "all_lanes" else None
            self.fail("a pure function asks for any_lane only", cure=cure)
        if isinstance(statement, Let) and statement.op in ("any_lane", "lane_any"):
            self.asking.add(statement.value.id)
        elif isinstance(statement, If) and statement.condition in self.asking and not statement.orelse:
            return
        elif not isinstance(statement, (Let, Store)):
            self.fail(
                "a pure function has no control flow but `if` of an any_lane without `else`, and no call statement"
            )

    def check_condition(self, condition: int) -> None:
        type = self.see(condition)
        if type is not _BOOL:
            self.fail(f"a condition is a b, not {type!r}")

    def check_loop(self, loop: Loop) -> None:
        """Check a loop: `continuing` sees values of the body that no Continue can skip, `until` those of both."""
        anchor: Anchor = ("until", self.anchor[1])
        if self.loops == MAX_LOOP_DEPTH:
            self.fail(f"loops are nested more than {MAX_LOOP_DEPTH} deep", cure="put the inner loops into a subroutine")
        if loop.turns is not None and loop.turns < 0:
            self.fail("a loop cannot take fewer than 0 iterations")
        self.loops += 1
        self.targets += 1
        self.open()
        self.check_region(loop.body)
        if continues(loop):
            self.close()
            self.open()
        self.check_continuing(loop.continuing)
        self.anchor = anchor
        if loop.until is not None:
            self.check_condition(loop.until)
        self.close()
        self.loops -= 1
        self.targets -= 1

    def check_continuing(self, region: Region) -> None:
        outer = self.targets, self.in_continuing
        self.targets, self.in_continuing = 0, True
        self.check_region(region)
        self.targets, self.in_continuing = outer

    def check_exit(self, statement: Stmt) -> None:
        """Refuse an exit from a continuing part, unless it leaves a loop nested in that part."""
        word = type(statement).__name__.lower()
        inner = isinstance(statement, (Break, Continue)) and self.targets > 0
        if self.in_continuing and not inner:
            self.fail(f"{word} leaves the continuing part of a loop, which must run to its end")
        if isinstance(statement, (Break, Continue)) and not inner:
            self.fail(f"{word} stands outside of any loop")

    # Statements

    def check_let(self, let: Let) -> None:
        try:
            args = tuple(map(self.visible.__getitem__, let.args))
        except KeyError:
            args = tuple(map(self.see, let.args))  # fails
        try:
            if let.op in STRUCTURAL:
                expected = structural_type(let, args, self.scope)
            elif let.op not in OPS:
                raise TypeError(f"there is no operation {quote(let.op)}")
            elif let.attr is not None:
                raise TypeError(f"{let.op} takes no attribute, not {let.attr!r}")
            else:
                expected = result_type(let.op, args)
        except TypeError as error:
            self.fail(str(error))
        if let.value.type is not expected:
            self.fail(f"{let.op} gives {expected!r} here, not {let.value.type!r}")
        self.make(let.value)

    def find(self, id: int) -> Variable:
        slot = self.scope.variables.get(id)
        if slot is None:
            self.fail(f"there is no variable ${id}")
        return slot

    def check_store(self, store: Store) -> None:
        slot = self.find(store.variable)
        if (store.index is None) != (slot.length is None):
            told = "is an array: a store needs an index" if slot.length is not None else "is no array: it has no index"
            self.fail(f"${slot.id} {told}")
        if store.index is not None:
            try:
                check_index(f"${slot.id}", self.see(store.index))
            except TypeError as error:
                self.fail(str(error))
        expected = slot.type
        if store.components is not None:
            self.check_components(slot.type, store.components)
            expected = slot.type.sized(len(store.components))
        type = self.see(store.value)
        if type is not expected:
            self.fail(f"${slot.id} takes {expected!r} here, not {type!r}")

    def check_components(self, type: Type, components: tuple[int, ...]) -> None:
        if type.size == 1:
            self.fail(f"a scalar {type!r} is stored as a whole")
        if not components or any(not 0 <= c < type.size for c in components):
            self.fail(f"{type!r} has components 0 to {type.size - 1}, not {components}")
        if len(components) not in SIZES:
            self.fail(f"a store takes one to four components, or eight, not {len(components)}")
        if len(set(components)) != len(components):
            self.fail(f"{components_text(components)} stores a component twice")

    def check_call(self, call: Call) -> None:
        name = quote(call.function)
        callee = self.scope.functions.get(call.function)
        if callee is None:
            cure = "recursion is not possible: use a loop" if call.function == self.function.name else None
            self.fail(f"no function {name} is declared before this one", cure=cure)
        if callee.pure:
            self.fail(f"{name} is pure: it is called by the operation `call`")
        if len(call.args) != len(callee.inputs):
            self.fail(f"{name} takes {counted(len(callee.inputs), 'argument')}, not {len(call.args)}")
        by_reference: set[int] = set()
        for port, arg in zip(callee.inputs, call.args, strict=True):
            if isinstance(port, Variable):
                self.check_reference(name, port, arg)
                if arg in by_reference:
                    self.fail(f"${arg} is passed by reference twice", cure="copy it into another variable first")
                by_reference.add(arg)
            elif self.see(arg) is not port.type:
                self.fail(f"{name} takes {port.type!r} here, %{arg} is {self.see(arg)!r}")
        expected, actual = (tuple(v.type for v in vs) for vs in (callee.outputs, call.results))
        if expected != actual:
            self.fail(f"{name} gives {spoken_types(expected)}, not {spoken_types(actual)}")
        for value in call.results:
            self.make(value)

    def check_reference(self, name: str, port: Variable, arg: int) -> None:
        slot = self.find(arg)
        if (slot.type, slot.length) != (port.type, port.length):
            self.fail(f"{name} takes a variable of {_shape(port)} here, ${arg} is of {_shape(slot)}")


def _shape(slot: Variable) -> str:
    return f"{slot.type!r}" if slot.length is None else f"{slot.type!r}[{slot.length}]"
