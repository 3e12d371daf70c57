"""Runs one program on the reference interpreter and on every backend, with the same arrays in and out.

result = run(program, "opencl", points)          # a Result: outputs, written, count
assert_same(result.outputs, run(program, "interpreter", points).outputs)
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np

import shpy as sh
from shpy.backends.base import Array, Backend, Call, Device, Options
from shpy.backends.numpy.runtime import NumpyBackend, NumpyExecutable
from shpy.backends.registry import backend as backend_named
from shpy.ir.interpreter import Interpreter
from shpy.ir.nodes import Function, Let, Loc, Module
from shpy.ir.parser import parse
from shpy.ir.traverse import limited_loops, rewrite
from shpy.ir.verifier import verify
from shpy.kernel import Kernel, Result
from shpy.passes.lower import lower
from shpy.passes.pipeline import Target, prepare

TARGETS = ("numpy", "opencl", "glsl")
BACKENDS = ("interpreter", "prepared", *TARGETS)
PACKETS = {"opencl-4": 4, "opencl-16": 16}
TILES = {"numpy-5": 5}
"""Other widths, with lanes that are left over: as many elements together in OpenCL and in a tile of numpy."""
WIDTHS = (*TILES, *PACKETS)
TINY = {np.dtype(t): np.finfo(t).tiny for t in (np.float16, np.float32, np.float64)}


class Interpreted:
    """An Executable that interprets a module, element after element."""

    notes: tuple[str, ...] = ()

    def __init__(self, interpreter: Interpreter, loops: tuple[Loc | None, ...]) -> None:
        self.interpreter = interpreter
        self.source = str(interpreter.module)
        self.loops = loops

    def run(self, call: Call) -> Array:
        outputs, statuses = self.interpreter.run_grid(call.inputs, call.shape, call.params, call.tables)
        for there, computed in zip(call.outputs, outputs, strict=True):
            there[statuses == 1] = computed[statuses == 1]
        return statuses


class Reference:
    """The reference interpreter as a backend: it runs modules as they were recorded."""

    name = "interpreter"

    def devices(self) -> list[Device]:
        return [Device("reference interpreter", "1")]

    def compile(self, module: Module, options: Options) -> Interpreted:
        loops = tuple(loop.loc for loop in limited_loops(module))
        return Interpreted(Interpreter(module, options.precision, options.loop_limit), loops)


class Prepared(Reference):
    """The interpreter on what the passes give to a target's printer, whose text must be read back the same."""

    name = "prepared"

    def compile(self, module: Module, options: Options) -> Interpreted:
        prepared = prepare(module, options, Target("plain", loop_flags=True))
        verify(prepared.module)
        assert parse(str(prepared.module)) == prepared.module
        return Interpreted(Interpreter(prepared.module), prepared.loops)


class Tiled(NumpyBackend):
    """numpy, a few lanes at a time."""

    def __init__(self, name: str, tile: int) -> None:
        self.name = name
        self.tile = tile

    def compile(self, module: Module, options: Options, tile: int = 0) -> NumpyExecutable:
        return super().compile(module, options, tile or self.tile)


OWN: dict[str, Backend] = {
    "interpreter": Reference(),
    "prepared": Prepared(),
    **{name: Tiled(name, tile) for name, tile in TILES.items()},
}


def kernel(program: sh.Program, backend: str, **options: Any) -> Kernel:
    """The program, compiled for one of BACKENDS or WIDTHS."""
    if backend in OWN:
        return Kernel(program._recorded, OWN[backend], Options(**options))
    if backend in PACKETS:
        return program.compile("opencl", lanes=PACKETS[backend], **options)  # type: ignore[arg-type]
    return program.compile(backend, **options)


def run(program: sh.Program, backend: str, *arrays: Any, out: Any = None, shape: Any = None, **options: Any) -> Result:
    """Run it on arrays on one of BACKENDS or WIDTHS; `options` are those of `Program.compile`."""
    return kernel(program, backend, **options).run(*arrays, out=out, shape=shape)


def leaves(outputs: Any) -> list[Array]:
    """The arrays of an output, whatever its structure."""
    if isinstance(outputs, tuple | list):
        return [leaf for part in outputs for leaf in leaves(part)]
    if isinstance(outputs, dict):
        return [leaf for part in outputs.values() for leaf in leaves(part)]
    if not isinstance(outputs, np.ndarray | np.generic):
        return [leaf for part in vars(outputs).values() for leaf in leaves(part)]
    return [np.asarray(outputs)]


def differs(found: Array, expected: Array, ulp: float = 0, absolute: float = 0) -> Array:
    """Where two arrays differ: in any bit but those of a NaN, or by more than the bound."""
    if found.dtype.kind != "f":
        return np.asarray(found != expected)
    with np.errstate(all="ignore"):
        equal = (found == expected) & (np.signbit(found) == np.signbit(expected))
        equal |= np.isnan(found) & np.isnan(expected)
        if ulp or absolute:
            unit = np.spacing(np.maximum(np.abs(expected), TINY[expected.dtype])).astype(np.float64)
            distance = np.abs(found.astype(np.float64) - expected.astype(np.float64))
            equal |= distance <= np.maximum(ulp * unit, absolute)
    return np.asarray(~equal)


@functools.cache
def flushes_denormals(backend: str) -> bool:
    """Whether the backend's device turns denormals into zeros: asked by running one product."""
    scaled: sh.Program = sh.program(_scale)
    denormal = kernel(scaled, backend)(np.float32(1e-38), np.float32(0.125))
    if denormal == 0:
        notes = " ".join(note for device in backend_named(backend.partition("-")[0]).devices() for note in device.notes)
        assert "denormals" in notes, f"{backend} flushes denormals and does not say so"
    return bool(denormal == 0)


def _scale(x: sh.Attrib1f, by: sh.Attrib1f) -> sh.Attrib1f:
    return x * by


class DenormalWatch:
    """Tells for one element whether a denormal arises on the way: in its inputs, or in any value computed."""

    def __init__(self, module: Module, options: Options) -> None:
        lowered = lower(module, frozenset())
        named = replace(lowered, functions=tuple(map(_named, lowered.functions)))
        self.interpreter = Interpreter(named, options.precision, options.loop_limit)

    def arises(self, inputs: list[Any], *rest: Any) -> bool:
        """Run the element; arguments are those of `Interpreter.run_element`."""
        found = [any(map(is_denormal, inputs))]
        outputs, _ = self.interpreter.run_element(
            inputs, *rest, trace=lambda loc, name, value: found.append(is_denormal(value))
        )
        return any(found) or any(map(is_denormal, outputs))


def is_denormal(value: Any) -> bool:
    """Whether one component is a denormal, or the least number that is none: a device may flush before it rounds."""
    array = np.asarray(value)
    return array.dtype.kind == "f" and bool(((array != 0) & (np.abs(array) <= TINY[array.dtype])).any())


def _named(function: Function) -> Function:
    """The function with a name for each value, so that a trace shows them all."""

    def name(statement: Any) -> Any:
        if isinstance(statement, Let):
            return replace(statement, value=replace(statement.value, name=f"v{statement.value.id}"))
        return statement

    return replace(function, body=rewrite(function.body, name))
