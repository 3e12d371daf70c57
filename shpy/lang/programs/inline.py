"""Calling a program from a program: its recorded IR goes into the recording under way, its inputs by value.

Stage: record. A program without an early return is spliced in statement by statement; any other becomes a function of
the caller's module. Params and tables keep their identity; table inputs become the tables that they are given.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import chain, count
from typing import Any

from shpy.errors import ShpyTypeError
from shpy.ir.constants import encode
from shpy.ir.nodes import Call, Function, If, Let, Loop, Region, Return, Stmt, Value
from shpy.ir.traverse import Copy, defined, is_straight, regions_of, rewrite, walk
from shpy.lang.data.params import Param
from shpy.lang.data.tables import Table, TableType, fits
from shpy.lang.data.textures import Texture2D, TextureType
from shpy.lang.programs.record import RecordedProgram
from shpy.lang.recording.emit import Node, replay
from shpy.lang.recording.location import here
from shpy.lang.recording.recorder import Frame, Recording, need_frame
from shpy.lang.values import arithmetic
from shpy.lang.values.dependent import Dependent
from shpy.lang.values.snapshot import Same
from shpy.lang.values.structure import built, flatten, leaves, spoken_type

Constants = Mapping[Same, tuple[int, ...]]
"""Constants by the Param or dependent uniform that they replace."""


def call_recorded(recorded: RecordedProgram, arguments: Mapping[str, Any], constants: Constants | None = None) -> Any:
    """Record a call of `recorded` with values for its inputs; `constants` fixes uniforms."""
    frame = need_frame("a call of a program")
    names = _Names(frame.recording, recorded, arguments, constants or {})
    functions = {f.name: f for f in (names.function(f) for f in recorded.module.functions[:-1])}
    for function in functions.values():
        if all(function is not other for other in frame.recording.functions):
            frame.recording.functions.append(function)
    entry = names.body(recorded.module.entry)
    args: list[int] = []
    for name, type_ in recorded.inputs.items():
        if isinstance(type_, TableType | TextureType):
            continue
        entries = flatten(type_, arguments[name], name)
        for entry_value, (leaf, _, cls) in zip(entries, leaves(type_, name), strict=True):
            args.append(arithmetic.convert(frame, entry_value, cls.type, f"the input {leaf}"))
    results = _splice(frame, entry, args) if _can_splice(frame, entry) else _call(frame, entry, args)
    return built(frame, recorded.output, results)


@dataclass
class _Names:
    """New names in the caller's module for the functions, params and tables of the called one."""

    recording: Recording
    recorded: RecordedProgram
    arguments: Mapping[str, Any]
    constants: Constants

    def __post_init__(self) -> None:
        self.functions: dict[str, str] = {}
        self.tables: dict[str, str] = {}
        self.modes: dict[str, Any] = {}
        for name, type_ in self.recorded.inputs.items():
            if isinstance(type_, TableType):
                table = self.arguments[name]
                if not isinstance(table, Table) or not fits(table, type_):
                    raise ShpyTypeError(
                        f"the input {name} is a Table[{type_.cls.__name__}, {type_.rank}]",
                        loc=here(),
                        cure=f"sh.Table(array, {spoken_type(type_.cls)})",
                    )
                for leaf, part in table.leaves(name).items():
                    if leaf == name or any(leaf == declared.name for declared in self.recorded.module.tables):
                        self.tables[leaf] = part._declared(self.recording.frame)
            elif isinstance(type_, TextureType):
                texture = self.arguments[name]
                if not isinstance(texture, Texture2D) or texture.type.type is not type_.cls.type:
                    raise ShpyTypeError(
                        f"the input {name} is a Texture2D[{type_.cls.__name__}]", loc=here(), cure="sh.Texture2D(array)"
                    )
                self.tables[name] = texture.table._declared(self.recording.frame)
                self.modes[f"{name}.mode"] = texture.mode
        for name, table in self.recorded.tables.items():
            if not table.is_argument:
                self.tables[name] = table._declared(self.recording.frame)

    def function(self, function: Function) -> Function:
        """Return the function under a name that no other has, with its names replaced; made once for one recording."""
        modes = tuple((name, Same(mode) if isinstance(mode, Param) else mode) for name, mode in self.modes.items())
        bound = tuple(self.tables.items()), tuple(self.constants.items()), modes
        key = ("inlined", Same(self.recorded), function.name, bound)
        definition = self.recording.subroutines.get(key)
        if definition is None:
            name = self.recording.function_name(function.name)
            rule = None if function.tangent is None else self.functions[function.tangent]
            definition = replace(self.body(function), name=name, tangent=rule)
            self.recording.subroutines[key] = definition
        self.functions[function.name] = definition.name
        result: Function = definition
        return result

    def body(self, function: Function) -> Function:
        """Return the function with the names in its statements replaced."""
        self.fresh = count(max((v.id for v in defined(function)), default=-1) + 1)
        return replace(function, body=rewrite(function.body, self._statement))

    def _statement(self, statement: Stmt) -> Stmt | list[Stmt]:
        match statement:
            case Let(value, "grid_index" | "grid_shape"):
                self._check_rank(value)
            case Let(_, "table" | "table_size", _, str(name)):
                return replace(statement, attr=self.tables[name])
            case Let(value, "param", _, str(name)):
                mode = self.modes.get(name)
                if mode is not None and not isinstance(mode, Param):
                    return Let(value, "const", (), encode(value.type, [mode]))
                return self._uniform(value, mode if mode is not None else self.recorded.params[name])
            case Let(_, "call", _, str(name)):
                return replace(statement, attr=self.functions[name])
            case Call(name):
                return replace(statement, function=self.functions[name])
        return statement

    def _check_rank(self, value: Value) -> None:
        """Raise ShpyTypeError if the caller needs elements with another number of axes."""
        axes = value.type.size
        if (other := self.recording.other_rank(axes, value.loc)) is not None:
            raise ShpyTypeError(
                f"{self.recorded.module.name} takes elements of {axes} axes ({value.loc}), and {other.loc} takes "
                f"{other.axes}",
                loc=here(),
                cure=f"sh.grid_index({other.axes}) there, or inputs in place of sh.grid_index({axes})",
            )

    def _uniform(self, value: Value, uniform: Any) -> Stmt | list[Stmt]:
        """Return the source of a uniform's value: a constant, the uniform itself, or its expression."""
        if Same(uniform) in self.constants:
            return Let(value, "const", (), self.constants[Same(uniform)])
        if isinstance(uniform, Dependent) and any(Same(source) in self.constants for source in uniform.sources):
            return self._expression(value, uniform.root)
        return Let(value, "param", (), self.recording.use("param", self.recording.params, uniform))

    def _expression(self, value: Value, root: Node) -> list[Stmt]:
        """Record the operations of a dependent uniform, some of whose sources are constants."""
        statements: list[Stmt] = []

        def let(node: Node, args: tuple[int, ...]) -> int:
            target = value if node is root else Value(next(self.fresh), node.type, None, value.loc)
            if node.op == "param":
                statement = self._uniform(target, node.source)
                statements.extend(statement if isinstance(statement, list) else [statement])
            else:
                attr = node.source._declared(self.recording.frame) if node.op == "table" else node.attr
                statements.append(Let(target, node.op, args, attr))
            return target.id

        replay(root, let)
        return statements


def _can_splice(frame: Frame, entry: Function) -> bool:
    arrays = any(v.length is not None for v in entry.variables)
    returns = any(isinstance(s, Return) for s in walk(entry.body))
    depth, loops = _depths(entry.body)
    fits = frame.scope.depth + depth < 60 and frame.scope.loops + loops <= 12
    return fits and not returns and not (arrays and frame.scope.loops)


def _depths(region: Region) -> tuple[int, int]:
    depth = loops = 0
    for statement in region:
        if isinstance(statement, If | Loop):
            d, n = _depths(tuple(chain(*regions_of(statement))))
            depth, loops = max(depth, d + 1), max(loops, n + isinstance(statement, Loop))
    return depth, loops


def _call(frame: Frame, entry: Function, args: list[int]) -> list[int]:
    """Call the entry as a function of the caller's module."""
    name = frame.recording.function_name(entry.name)
    pure = is_straight(entry.body) and len(entry.outputs) == 1
    function = replace(entry, name=name, pure=pure)
    frame.recording.functions.append(function)
    return frame.call(function, tuple(args), names=True)


def _splice(frame: Frame, entry: Function, args: list[int]) -> list[int]:
    """Put the entry's statements into the open region, with fresh ids; return the values of its outputs."""
    copy = Copy(frame.new_value, {f.name: f for f in frame.recording.functions})
    for v in (*entry.variables, *entry.outputs):
        copy.slots[v.id] = slot = frame.variable(v.type, v.length, name=v.name or "", loc=v.loc)
        frame.names[slot] = v.name
        if frame.scope.loops and v.length is None:
            # A slot is zero when its function starts, so in a loop it is set to zero in each iteration.
            frame.store(slot, frame.const(v.type, (0,) * v.type.size))
    copy.values.update({port.id: arg for port, arg in zip(entry.inputs, args, strict=True)})
    for statement in copy.region(entry.body):
        frame.append(statement)
    return [frame.let("load", (), output.type, copy.slots[output.id]) for output in entry.outputs]
