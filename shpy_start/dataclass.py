"""`dataclass` of the standard library, without code to compile when a class is imported.

`dataclasses` writes up to six methods of each class as text and compiles them, whether or not a process ever makes an
instance. Here `__init__` is written when it is first looked up, and the other methods are closures. With slots, a
frozen instance is filled through them, in half of the time that `object.__setattr__` takes. `import shpy` takes 0.09 s
of CPU beyond numpy's for 0.17, `import raytracer` 0.21 for 0.28.

    @dataclass(frozen=True, slots=True)
    class Loc:
        file: str
        line: int
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable
from operator import attrgetter
from reprlib import recursive_repr
from typing import TYPE_CHECKING, Any

_FACTORY: Any = type("_Factory", (), {"__repr__": lambda self: "<factory>"})()
"""The default of a parameter whose field has a factory."""


def _lazy_dataclass(cls: type | None = None, /, **options: bool) -> Any:
    """Make a dataclass as `dataclasses.dataclass` does, with the options frozen, eq, slots, weakref_slot and kw_only.

    A class without a docstring, which gets its signature as one, and a class that extends a dataclass are left to the
    standard library.
    """

    def decorate(cls: type) -> type:
        extends = any(hasattr(base, "__dataclass_fields__") for base in cls.__bases__)
        if extends or not cls.__doc__:
            return dataclasses.dataclass(**options)(cls)
        return _decorated(cls, **options)

    return decorate if cls is None else decorate(cls)


if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:
    dataclass = _lazy_dataclass


def _decorated(cls: type, *, frozen: bool = False, eq: bool = True, slots: bool = False, **layout: bool) -> type:
    own = cls.__dict__
    hashes = "__hash__" in own and not (own["__hash__"] is None and "__eq__" in own)
    cls = dataclasses.dataclass(init=False, repr=False, eq=False, slots=slots, **layout)(cls)
    fields = dataclasses.fields(cls)
    params: Any = cls.__dataclass_params__  # type: ignore[attr-defined]
    params.init, params.repr, params.eq, params.frozen = True, True, eq, frozen
    _add(cls, "__repr__", _repr([f.name for f in fields if f.repr]))
    if "__init__" not in cls.__dict__:
        cls.__init__ = _Initializer(cls, fields, frozen, slots)  # type: ignore[misc]
    if eq:
        _add(cls, "__eq__", _equality(_values([f.name for f in fields if f.compare])))
        if not hashes:
            hashed = [f.name for f in fields if (f.compare if f.hash is None else f.hash)]
            cls.__hash__ = _hash(_values(hashed)) if frozen else None  # type: ignore[assignment]
    if frozen:
        _freeze(cls, frozenset(f.name for f in fields))
        if slots:
            _add_state(cls, [f.name for f in fields])
    return cls


def _add(cls: type, name: str, method: Any) -> None:
    """Give a class a method, unless it defines its own."""
    if name not in cls.__dict__:
        method.__qualname__ = f"{cls.__qualname__}.{name}"
        setattr(cls, name, method)


def _values(names: list[str]) -> Callable[[Any], tuple[Any, ...]]:
    """Return a function that gives the tuple of these attributes of an object."""
    if not names:
        return lambda x: ()
    get = attrgetter(*names)
    return get if len(names) > 1 else lambda x: (get(x),)


def _equality(values: Callable[[Any], tuple[Any, ...]]) -> Any:
    def __eq__(self: Any, other: object) -> Any:
        if other.__class__ is self.__class__:
            return values(self) == values(other)
        return NotImplemented

    return __eq__


def _hash(values: Callable[[Any], tuple[Any, ...]]) -> Any:
    def __hash__(self: Any) -> int:
        return hash(values(self))

    return __hash__


def _repr(names: list[str]) -> Any:
    @recursive_repr()
    def __repr__(self: Any) -> str:
        return f"{self.__class__.__qualname__}({', '.join(f'{name}={getattr(self, name)!r}' for name in names)})"

    return __repr__


def _freeze(cls: type, names: frozenset[str]) -> None:
    """Let a class refuse to set and to delete its fields."""

    def __setattr__(self: Any, name: str, value: Any) -> None:
        if type(self) is cls or name in names:
            raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")
        super(cls, self).__setattr__(name, value)  # type: ignore[arg-type]

    def __delattr__(self: Any, name: str) -> None:
        if type(self) is cls or name in names:
            raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")
        super(cls, self).__delattr__(name)  # type: ignore[arg-type]

    _add(cls, "__setattr__", __setattr__)
    _add(cls, "__delattr__", __delattr__)


def _add_state(cls: type, names: list[str]) -> None:
    """Let pickle fill frozen instances, whose slots it cannot set."""

    def __getstate__(self: Any) -> list[Any]:
        return [getattr(self, name) for name in names]

    def __setstate__(self: Any, state: list[Any]) -> None:
        for name, value in zip(names, state, strict=True):
            object.__setattr__(self, name, value)

    _add(cls, "__getstate__", __getstate__)
    _add(cls, "__setstate__", __setstate__)


class _Initializer:
    """The `__init__` of a class until it is looked up: the function replaces it."""

    def __init__(self, cls: type, fields: tuple[dataclasses.Field[Any], ...], frozen: bool, slots: bool) -> None:
        self.cls, self.fields, self.frozen, self.slots = cls, fields, frozen, slots

    def __get__(self, instance: object, owner: type) -> Any:
        """Write the function, and return it or its method of an instance."""
        function = self.cls.__dict__["__init__"]
        if function is self:  # no other thread was faster
            function = self.cls.__init__ = self.function()
        return function.__get__(instance, owner)

    def function(self) -> Any:
        """Return the function, as `dataclasses` would write it."""
        cls, fields = self.cls, self.fields
        names: dict[str, Any] = {"_set": object.__setattr__, "_FACTORY": _FACTORY}
        positional, named = (
            [self.parameter(f, names) for f in fields if f.init and f.kw_only is keyword] for keyword in (False, True)
        )
        lines = [line for f in fields if (line := self.line(f, names))]
        if hasattr(cls, "__post_init__"):
            lines.append("self.__post_init__()")
        parameters = ", ".join(["self", *positional, *(["*", *named] if named else [])])
        body = "\n  ".join(lines or ["pass"])
        text = f"def _make({', '.join(names)}):\n def __init__({parameters}):\n  {body}\n return __init__"
        scope: dict[str, Any] = {}
        exec(text, vars(sys.modules[cls.__module__]), scope)  # "<string>", as frames of `dataclasses` are
        function = scope["_make"](**names)
        function.__qualname__ = f"{cls.__qualname__}.__init__"
        function.__annotations__ = {f.name: f.type for f in fields if f.init} | {"return": None}
        return function

    def parameter(self, field: dataclasses.Field[Any], names: dict[str, Any]) -> str:
        """Return the text of a field's parameter; enter its default in `names`."""
        if field.default_factory is not dataclasses.MISSING:
            return f"{field.name}=_FACTORY"
        if field.default is dataclasses.MISSING:
            return field.name
        names[f"_default_{field.name}"] = field.default
        return f"{field.name}=_default_{field.name}"

    def line(self, field: dataclasses.Field[Any], names: dict[str, Any]) -> str:
        """Return the statement that fills a field, "" for a field without a value; enter what it needs in `names`."""
        value = name = field.name
        if field.default_factory is not dataclasses.MISSING:
            names[f"_make_{name}"] = field.default_factory
            value = f"_make_{name}() if {name} is _FACTORY else {name}" if field.init else f"_make_{name}()"
        elif not field.init:
            if field.default is dataclasses.MISSING or not self.slots:
                return ""
            names[value := f"_default_{name}"] = field.default
        if not self.frozen:
            return f"self.{name} = {value}"
        if not self.slots:
            return f"_set(self, {name!r}, {value})"
        names[f"_set_{name}"] = self.cls.__dict__[name].__set__
        return f"_set_{name}(self, {value})"
