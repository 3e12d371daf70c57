"""The reference interpreter as a backend, and every way in which a program can be run here.

Stage: test. `targets()` names them: "numpy", "opencl-1", "opencl-4", …, "glsl", "interpreter"; `kernel` compiles a
program for one.

    kernel(program, "opencl-16")(points)
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Collection, Iterable
from typing import Any

import numpy as np

from shpy.backend.base import Array, Call, Device, DeviceCall, Options
from shpy.backend.numpy.device.memory import NumpySpace, over_arrays
from shpy.backend.numpy.device.run import SPACE, NumpyBackend, NumpyExecutable
from shpy.backend.opencl.packets.widen import WIDER, WIDTHS
from shpy.backend.registry import NAMES, backend, backends
from shpy.errors import BackendUnavailable, ShpyTypeError
from shpy.ir.interpreter import Interpreter
from shpy.ir.nodes import Loc, Module
from shpy.ir.parser import parse
from shpy.ir.traverse import limited_loops
from shpy.ir.verifier import verify
from shpy.lang.recording.location import here
from shpy.passes.modes import Math, Precision
from shpy.passes.pipeline import Target, prepare, with_strict_functions
from shpy.programs import Program, check_program
from shpy.run.kernel import Kernel

INTERPRETER = "interpreter"
PREPARED = "prepared"
"""The interpreter on what the passes give to a target's printer."""
_WIDTHS = {"opencl": (1, *WIDTHS)}
"""The numbers of lanes that comparisons run when they name the backend alone."""
_MORE_WIDTHS = {"opencl": WIDER}
"""Widths that are compared where they are named: they take long to compile, and not every driver has them."""


class InterpretedModule:
    """An Executable that interprets a module, element after element; `only` some of them, where it is given."""

    notes: tuple[str, ...] = ()
    writes_all = False

    def __init__(
        self, interpreter: Interpreter, loops: tuple[Loc | None, ...], only: Collection[int] | None = None
    ) -> None:
        self.interpreter = interpreter
        self.loops = loops
        self.only = only

    @functools.cached_property
    def source(self) -> str:
        """The text of the module."""
        return str(self.interpreter.module)

    def run(self, call: Call) -> Array:
        """Run it; elements that are left out are as if they were discarded."""
        statuses = np.zeros(call.count, np.int32)
        for n in range(call.count) if self.only is None else sorted(self.only):
            index = tuple(int(i) for i in np.unravel_index(n, call.shape)) if call.shape else ()
            inputs = [each[n if len(each) > 1 else 0] for each in call.inputs]
            computed, statuses[n] = self.interpreter.run_element(inputs, call.params, call.tables, index, call.shape)
            if statuses[n] == 1:
                for there, value in zip(call.outputs, computed, strict=True):
                    there[n] = value
        return statuses

    def ready(self, call: DeviceCall, *, once: bool = False) -> Callable[[], None]:
        """Prepare a run over memory of the numpy backend."""
        return over_arrays(self.run, call)


class Reference:
    """The reference interpreter as a backend: it runs modules as recorded, with strict or portable functions."""

    name = INTERPRETER

    def __init__(self, only: Collection[int] | None = None) -> None:
        self.only = only

    def devices(self) -> list[Device]:
        """Return the one there is."""
        return [Device("reference interpreter", "1")]

    def compile(self, module: Module, options: Options) -> InterpretedModule:
        """Make the module's closures."""
        loops = tuple(loop.loc for loop in limited_loops(module))
        return InterpretedModule(
            interpreter_of(module, options.precision, options.loop_limit, options.math, fuse=options.fuse),
            loops,
            self.only,
        )

    def space(self, device: int | None) -> NumpySpace:
        """Return the host's memory."""
        return SPACE


class PreparedReference(Reference):
    """The interpreter on what the passes give to a target's printer, whose text must be read back the same."""

    name = PREPARED

    def compile(self, module: Module, options: Options) -> InterpretedModule:
        """Prepare the module for a target without functions of its own, and make its closures."""
        prepared = prepare(module, options, Target("plain", loop_flags=True))
        verify(prepared.module)
        assert parse(str(prepared.module)) == prepared.module
        return InterpretedModule(Interpreter(prepared.module), prepared.loops)


class TiledNumpy(NumpyBackend):
    """numpy, a few lanes at a time, with lanes that are left over."""

    def __init__(self, tile: int) -> None:
        self.tile = tile

    def compile(self, module: Module, options: Options, tile: int | None = None) -> NumpyExecutable:
        """Compile a module for these tiles."""
        return super().compile(module, options, tile or self.tile)


def interpreter_of(
    module: Module, precision: Precision, loop_limit: int | None, math: Math = "strict", *, fuse: bool = False
) -> Interpreter:
    """Return the interpreter of a recorded module, whose exponentials and the like are those of the mode.

    `fuse`: the module is one that `passes.fuse` has contracted.
    """
    lowered = with_strict_functions(module, precision, math, fuse=fuse)
    return Interpreter(lowered, precision if lowered is module else "f32", loop_limit)


def targets(wanted: Iterable[str] | str | None = None) -> list[str]:
    """Return every way to run a program on the `wanted` backends: with 1, 4, 8 and 16 lanes where they have lanes.

    None stands for every backend that is available; a name with a width, "opencl-4", for that one; "interpreter" for
    the reference interpreter. Raises BackendUnavailable for missing backends.
    """
    if wanted is None:
        wanted = [b.name for b in backends() if b.available]
    if not isinstance(wanted, Iterable):
        raise ShpyTypeError(f"backends={wanted!r} names no backends", loc=here(), cure='backends=["numpy", "glsl"]')
    names = [wanted] if isinstance(wanted, str) else list(wanted)
    choices = [INTERPRETER, *(t for name in NAMES for t in _widths(name))]
    choices += [f"{name}-{lanes}" for name, more in _MORE_WIDTHS.items() for lanes in more]
    chosen: list[str] = []
    for name in names:
        if name not in choices and name not in NAMES:
            raise BackendUnavailable(
                f"there is no backend {name!r}", cure=" or ".join(map(repr, dict.fromkeys((*NAMES, *choices))))
            )
        chosen += [t for t in ([name] if name in choices else _widths(name)) if t not in chosen]
    return chosen


def require(choices: Iterable[str]) -> list[str]:
    """Return these names of backends; raises BackendUnavailable for one that is not available."""
    names = [name.strip() for name in choices if name.strip()]
    for name in names:
        backend(name).devices()
    return names


def _widths(name: str) -> list[str]:
    return [f"{name}-{lanes}" for lanes in _WIDTHS[name]] if name in _WIDTHS else [name]


_OPTIONS = frozenset(inspect.signature(Program.compile).parameters) - {"self", "backend", "lanes"}


def split_options(arguments: dict[str, Any], program: Program) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split the keyword arguments into inputs of the program and options of its compilation."""
    check_program(program)
    inputs = {name: value for name, value in arguments.items() if name in program.inputs}
    options = {name: value for name, value in arguments.items() if name not in inputs}
    unknown = sorted(options.keys() - _OPTIONS)
    if unknown:
        raise ShpyTypeError(
            f"{unknown[0]} is no input of {program.name}, and no option of compile",
            loc=here(),
            cure=", ".join([*program.inputs, *sorted(_OPTIONS)]),
        )
    return inputs, options


def flushes_denormals(notes: Iterable[str]) -> bool:
    """Return whether the notes of a kernel say that its device turns denormals into zeros."""
    return any("flushes denormals" in note for note in notes)


def flushes(target: str, device: int | None = None) -> bool:
    """Return whether the device of a target says that it turns denormals into zeros."""
    name = target.partition("-")[0]
    return name in NAMES and flushes_denormals(backend(name).devices()[device or 0].notes)


def kernel(program: Program, target: str, only: Collection[int] | None = None, **options: Any) -> Kernel:
    """Return the program compiled for a target; `only` are the elements that the interpreter runs.

    Targets are those of `targets()`, PREPARED, and "numpy-5", numpy with tiles of that size.
    """
    name, _, lanes = target.partition("-")
    match name:
        case "interpreter" | "prepared":
            own = Reference(only) if name == INTERPRETER else PreparedReference()
            return Kernel(program.recorded, own, Options(**options))
        case "numpy" if lanes:
            return Kernel(program.recorded, TiledNumpy(int(lanes)), Options(**options))
    chosen: dict[str, Any] = {"lanes": int(lanes) if lanes else "auto", **options}
    return program.compile(name, **chosen)
