"""Observers of a run: a backend, asked again for each event, or the interpreter, which notes all events at once.

Stage: test. Takes a program, its inputs and one element; gives the observations of each event of that element.

    one = observer(setting, "opencl-4", element=3)
    one.count, one.trail(17), one.site(17)       # events in all; the hash up to event 17; which statement it was
    one.look({12, 13}).seen(17)                  # its value, operands and iterations, for the sites looked at
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from shpy.errors import LoopLimitExceeded
from shpy.ir.constants import dtypes_at
from shpy.ir.nodes import Module
from shpy.ir.types import Base, Type
from shpy.lang.values.structure import Group, Leaf
from shpy.lang.values.value import CLASSES
from shpy.passes.fuse import fuse
from shpy.passes.promote import promote
from shpy.programs import Program
from shpy.run.host import bind, common_shape, streams, tables, uniforms
from shpy.run.kernel import Kernel
from shpy.testing.reference import INTERPRETER, flushes_denormals, interpreter_of, kernel
from shpy.testing.watch import OPERANDS, Site, WatchedModule, watch

_LAST = 2**32 - 2
"""A target that no event reaches."""


@dataclass(frozen=True)
class Observation:
    """The observation of an event; `site` is None where the element had ended before it."""

    site: Site | None
    turns: tuple[int, ...] = ()
    value: Any = None
    operands: tuple[Any, ...] = ()


@dataclass
class Setting:
    """A program and its inputs. `options` are those of `Program.compile`.

    `check` is called before each compilation and run of an observer, which take seconds: it ends the search by raising.
    """

    program: Program
    inputs: tuple[Any, ...] = ()
    named: Mapping[str, Any] = field(default_factory=dict)
    shape: Any = None
    options: Mapping[str, Any] = field(default_factory=dict)
    watches: dict[tuple[frozenset[int], bool], WatchedModule] = field(default_factory=dict)
    check: Callable[[], None] = lambda: None

    @property
    def precision(self) -> Any:
        """The working precision."""
        return self.options.get("precision", "f32")

    @property
    def math(self) -> Any:
        """The mode."""
        return self.options.get("math", "strict")

    @property
    def fuse(self) -> bool:
        """True if sums of products are contracted."""
        return bool(self.options.get("fuse", False))

    @cached_property
    def module(self) -> Module:
        """The watched program, with as few variables as possible, so that a line is few events."""
        return promote(fuse(self.program.ir) if self.fuse else self.program.ir)

    def watch(self, looked: frozenset[int], *, finiteness: bool = False) -> WatchedModule:
        """Return the module that watches itself, made once for each set of sites that are looked at."""
        key = looked, finiteness
        if key not in self.watches:
            limit, wide = self.options.get("loop_limit", 1_048_576), self.precision == "f64"
            self.watches[key] = watch(self.module, limit, looked, wide=wide, finiteness=finiteness)
        return self.watches[key]

    @cached_property
    def element_shape(self) -> tuple[int, ...]:
        """The element shape S of the run."""
        return common_shape(self.leaves, self.shape)

    @cached_property
    def _inputs_by_name(self) -> dict[str, Any]:
        return bind(self.program.recorded, self.inputs, self.named)

    @cached_property
    def leaves(self) -> list[Any]:
        """The leaves of the inputs that are streams, with their names and arrays."""
        return streams(self.program.recorded.inputs, self._inputs_by_name, self.precision)

    def arrays(self) -> list[Any]:
        """Return the inputs by position, for a function of numpy: floats of the working precision, in binary64.

        Structs, tables and textures are those that the caller passed.
        """
        leaves = {s.name: s.array for s in self.leaves}
        return [
            (a.astype(np.float64) if (a := leaves[name]).dtype.kind == "f" else a)
            if name in leaves
            else self._inputs_by_name[name]
            for name in self.program.inputs
        ]

    def element(self, n: int) -> dict[str, Any]:
        """Return the inputs of the n-th element in C order, by name."""
        flat = [s.flat(self.element_shape) for s in self.leaves]
        return {s.name: a[n if len(a) > 1 else 0] for s, a in zip(self.leaves, flat, strict=True)}

    def data(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the params and tables, as the interpreter takes them."""
        recorded, dtypes = self.program.recorded, dtypes_at(self.precision)
        data = tables(recorded.inputs, self._inputs_by_name, recorded.tables)
        params = uniforms(recorded.params, self.precision, self.math)
        return params, {n: t.data(dtypes[t.type.base]) for n, t in data.items()}

    def index(self, n: int) -> tuple[int, ...]:
        """Return the place of the n-th element along numpy's axes."""
        return tuple(int(i) for i in np.unravel_index(n, self.element_shape)) if self.element_shape else ()


def observer(setting: Setting, target: str, element: int) -> Observer:
    """Return an observer of this element on this target."""
    return _Interpreter(setting, element) if target == INTERPRETER else BackendObserver(setting, target, element)


def _seen(watched: WatchedModule, slots: Mapping[str, Any], precision: Any) -> Observation:
    if not slots["site"]:
        return Observation(None)
    site = watched.sites[int(slots["site"]) - 1]
    dtypes = dtypes_at(precision)
    kept = [_kept(slots, f"operand{n}", type, dtypes) for n, (_, _, type) in enumerate(site.operands[:OPERANDS])]
    iterations = tuple(int(n) for n in slots["iterations"][: len(site.loops)])
    return Observation(site, iterations, _kept(slots, "value", site.type, dtypes), tuple(kept))


def _kept(slots: Mapping[str, Any], place: str, type: Type, dtypes: Mapping[Base, Any]) -> Any:
    """Return a value out of the slot of its family, in its own type at the setting's precision."""
    family = {Base.D: "d", Base.F: "f", Base.H: "f"}.get(type.base, "u")
    array = slots[f"{place}_{family}"][: type.size]
    array = array.view(np.int32) if type.base is Base.I else array.astype(dtypes[type.base])
    return array if type.size > 1 else array[0]


class BackendObserver:
    """A backend: one run of all elements for each question, so that they share packets as they do in earnest."""

    def __init__(
        self,
        setting: Setting,
        target: str,
        element: int,
        looked: frozenset[int] = frozenset(),
        *,
        finiteness: bool = False,
    ) -> None:
        self.setting = setting
        self.target = target
        self.element = element
        self.watched = setting.watch(looked, finiteness=finiteness)
        options = {**setting.options, "loop_limit": None}
        setting.check()
        self.kernel: Kernel = kernel(_runnable(setting.program, self.watched), target, **options)
        self.flushes = flushes_denormals(self.kernel.notes)

    @cached_property
    def count(self) -> int:
        """The number of events."""
        return int(self._run(_LAST)["count"])

    def trail(self, event: int) -> int:
        """Return the hash of every event up to this one."""
        return int(self._run(event)["trail"])

    def site(self, event: int) -> int:
        """Return the number of the statement that the event is; 0 if the element had ended."""
        return int(self._run(event)["site"])

    def first_odd(self, kind: str) -> int | None:
        """Return the first event of a `kind`, "nan" or "infinite", that comes of other numbers; None without one."""
        number = int(self._run(_LAST)[kind])
        return number - 1 if number else None

    def look(self, sites: frozenset[int]) -> BackendObserver:
        """Return an observer that keeps the values and operands of these sites."""
        return BackendObserver(self.setting, self.target, self.element, sites)

    def seen(self, event: int) -> Observation:
        """Return an event at one of these sites."""
        return _seen(self.watched, self._run(event), self.setting.precision)

    def _run(self, target: int) -> dict[str, Any]:
        """Return the added outputs of the element, by name."""
        s = self.setting
        s.check()
        try:
            outputs = self.kernel(*s.inputs, shape=s.shape, **s.named, target=np.uint32(target))
        except LoopLimitExceeded as error:
            outputs = error.result.outputs
        added = self.watched.outputs
        index = s.index(self.element)
        return {n: np.asarray(a)[index] for (n, _), a in zip(added, outputs[-len(added) :], strict=True)}


class _Interpreter:
    """The interpreter: one run that notes every event, and one more with the sites that are looked at."""

    flushes = False

    def __init__(self, setting: Setting, element: int, looked: frozenset[int] = frozenset()) -> None:
        self.setting = setting
        self.element = element
        self.watched = setting.watch(looked)
        self.interpreter = interpreter_of(self.watched.module, setting.precision, None, setting.math, fuse=setting.fuse)
        self.events: list[tuple[int, int]] = []
        self._run(_LAST, self._note)

    def _note(self, loc: Any, name: str, value: Any, iterations: tuple[int, ...]) -> None:
        if name.startswith("@"):
            self.events.append((int(name[1:]), int(value)))

    @property
    def count(self) -> int:
        return len(self.events)

    def trail(self, event: int) -> int:
        return self.events[min(event, self.count - 1)][1] if self.events else 0

    def site(self, event: int) -> int:
        return self.events[event][0] if event < self.count else 0

    def look(self, sites: frozenset[int]) -> _Interpreter:
        return _Interpreter(self.setting, self.element, sites)

    def seen(self, event: int) -> Observation:
        return _seen(self.watched, self._run(event), self.setting.precision)

    def _run(self, target: int, trace: Any = None) -> dict[str, Any]:
        s = self.setting
        s.check()
        inputs = [*s.element(self.element).values(), np.uint32(target)]
        index = s.index(self.element)
        outputs, _ = self.interpreter.run_element(inputs, *s.data(), index, s.element_shape, trace=trace)
        added = self.watched.outputs
        return {n: a for (n, _), a in zip(added, outputs[-len(added) :], strict=True)}


Observer = BackendObserver | _Interpreter
"""One side of a comparison, for one element: each event of it can be asked for, and some sites be looked at in full."""


def _runnable(program: Program, watched: WatchedModule) -> Program:
    """Return the module that watches itself, with the tables and params of the program."""
    module = watched.module
    kinds = {cls.__name__: cls for cls in CLASSES.values()}
    parts = tuple(
        Leaf(kinds.get(port.kind) or CLASSES["Attrib", slot.type.size, slot.type.base])
        for port, slot in zip(module.outputs, module.entry.outputs, strict=True)
    )
    layout = Group("tuple", tuple(map(str, range(len(parts)))), parts)
    inputs: dict[str, Any] = {**program.recorded.inputs, "target": Leaf(CLASSES["Attrib", 1, Base.U])}
    return Program(replace(program.recorded, module=module, inputs=inputs, output=layout))


def sites_of(sides: Iterable[Observer], events: Iterable[int]) -> frozenset[int]:
    """Return the sites of these events, as any of the observers has them."""
    return frozenset(side.site(event) for event in events for side in sides) - {0}
