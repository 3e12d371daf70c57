"""Subroutines: functions that stay functions in the emitted text.

Stage: record. `@sh.subroutine` records its function once in a program for all calls that would record the same.
Arguments come by reference: the caller sees the function's stores. Outside a program it is called as it is.

    @sh.subroutine
    def advance(p: sh.Point3f, v: sh.Vector3f):
        p += v
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Collection, Hashable
from contextlib import nullcontext
from dataclasses import replace
from typing import Any, ClassVar

from shpy.errors import RecordError, ShpyTypeError
from shpy.ir.nodes import Call, Function, Loc, Store, Value as IrValue, Variable
from shpy.ir.traverse import is_straight, walk
from shpy.lang.functions.array import Array
from shpy.lang.functions.returns import Returns
from shpy.lang.recording.location import at, here, in_library, is_library, on_one_line
from shpy.lang.recording.recorder import Frame, Recording, current
from shpy.lang.recording.signature import bodies_of, hints_of, loc_of, return_loc
from shpy.lang.recording.tree import in_one_statement
from shpy.lang.values import arithmetic
from shpy.lang.values.coerce import literal, sequence
from shpy.lang.values.matrix import Matrix
from shpy.lang.values.snapshot import snapshot
from shpy.lang.values.structure import (
    Layout,
    Leaf,
    build_values,
    built,
    is_value,
    layout_from,
    layout_of,
    leaves,
    leaves_of,
)
from shpy.lang.values.value import CLASSES, Value


class Subroutine:
    """A function of the language that the emitted text has as a function. Call it with values.

    Raises RecordError for recursion, and for one variable given for two parameters that are both written.
    """

    _is_subroutine: ClassVar[bool] = True

    def __init__(self, function: Callable[..., Any], name: str | None = None, *, alone: bool = False) -> None:
        functools.update_wrapper(self, function)
        self.function = function
        self.name: str = name or str(getattr(function, "__name__", "subroutine"))
        self.signature = inspect.signature(function)
        self.alone = alone
        self._rule: Subroutine | None = None
        self._hints: dict[str, Any] | None = None
        self._loc = loc_of(function)
        self._is_library = self._loc is not None and is_library(self._loc)

    def __get__(self, instance: Any, owner: Any = None) -> Any:
        """Bind a method: each instance has its own recording."""
        return self if instance is None else functools.partial(self, instance)

    def __call__(self, *args: Any, **named: Any) -> Any:
        """Record a call; outside a program, just call the function."""
        recording = current()
        if recording is None:
            return self.function(*args, **named)
        try:
            bound = self.signature.bind(*args, **named)
        except TypeError as error:
            called = f"{self.name}({', '.join(self.signature.parameters)})"
            raise ShpyTypeError(f"{self.name}: {error}", loc=here(), cure=called) from None
        bound.apply_defaults()
        if self._hints is None:
            self._hints = hints_of(self.function)
        arguments = {name: self._argument(recording.frame, name, value) for name, value in bound.arguments.items()}
        key = self._key(arguments)
        recorded = recording.subroutines.get(key) if key is not None else None
        if recorded is None:
            if any(other is self.function for other in recording.underway):
                raise RecordError(
                    f"{self.name} calls itself: recursion cannot be recorded",
                    loc=here(),
                    cure="a loop, with an sh.Array as the stack",
                )
            recorded = self._record(recording, arguments)
            if key is not None and key == self._key(arguments):  # the recording changed nothing that it read
                recording.subroutines[key] = recorded
        converted = {name for name, value in arguments.items() if self._is_converted(value, bound.arguments[name])}
        return recorded.call(recording.frame, arguments, converted)

    def tangent(self, rule: Callable[..., Any]) -> Callable[..., Any]:
        """Make a function the rule by which derivatives of this subroutine are computed; return it.

        The rule takes the result, all arguments, and a tangent of each argument of floats, in this order. It returns
        the tangent of the result, which has to be linear in the tangents. Derivatives call it and leave the body of the
        subroutine alone, so a solver is differentiated at its solution and not step by step:

            @sh.subroutine
            def root(c: sh.Attrib1f) -> sh.Attrib1f: ...      # x with x**3 + x = c, by Newton's method

            @root.tangent
            def root_tangent(x, c, d_c):
                return d_c / (3 * x * x + 1)

        A Point has a Vector as its tangent. Reverse mode takes rules whose conditions do not depend on tangents, and
        which compute with these by sums, and products with other values. `sh.accuracy.roundings` differentiates the
        body.

        Raises ShpyTypeError for anything but a function; where the subroutine is recorded, for a rule with other
        parameters or another result, and for arguments or results that have no tangent.
        """
        if not callable(rule):
            raise ShpyTypeError(
                f"{self.name}.tangent takes a function", loc=here(), cure=f"@{self.name}.tangent above a def"
            )
        self._rule = Subroutine(rule)
        return rule

    def _key(self, arguments: dict[str, Any]) -> Hashable | None:
        """Return the key of the recording for a call: the types of values, and snapshots of all other objects read.

        Returns None if an object has no snapshot: the function is then recorded for each call.
        """
        kinds = tuple((name, _kind(value)) for name, value in arguments.items())
        hosts = [value for (_, kind), value in zip(kinds, arguments.values(), strict=True) if kind is None]
        own = () if self._is_library else (self.function, *([self._rule.function] if self._rule else ()))
        seen = snapshot(*own, *hosts)
        return None if seen is None else (self, kinds, seen)

    def _argument(self, frame: Frame, name: str, value: Any) -> Any:
        """Return a value or a number as its parameter's annotation says.

        A value whose type differs is converted, as an input of a program is: it widens, or a scalar fills a vector.
        A parameter without a value's type takes any object, and every parameter takes its own default.
        """
        assert self._hints is not None
        hint = self._hints.get(name)
        if not isinstance(hint, type) or not issubclass(hint, Value | Matrix):
            return value
        if literal(value) is not None or sequence(value) is not None:
            return hint(value)
        if isinstance(value, hint) or value is self.signature.parameters[name].default:
            return value
        if not isinstance(value, Value) or not issubclass(hint, Value):
            text = f"{name} of {self.name} takes {hint.__name__}, not {type(value).__name__}"
            cure = f"sh.{hint.__name__}(…); or {name} without an annotation, which takes any object"
            raise ShpyTypeError(text, loc=here(), cure=cure)
        if value.type is hint.type:
            return _of_kind(hint, value)
        handle = arithmetic.convert(frame, value, hint.type, f"{name} of {self.name}")
        return arithmetic.make_value(hint.kind, hint.type, frame, handle)

    @staticmethod
    def _is_converted(value: Any, argument: Any) -> bool:
        """Return whether an argument is a copy of another type, not the variable of the value that was given."""
        return isinstance(argument, Value) and isinstance(value, Value) and value.type is not argument.type

    def _record(self, recording: Recording, arguments: dict[str, Any]) -> RecordedSubroutine:
        frame = Frame(recording, recording.function_name(self.name), self._loc)
        hints = self._hints or {}
        hint = hints.get("return")
        layout = layout_of(hint, "what it gives back") if hint not in (None, type(None), Any) else None
        frame.returned = Returns(frame, layout, self.name, bodies_of(self.function))
        recording.frames.append(frame)
        recording.underway.append(self.function)
        try:
            inside = {name: _parameter(frame, name, value) for name, value in arguments.items()}
            with in_library() if self._is_library else nullcontext():
                result = self.function(**_restore(self.signature, inside))
            with at(return_loc(self.function)):
                frame.returned.finish(result)
        finally:
            recording.frames.pop()
            recording.underway.pop()
        recorded = RecordedSubroutine(frame, inside, alone=self.alone)
        if self._rule is not None:
            recording.underway.append(self.function)
            try:
                rule = self._record_rule(self._rule, recorded, recording, arguments)
            finally:
                recording.underway.pop()
            recorded.function = replace(recorded.function, tangent=rule.name)
        original: RecordedSubroutine = recording.subroutines.setdefault((self.name, *recorded.content()), recorded)
        if original is recorded:
            recording.functions.append(recorded.function)
        else:
            recording.function_names.discard(frame.name)
        return original

    def _record_rule(
        self, rule: Subroutine, recorded: RecordedSubroutine, recording: Recording, arguments: dict[str, Any]
    ) -> Function:
        """Record the rule for the types of the arguments and the result."""
        if any(recorded.by_reference):
            raise ShpyTypeError(
                f"{self.name} has a rule of its tangent, and stores into its arguments or takes an array",
                loc=self._loc,
                cure=f"x.copy() in {self.name}, or values in place of the array",
            )
        layouts = {name: layout_from(x, name) for name, x in arguments.items() if is_value(x)}
        moving = {name: layout for name, layout in layouts.items() if _has_floats(self.name, layout, name, self._loc)}
        if recorded.layout is None or not _has_floats(self.name, recorded.layout, "its result", self._loc):
            raise ShpyTypeError(f"the result of {self.name} has no tangent", loc=self._loc, cure="a result of floats")
        expected = ["result", *arguments, *(f"d_{name}" for name in moving)]
        names = list(rule.signature.parameters)
        if len(names) != len(expected):
            raise ShpyTypeError(
                f"the rule {rule.name} takes the result of {self.name}, its arguments, and a tangent of each argument "
                f"of floats: {len(expected)} parameters, not {len(names)}",
                loc=rule._loc,
                cure=f"def {rule.name}({', '.join(expected)}):",
            )
        scratch = Frame(recording, rule.name, rule._loc)
        values = [_placeholder(scratch, recorded.layout), *arguments.values()]
        values += [_placeholder(scratch, layout, tangent=True) for layout in moving.values()]
        result = rule._record(recording, dict(zip(names, values, strict=True)))
        types = [v.type for v in recorded.function.outputs]
        if [v.type for v in result.function.outputs] != types or any(result.by_reference):
            spoken = ", ".join(map(str, types))
            raise ShpyTypeError(
                f"the rule {rule.name} stores into its parameters"
                if any(result.by_reference)
                else f"the rule {rule.name} returns something else than {self.name}, whose result consists of {spoken}",
                loc=rule._loc,
                cure="the tangent of the result, from copies",
            )
        return result.function


def _has_floats(name: str, layout: Layout, path: str, loc: Loc | None) -> bool:
    """Return whether an argument or a result consists of floats; ShpyTypeError for one of both floats and others."""
    floats = [cls.type.is_float for _, _, cls in leaves(layout, "")]
    if any(floats) and not all(floats):
        raise ShpyTypeError(
            f"{name} has a rule of its tangent, and {path} has floats and ints",
            loc=loc,
            cure="two structs in place of it",
        )
    return all(floats)


def _placeholder(frame: Frame, layout: Layout, *, tangent: bool = False) -> Any:
    """Return an object of a layout; the tangent of a Point is a Vector."""
    if tangent and isinstance(layout, Leaf) and layout.cls.kind == "Point":
        layout = Leaf(CLASSES["Vector", layout.cls.size, layout.cls.type.base])
    classes = [cls for _, _, cls in leaves(layout, "")]
    return build_values(layout, iter([_slot_value(frame, cls, "", frame.loc) for cls in classes]))


def _restore(signature: inspect.Signature, inside: dict[str, Any]) -> dict[str, Any]:
    if any(p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD, p.POSITIONAL_ONLY) for p in signature.parameters.values()):
        raise RecordError("a subroutine names its parameters one by one", loc=here(), cure="def f(a, b):")
    return inside


def _kind(value: Any) -> Hashable | None:
    """Return the type of a value or array of the language; None for a host object."""
    if isinstance(value, Array):
        return value._layout, len(value)
    return layout_from(value, "argument") if is_value(value) else None


def _parameter(frame: Frame, name: str, value: Any) -> Any:
    """Return an object with fresh slots, which represents an argument inside the function."""
    loc = frame.loc
    if isinstance(value, Array):
        slots = [
            frame.variable(cls.type, len(value), name=f"{name}_{suffix}" if suffix else name, loc=loc)
            for suffix, _, cls in leaves(value._layout, "")
        ]
        return Array._of(frame, value._layout, len(value), slots)
    if not is_value(value):
        return value
    layout = layout_from(value, name)
    parts = [_slot_value(frame, cls, part, loc) for part, _, cls in leaves(layout, name)]
    return build_values(layout, iter(parts))


def input_value(frame: Frame, layout: Layout, name: str, loc: Loc | None) -> tuple[Any, list[IrValue]]:
    """Return a value of a layout in variables, into which new inputs are stored; and these inputs."""
    inputs, parts = [], []
    for leaf, _, cls in leaves(layout, name):
        inputs.append(frame.new_value(cls.type, leaf, loc))
        parts.append(_slot_value(frame, cls, leaf, loc))
        frame.append(Store(parts[-1]._variable, inputs[-1].id, None, None, loc))
    return build_values(layout, iter(parts)), inputs


def _slot_value(frame: Frame, cls: type[Value], name: str, loc: Loc | None) -> Value:
    value = object.__new__(cls)
    slot = frame.variable(cls.type, name=name, loc=loc)
    for attribute, start in (("_frame", frame), ("_variable", slot), ("_const", ()), ("_part", None), ("_loc", loc)):
        object.__setattr__(value, attribute, start)
    return value


def _of_kind(cls: type[Value], value: Value) -> Value:
    """Return the same variable or constant under another kind."""
    other = object.__new__(cls)
    for attribute in ("_frame", "_variable", "_const", "_part", "_loc"):
        object.__setattr__(other, attribute, getattr(value, attribute))
    return other


class RecordedSubroutine:
    """A subroutine recorded for one program: its function, and how each argument is passed."""

    def __init__(self, frame: Frame, inside: dict[str, Any], *, alone: bool = False) -> None:
        returns: Returns = frame.returned
        body = frame.scopes[0].statements
        written = _written(frame)
        self.layout: Layout | None = returns.layout
        self.by_reference: list[bool] = []
        self.stored: list[bool] = []
        inputs: list[IrValue | Variable] = []
        copies: list[Any] = []
        for name, value in inside.items():
            if alone and isinstance(value, Array):
                cure = "its elements as parameters of their own"
                raise RecordError(
                    f"{frame.name} is run by each element alone and takes no arrays", loc=here(), cure=cure
                )
            for slot in map(_slot, _leaves(value)):
                variable = frame.named(frame.variables[slot])
                reference = slot in written or variable.length is not None
                self.by_reference.append(reference)
                self.stored.append(slot in written)
                if reference:
                    inputs.append(variable)
                else:
                    incoming = frame.new_value(variable.type, variable.name or name, frame.loc)
                    inputs.append(incoming)
                    copies.append(Store(slot, incoming.id, None, None, frame.loc))
        body[:0] = copies
        pure = is_straight(body) and len(returns.slots) == 1 and not any(self.by_reference) and not alone
        self.function: Function = replace(frame.finish(tuple(inputs), tuple(returns.slots), pure), alone=alone)

    def content(self) -> tuple[Hashable, ...]:
        """Return everything but the name; recordings with equal contents share one function."""
        return self.layout, self.function.loc, replace(self.function, name="")

    @on_one_line
    def call(self, frame: Frame, arguments: dict[str, Any], converted: Collection[str]) -> Any:
        """Record a call from `frame`; return the function's result. Arguments in `converted` cannot be stored into."""
        results = frame.call(self.function, tuple(self._arguments(frame, arguments, converted)))
        return None if self.layout is None else built(frame, self.layout, results)

    def _arguments(self, frame: Frame, arguments: dict[str, Any], converted: Collection[str]) -> list[int]:
        passed = [(name, leaf) for name, value in arguments.items() for leaf in _leaves(value)]
        for (name, leaf), stored in zip(passed, self.stored, strict=True):
            if stored and name in converted:
                raise RecordError(
                    f"{self.function.name} stores into {name}, which is given a value of another type: it is "
                    "converted, so the store would be lost",
                    loc=here(),
                    cure=f"a value of its own: x = sh.{type(leaf).__name__}(…), then {self.function.name}(x)",
                )
        args = [
            self._reference(frame, leaf, name, arguments[name]) if reference else int(leaf._read(frame))
            for (name, leaf), reference in zip(passed, self.by_reference, strict=True)
        ]
        self._check_apart(passed)
        return args

    def _check_apart(self, passed: list[tuple[str, Any]]) -> None:
        """Raise RecordError for one variable given for two parameters, unless both are only read.

        A parameter that is only read is passed by value, so it would not see what is stored through the other one.
        """
        slots = [_slot(leaf) for _, leaf in passed]
        shared = ((k, j) for k, slot in enumerate(slots) for j in range(k) if slots[j] == slot)
        for k, j in shared:
            if not (self.by_reference[k] or self.by_reference[j]):
                continue
            function, stored = self.function.name, [passed[n][0] for n in (j, k) if self.stored[n]]
            done = f"and {function} stores into {stored[0]}" if stored else f"which {function} takes by reference"
            if len(stored) == 2:
                done = f"which {function} both stores into"
            raise RecordError(
                f"one variable is given for {passed[j][0]} and {passed[k][0]}, {done}",
                loc=here(),
                cure="a copy for one of them: x.copy()",
            )

    def _reference(self, frame: Frame, leaf: Any, name: str, argument: Any) -> int:
        if isinstance(leaf, int):
            slot = leaf
        else:
            if leaf._frame is None:
                own = f"sh.{type(leaf).__name__}(…)" if argument is leaf else "y.copy()"
                raise RecordError(
                    f"{self.function.name} stores into {name}, which is given a constant",
                    loc=here(),
                    cure=f"a value of its own: x = {own}, then {self.function.name}(x)",
                )
            leaf._check(frame)
            slot = leaf._variable
            if leaf._part is not None and frame.names[slot] is None and _is_temporary(argument, leaf):
                part = _source(argument, leaf)
                back = "" if leaf._part.owner == "constant" else f" first, and {part} = x after the call"
                raise RecordError(
                    f"{self.function.name} stores into {name}, which is given {part}, a copy",
                    loc=here(),
                    cure=f"x = {part}{back}",
                )
        return slot


def _source(argument: Any, leaf: Value) -> str:
    """Return the name of the source that an argument is a copy of; `leaf` is the argument, or a part of it."""
    assert leaf._part is not None
    if argument is leaf:
        return leaf._part.name
    paths = (path for path, _, _ in leaves(layout_from(argument, ""), ""))
    path = next(path for path, part in zip(paths, leaves_of(argument), strict=True) if part is leaf)
    return leaf._part.name.removesuffix(path).removesuffix(".")


def _is_temporary(argument: Any, leaf: Value) -> bool:
    """Return whether an argument without a name of its own is a part that the call itself reads.

    Lines name values. They name no leaf of a struct or matrix, and without source text nothing: then a part that an
    earlier statement read is one that the user keeps.
    """
    loc = here()
    named = isinstance(argument, Value) and loc is not None and loc.text is not None
    return named or in_one_statement(leaf._loc, loc)


def _leaves(value: Any) -> list[Any]:
    """Return the leaves of an argument: values, or the slots of an array; none for host objects."""
    if isinstance(value, Array):
        return list(value._variables)
    return leaves_of(value) if is_value(value) else []


def _slot(leaf: Any) -> int:
    return int(leaf if isinstance(leaf, int) else leaf._variable)


def _written(frame: Frame) -> set[int]:
    slots: set[int] = set()
    for statement in walk(tuple(frame.scopes[0].statements)):
        if isinstance(statement, Store):
            slots.add(statement.variable)
        elif isinstance(statement, Call):
            slots |= frame.recording.referenced(statement)
    return slots


def subroutine(function: Callable[..., Any] | None = None, *, alone: bool = False) -> Any:
    """Make a function of the language one that stays a function in the emitted text, its arguments by reference.

    With `alone`, each lane of an OpenCL packet runs it by itself, or two of them in turns: that is faster where lanes
    would take different branches and read different elements of tables. The results are the same; it takes no
    `sh.Array`.

    Raises ShpyTypeError for anything but a function.
    """
    if function is None:
        return functools.partial(subroutine, alone=alone)
    if not callable(function):
        raise ShpyTypeError("sh.subroutine takes a function", loc=here(), cure="@sh.subroutine above a def")
    return Subroutine(function, alone=alone)
