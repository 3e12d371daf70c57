"""Programs that are methods, recorded for each instance at the first access.

Stage: record. The attributes of the instance are known while its program is recorded, as globals are for a function:
numbers become constants, Params and Tables stay data. A later change of an attribute does not change the program.

    class Shader:
        def __init__(self, gain):
            self.gain = gain

        @sh.program
        def shade(self, x: sh.Attrib1f) -> sh.Attrib1f:
            return self.gain * x

    Shader(3).shade([1, 2])       # recorded here, with 3 as a constant
"""

from __future__ import annotations

import functools
import inspect
import threading
import weakref
from collections.abc import Callable
from typing import Any

from shpy.errors import RecordError, warn
from shpy.lang.recording.location import here
from shpy.lang.recording.pickling import cannot_travel
from shpy.lang.recording.signature import loc_of


def is_method(function: Any) -> bool:
    """Return whether a function of a class's body has a first parameter `self` without annotation or default."""
    if not inspect.isfunction(function):
        return False
    *_, place, _ = ["", "<locals>", *function.__qualname__.split(".")]
    first = next(iter(inspect.signature(function).parameters.values()), None)
    if place in ("", "<locals>") or first is None:
        return False
    by_position = first.kind in (first.POSITIONAL_ONLY, first.POSITIONAL_OR_KEYWORD)
    return by_position and first.annotation is first.empty and first.default is first.empty


class PerInstance:
    """A descriptor that holds what was recorded for each instance, for as long as the instance lives."""

    def __init__(self, function: Callable[..., Any]) -> None:
        functools.update_wrapper(self, function)
        self.function = function
        self.owner: type | None = None
        self._recordings: dict[int, tuple[weakref.ref[Any], Any]] = {}
        self._underway: set[tuple[int, int]] = set()

    def record_for(self, instance: Any) -> Any:
        """Record the method bound to this instance."""
        raise TypeError(f"{type(self).__name__} records nothing")

    def __set_name__(self, owner: type, name: str) -> None:
        self.owner = owner

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        return self if instance is None else self._of(instance)

    def __call__(self, *args: Any, **named: Any) -> Any:
        """Run the instance's program: `Class.method(instance, …)`.

        Below `@classmethod` it has no owner, and from Python 3.13 on it is called with the class.
        """
        if not args or not isinstance(args[0], self.owner or type):
            name, first = self.function.__name__, next(iter(inspect.signature(self.function).parameters))
            raise RecordError(
                f"{self.function.__qualname__} is a method, recorded for each instance, and is given none as {first}",
                loc=here(),
                cure=f"instance.{name}(…), or an annotation, {first}: sh.Attrib1f, if {first} is an input",
            )
        return self._of(args[0])(*args[1:], **named)

    def __getattr__(self, name: str) -> Any:
        function = self.__dict__.get("function")
        called = getattr(function, "__name__", "method")
        qualified = getattr(function, "__qualname__", called)
        text = f"{qualified} is recorded for each instance: instance.{called}.{name}"
        if self.__dict__.get("owner") is None:
            text = f"{qualified} is recorded for each class: @sh.program above @classmethod, and {qualified}.{name}"
        raise AttributeError(text, name=name, obj=self)

    def __reduce__(self) -> Any:
        name = self.function.__name__
        raise cannot_travel(
            f"the method {self.function.__qualname__}", "it is recorded for each instance", f"instance.{name}"
        )

    def _of(self, instance: Any) -> Any:
        entry = self._recordings.get(id(instance))
        if entry is not None and entry[0]() is instance:
            return entry[1]
        underway = threading.get_ident(), id(instance)
        if underway in self._underway:
            raise RecordError(
                f"{self.function.__qualname__} calls itself: recursion cannot be recorded",
                loc=here(),
                cure="a loop, with an sh.Array as the stack",
            )
        try:
            self._underway.add(underway)
            recording = self.record_for(instance)
        finally:
            self._underway.discard(underway)
        self._keep(instance, recording)
        return recording

    def _keep(self, instance: Any, recording: Any) -> None:
        """Keep the recording until the instance is deleted."""
        key, forget = id(instance), self._recordings.pop
        try:
            reference = weakref.ref(instance, lambda _: forget(key, None))
        except TypeError:
            self._warn(type(instance))
            return
        self._recordings[key] = reference, recording

    def _warn(self, cls: type) -> None:
        name = self.function.__name__
        warn(
            f"{loc_of(self.function)}: {name} is recorded anew each time that it is asked for, since a {cls.__name__} "
            "cannot be referred to weakly\n  write instead: '__weakref__' in its __slots__, or "
            f"{name} = instance.{name} once"
        )
