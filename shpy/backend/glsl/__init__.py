"""The GLSL backend: programs as fragment shaders of OpenGL 3.3, run without a window.

Stage: emit, compile, run. `text` makes the text, `device` runs it; moderngl is imported on first use. Mesa's
llvmpipe, the driver without a GPU, stops an element's loops after 65,535 iterations in all, without a word: a program
that may take as many gets flags that tell (`passes/exits.py`), and its status is DEVICE_STOPPED.

    executable = backend.compile(module, Options())
    print(executable.source)
    executable.run(call)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import count
from typing import Final

import numpy as np

from shpy.backend.base import Array, Call, Device, DeviceCall, Options
from shpy.backend.device import store
from shpy.backend.device.once import once
from shpy.backend.device.probe import EMULATED, emulates_fma, notes_of, refuse_wrong
from shpy.backend.glsl.device.context import open_context
from shpy.backend.glsl.device.memory import GlslSpace
from shpy.backend.glsl.device.run import DeviceRun, Program, Runtime
from shpy.backend.glsl.text.interface import Limits, Shader
from shpy.backend.glsl.text.operations import FAST, NATIVE
from shpy.backend.glsl.text.shader import print_shader
from shpy.errors import BackendUnavailable, CompileError
from shpy.ir.builder import Builder
from shpy.ir.exact import hard_cases
from shpy.ir.nodes import Loc, Module, Port, Value, Variable
from shpy.ir.traverse import bases_of, defined, variables_of
from shpy.ir.types import Base, vec
from shpy.passes.dead_stores import select_outputs
from shpy.passes.exits import few_turns
from shpy.passes.hide import hide_derivable, hold_bools_as_ints
from shpy.passes.library import CORRECTABLE
from shpy.passes.modes import REPRODUCIBLE
from shpy.passes.nesting import MAX_NESTING
from shpy.passes.pipeline import PreparedModule, Target, prepare
from shpy.passes.private import check_private, private_memory
from shpy.passes.rejecting import find_rejection
from shpy.passes.size import check_growth, check_size

TARGET = Target("glsl", native=NATIVE, fast=FAST, loop_flags=True, nesting=MAX_NESTING, long=False)
_FLOAT: Final = vec(Base.F)
_HARD: Final = ("exp", "sin", "log10", "sinh", "asin")
"""Functions whose formulas in binary64 have numbers with all digits, late digits of 1 / pi, and square roots."""
_MOST_STATEMENTS = 50_000
"""All calls inlined, as Mesa does it: time and memory of its compiler grow faster than the number of statements."""

_MOST_PRIVATE = 1 << 17
"""Bytes of an element's local arrays. llvmpipe has those of 16 elements on a thread's stack, as 2 MB at most then."""


@dataclass(frozen=True, slots=True)
class GlslExecutable:
    """A compiled module: one program, or several where it has more outputs than the device writes at a time."""

    source: str
    notes: tuple[str, ...]
    loops: tuple[Loc | None, ...]
    writes_all: bool
    runtime: Runtime
    programs: tuple[Program, ...]
    groups: tuple[tuple[int, ...], ...]
    rejection: Callable[[], Program | None] = lambda: None
    """The program that finds out which elements are discarded at the start, built when it is first wanted."""

    def run(self, call: Call) -> Array | None:
        """Run it; return the int32 status of each element, (n,), or None when every element was written."""
        if call.count == 0 or not self.programs:
            return None
        return self.runtime.context.call(lambda: self.runtime.run(self.programs, self.groups, call))

    def ready(self, call: DeviceCall, *, once: bool = False) -> Callable[[], None]:
        """Prepare a run over textures: see `base.Executable`."""
        if math.prod(call.shape) == 0 or not self.programs:
            return lambda: None
        rejection = self.rejection()
        return self.runtime.context.call(lambda: DeviceRun(self.runtime, self.programs, self.groups, call, rejection))


class GlslBackend:
    """Fragment shaders through moderngl."""

    name = "glsl"

    def devices(self) -> list[Device]:
        """Return every device that EGL lists; BackendUnavailable if there is no device."""
        open_context(0)
        return [self._described(index) for index in range(_count_devices())]

    def compile(self, module: Module, options: Options) -> GlslExecutable:
        """Prepare, print and build; CompileError, at the user's line, for a type that GLSL or the device lacks."""
        if options.lanes not in ("auto", 1):
            what = f"lanes={options.lanes!r} is for OpenCL: GLSL runs one element a work item"
            raise CompileError(what, cure='program.compile("glsl")')
        return self._compiled(module, options, self._limits(options.device or 0))

    def _compiled(self, module: Module, options: Options, limits: Limits) -> GlslExecutable:
        """Compile for a device that has these limits."""
        _check_order(module, options, limits)
        runtime = self._runtime(options.device or 0)
        target = _target(limits, module, options)

        def build(prepared: PreparedModule, *, rejects: bool = False) -> tuple[Program, ...]:
            steady = few_turns(prepared.module)
            shaders = _shaders(prepared, options, limits, rejects=rejects)
            return tuple(runtime.build(shader, module.entry.loc, steady=steady) for shader in shaders)

        def rejection() -> Program | None:
            shorter = find_rejection(module)
            return None if shorter is None else build(prepare(shorter, options, target), rejects=True)[0]

        prepared = prepare(module, options, target)
        _refuse(prepared.module, target)
        check_size(prepared.module, "OpenGL's compiler")
        check_growth(prepared.module, _MOST_STATEMENTS, "OpenGL's compilers copy each function to where it is called")
        arrays = private_memory(prepared.module)
        check_private(arrays, _MOST_PRIVATE, "an element", "OpenGL's drivers", 'smaller arrays, or compile("numpy")')
        if options.math in REPRODUCIBLE:
            refuse_wrong(prepared.module, limits.wrong, "this device")
        groups = _groups(len(prepared.module.entry.outputs), limits.outputs)
        programs = build(prepared)
        text, notes = "\n".join(p.shader.source for p in programs), _notes(limits)
        if options.fuse and emulates_fma(limits.wrong, options.precision):
            notes = (*notes, EMULATED)
        return GlslExecutable(
            text, notes, prepared.loops, not prepared.status, runtime, programs, groups, cache(rejection)
        )

    def _limits(self, device: int) -> Limits:
        """Return the limits of a device.

        Where a device needs corrections in binary64, its strict functions have to give answers that are hard to round;
        else it is taken for a device without binary64.
        """
        context = self._runtime(device).context
        limits = context.limits
        if not limits.doubles or (limits.roots and limits.reads):
            return limits
        return _judged(self, device, limits)

    def _described(self, device: int) -> Device:
        limits = self._limits(device)
        context = open_context(device)
        info = context.call(lambda: dict(context.gl.info))
        features = ["f32", "f16 by rounding", f"{limits.outputs} outputs a pass"]
        return Device(info["GL_RENDERER"], info["GL_VERSION"], tuple(features), _notes(limits))

    def space(self, device: int | None) -> GlslSpace:
        """Return the memory of a device."""
        return self._runtime(device or 0).space

    def _runtime(self, device: int) -> Runtime:
        return _runtime_of(open_context(device))


_runtime_of = once(Runtime)


@once
def _count_devices() -> int:
    """Return the number of devices. EGL does not tell it, so devices are opened until one fails."""
    for index in count():
        try:
            open_context(index)
        except BackendUnavailable:
            break
    return index


@once
def _judged(backend: GlslBackend, device: int, limits: Limits) -> Limits:
    """Return these limits, without binary64 where strict functions give a wrong answer that is hard to round."""
    context = open_context(device)
    options, modules = Options(device=device), {name: _module_of(name) for name in _HARD}
    texts = [text_for(module, options, limits) for module in modules.values()]
    key = store.key("glsl hard cases", *context.call(lambda: context.about), *texts)

    def ask() -> set[str]:
        executables = {name: backend._compiled(m, options, limits) for name, m in modules.items()}
        return {name for name, executable in executables.items() if _rounds(name, executable, limits)}

    right = store.known_names(key, set(_HARD), ask)
    return limits if right == set(_HARD) else replace(limits, doubles=False)


def _target(limits: Limits, module: Module, options: Options) -> Target:
    """Return the abilities of a device, for the passes.

    Only shpy's own functions use the device's binary64. A program that uses f64 itself is refused.
    """
    doubles = limits.doubles and options.precision != "f64" and Base.D not in bases_of(module)
    return replace(TARGET, wrong=limits.wrong & CORRECTABLE, doubles=doubles)


def _module_of(name: str) -> Module:
    """Return a module that computes a function of one float."""
    b = Builder(name)
    b.store(b.output(_FLOAT, "y"), b.let(name, b.input(_FLOAT, "x")))
    return Module(name, (Port("x", ""),), (Port("y", ""),), (), (), (b.finish(),))


def text_for(module: Module, options: Options, limits: Limits) -> str:
    """Return the text of a module for a device with these limits, which need not be here."""
    prepared = prepare(module, options, _target(limits, module, options))
    return "\n".join(shader.source for shader in _shaders(prepared, options, limits))


def _shaders(prepared: PreparedModule, options: Options, limits: Limits, *, rejects: bool = False) -> Iterator[Shader]:
    """Yield the shader of each group of outputs, in forms that Mesa's compilers get right."""
    exact, limited = options.math != "fast", options.loop_limit is not None
    whole = hold_bools_as_ints(prepared.module)
    if exact:  # they may fold no floats either
        whole = hide_derivable(whole)
    groups = _groups(len(whole.entry.outputs), limits.outputs)
    for group in groups:
        part = select_outputs(whole, group) if len(groups) > 1 else whole
        yield print_shader(part, limits, exact=exact, flagged=prepared.flagged, limited=limited, rejects=rejects)


def _rounds(name: str, executable: GlslExecutable, limits: Limits) -> bool:
    """Return whether a function gives the answers that are hardest to round; flushed denormals do not count."""
    x, answers = hard_cases(name)
    results = np.empty_like(answers)
    executable.run(Call(x.shape, (x,), (results,), {}, {}))
    least = 0.0 if limits.keeps_denormals else np.finfo(np.float32).tiny
    compared = (np.abs(x) >= least) & (np.abs(answers) > least)
    return np.array_equal(results[compared], answers[compared])


def _groups(count: int, most: int) -> tuple[tuple[int, ...], ...]:
    """Divide `count` outputs among shaders of at most `most` outputs; return their indices."""
    return tuple(tuple(range(first, min(first + most, count))) for first in range(0, count, most))


def _notes(limits: Limits) -> tuple[str, ...]:
    notes = list(notes_of(limits.wrong, binary64=limits.doubles))
    if not limits.keeps_order:
        notes.append('this device lacks GL_ARB_gpu_shader5: programs compile with math="fast" alone')
    if not limits.chooses:
        notes.append("this device takes a < b ? b : a for a maximum, also of NaN: comparisons stand apart")
    if not limits.negates:
        notes.append("this device takes !(a < b) for a >= b, also of NaN: comparisons are hidden from its compiler")
    if not limits.signs:
        notes.append("this device loses signs of zeros in choices: comparisons are hidden from its compiler")
    if limits.doubles and not limits.roots:
        notes.append("this device gets sqrt of binary64 wrong: strict mode corrects it")
    if not limits.reads:
        notes.append("this device misreads decimal numbers: texts have their bits")
    return tuple(notes)


def _check_order(module: Module, options: Options, limits: Limits) -> None:
    """Raise CompileError where the mode needs `precise` and the device lacks it, as GPUs of before about 2011 do."""
    if options.math != "fast" and not limits.keeps_order:
        raise CompileError(
            f"{options.math} mode needs GL_ARB_gpu_shader5 (OpenGL 4.0), which this device lacks: its compiler may "
            "reorder arithmetic",
            loc=module.entry.loc,
            cure='math="fast", or backend="numpy"',
        )


def _refuse(module: Module, target: Target) -> None:
    """Raise CompileError for f64, which GLSL 3.30 lacks, unless the device has it for shpy's functions."""
    locations: list[Loc | None] = []
    for function in module.functions:
        things: list[Value | Variable] = [*defined(function), *variables_of(function)]
        locations += [thing.loc or function.loc for thing in things if thing.type.base is Base.D]
    locations += [module.entry.loc for table in module.tables if table.type.base is Base.D]
    if locations and not target.doubles:
        cure = 'compile this program on "numpy" or "opencl"'
        raise CompileError("GLSL 3.30 has no 64-bit floats (f64)", loc=locations[0], cure=cure, lacks="f64")


backend = GlslBackend()
