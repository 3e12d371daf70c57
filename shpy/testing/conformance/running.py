"""Runs one program on the reference interpreter and on every backend, with the same arrays in and out.

result = run(program, "opencl", points)          # a Result: outputs, written, count
assert_same(result.outputs, run(program, "interpreter", points).outputs)
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

import shpy as sh
from shpy.backend.base import Array, Options
from shpy.backend.numpy.device.run import NumpyBackend, NumpyExecutable
from shpy.backend.opencl.packets.widen import WIDTHS as PACKET_WIDTHS
from shpy.backend.registry import backend as backend_named
from shpy.ir.interpreter import Interpreter
from shpy.ir.nodes import Function, Let, Loc, Module
from shpy.ir.ops import TRANSCENDENTALS
from shpy.ir.parser import parse
from shpy.ir.traverse import rewrite
from shpy.ir.verifier import verify
from shpy.passes.lower import lower
from shpy.passes.pipeline import Target, prepare
from shpy.run.kernel import Kernel
from shpy.run.result import Result
from shpy.testing.arrays import differing, is_denormal
from shpy.testing.reference import Interpreted, Reference

TARGETS = ("numpy", "opencl", "glsl")
BACKENDS = ("interpreter", "prepared", *TARGETS)
PACKETS = {"opencl-1": 1, "opencl-4": 4, "opencl-16": 16}
TILES = {"numpy-5": 5}
"""Other widths, with lanes that are left over: as many elements together in OpenCL and in a tile of numpy."""
WIDTHS = (*TILES, *PACKETS)
LANES = {f"opencl-{n}": n for n in (1, *PACKET_WIDTHS)}
"""Every width of OpenCL by itself: one element a work item is what a GPU runs."""
WIDE = {"opencl-32": 32, "opencl-64": 64}
"""The widths for which a driver may lack vectors."""
TINY = {np.dtype(t): np.finfo(t).tiny for t in (np.float16, np.float32, np.float64)}


class Prepared(Reference):
    """The interpreter on what the passes give to a target's printer, whose text must be read back the same."""

    name = "prepared"

    def compile(self, module: Module, options: Options) -> Interpreted:
        """Compile a module."""
        prepared = prepare(module, options, Target("plain", loop_flags=True))
        verify(prepared.module)
        assert parse(str(prepared.module)) == prepared.module
        return Interpreted(Interpreter(prepared.module), prepared.loops)


class Tiled(NumpyBackend):
    """numpy, a few lanes at a time."""

    def __init__(self, name: str, tile: int) -> None:
        self.name = name
        self.tile = tile

    def compile(self, module: Module, options: Options, tile: int | None = None) -> NumpyExecutable:
        """Compile a module."""
        return super().compile(module, options, tile or self.tile)


OWN: dict[str, Any] = {
    "interpreter": Reference(),
    "prepared": Prepared(),
    **{name: Tiled(name, tile) for name, tile in TILES.items()},
}


def kernel(program: sh.Program, backend: str, **options: Any) -> Kernel:
    """Return the program, compiled for one of BACKENDS, WIDTHS, LANES or WIDE."""
    if backend in OWN:
        return Kernel(program.recorded, OWN[backend], Options(**options))
    if backend in LANES | WIDE:
        return program.compile("opencl", lanes=(LANES | WIDE)[backend], **options)
    return program.compile(backend, **options)


def run(program: sh.Program, backend: str, *arrays: Any, out: Any = None, shape: Any = None, **options: Any) -> Result:
    """Run it on arrays on one of BACKENDS, WIDTHS, LANES or WIDE; `options` are those of `Program.compile`."""
    return kernel(program, backend, **options).run(*arrays, out=out, shape=shape)


def differs(results: Array, expected: Array, ulp: float = 0, absolute: float = 0) -> Array:
    """Return a mask of the elements that differ: in any bit but those of a NaN, or by more than the bound."""
    wrong = differing(results, expected)
    if results.dtype.kind == "f" and (ulp or absolute):
        with np.errstate(all="ignore"):
            unit = np.spacing(np.maximum(np.abs(expected), TINY[expected.dtype])).astype(np.float64)
            distance = np.abs(results.astype(np.float64) - expected.astype(np.float64))
            wrong &= ~(distance <= np.maximum(ulp * unit, absolute))
    return wrong


@functools.cache
def flushes_denormals(backend: str, **options: Any) -> bool:
    """Return whether the backend's device turns denormals into zeros: asked by running one product."""
    scaled: sh.Program = sh.program(_scale)
    denormal = kernel(scaled, backend, **options)(np.float32(1e-38), np.float32(0.125))
    if denormal == 0:
        notes = " ".join(note for device in backend_named(backend.partition("-")[0]).devices() for note in device.notes)
        assert "denormals" in notes, f"{backend} flushes denormals and does not say so"
    return bool(denormal == 0)


def _scale(x: sh.Attrib1f, by: sh.Attrib1f) -> sh.Attrib1f:
    return sh.Attrib1f(x * by)


class DenormalWatch:
    """Tells for one element whether a denormal arises on the way: in its inputs, or in any value computed."""

    def __init__(self, module: Module, options: Options) -> None:
        lowered = lower(module, TRANSCENDENTALS)
        named = replace(lowered, functions=tuple(map(_named, lowered.functions)))
        self.interpreter = Interpreter(named, options.precision, options.loop_limit)

    def arises(
        self,
        inputs: list[Any],
        params: Mapping[str, Any],
        tables: Mapping[str, Any],
        index: tuple[int, ...],
        shape: tuple[int, ...],
    ) -> bool:
        """Run the element; arguments are those of `Interpreter.run_element`."""
        if any(map(is_denormal, inputs)):
            return True
        denormal: list[bool] = []

        def note(loc: Loc | None, name: str, value: Any, iterations: tuple[int, ...]) -> None:
            denormal.append(is_denormal(value))

        outputs, _ = self.interpreter.run_element(inputs, params, tables, index, shape, note)
        return any(denormal) or any(map(is_denormal, outputs))


def _named(function: Function) -> Function:
    """Return the function with a name for each value, so that a trace shows them all."""

    def name(statement: Any) -> Any:
        if isinstance(statement, Let):
            return replace(statement, value=replace(statement.value, name=f"v{statement.value.id}"))
        return statement

    return replace(function, body=rewrite(function.body, name))
