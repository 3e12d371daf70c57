"""Probe a device: find the basic operations that it rounds wrongly, on inputs chosen to be hard.

Stage: compile. A program of the backend runs once for each device and version of its driver; this module has the
inputs and the exact results, and compares. The passes lower a wrong operation to other operations where that is
possible; otherwise compiling raises an error.

    a, b, c = hard_inputs()
    wrong = wrong_operations({"div": ..., "sqrt": ..., ...})      # frozenset() where all is well
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from functools import cache
from typing import Final

import numpy as np

from shpy.backend.base import Array
from shpy.errors import CompileError
from shpy.ir.meaning import fma
from shpy.ir.nodes import Let, Module
from shpy.ir.traverse import walk
from shpy.passes.library import CORRECTABLE
from shpy.passes.modes import Precision

PROBED: Final = ("add", "sub", "mul", "div", "sqrt", "floor", "fma", "convert")
"""The operations that are probed; `convert` converts a float to an int."""
_OF_COMPILERS: Final = frozenset({"zeros", "exits"})
FAULTS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("add", "sub", "mul", "floor", "convert"), "none that was run; programs with it are refused"),
    "div": "NVIDIA's OpenGL 580.159; OpenCL 1.2 allows it",
    "sqrt": "NVIDIA's OpenGL 580.159; OpenCL 1.2 allows it",
    "fma": "llvmpipe and rusticl of Mesa 22.3 to 26.1; GLSL 4.00 allows it",
    "convert_nan": "Intel's CPU runtime, PoCL of PyPI, NVIDIA's OpenCL 580.159, rusticl of 22.3; OpenCL 1.2 allows it",
    "denormals": "llvmpipe of Mesa 22.3 to 26.1, NVIDIA's OpenGL 580.159; GLSL 3.30 allows it",
    "zeros": "NVIDIA's OpenCL 580.159, rusticl of Mesa 22.3 and 25.0; goes when NVIDIA's and Debian 13's are right",
    "exits": "llvmpipe and rusticl of Mesa 22.3, not of 25.0; goes with Debian 12 (support ends in June 2028)",
}
"""Faults of a device, each with the drivers that have it and when it can go; one that a standard allows stays.

They are wrong operations; ints of NaN that are not 0; denormals that become zero; a compiler that takes `0 * x` for 0
or `x < 0 ? x : 0` for a minimum of any zeros; and one that leaves loops before the conditions of their exits hold.
"""
COUNT: Final = 2048
"""Triples of inputs."""
_TINY: Final = np.float32(2.0**-126)
_NAMES: Final = {"convert_nan": "int of NaN"}


@cache
def hard_inputs() -> tuple[Array, Array, Array]:
    """Return a, b and c, each COUNT binary32 numbers.

    In the first half no result is denormal and c < 0. A third of it are quotients and a third are roots that lie as
    close as possible to the middle of two binary32 numbers; the rest are random. There c is about -a * b, so that fma
    gives the error of the product. The second half has the same mantissas, c > 0, and a * b is denormal.
    """
    third = COUNT // 6
    divisor, root = 2**23 + _scattered(0, 23), 2**23 + _scattered(1, 23)
    middle = 2**24 + _scattered(2, 24) | 1
    product = divisor * middle
    dividend = (product + 2**24) >> 25
    closest = np.argsort(np.abs(product - (dividend << 25)))[:third]
    square = (2 * root + 1) ** 2
    radicand = (square + 2**25) >> 26
    nearest = np.argsort(np.abs(square - (radicand << 26)))[:third]
    rest = COUNT // 2 - 2 * third
    x, y = ((2**23 + _scattered(n, 23)[:rest]) * 2.0 ** (_scattered(n + 2, 6)[:rest] - 54) for n in (3, 4))
    a = np.concatenate([dividend[closest], radicand[nearest], x]).astype(np.float32)
    b = np.concatenate([divisor[closest], root[nearest], y]).astype(np.float32)
    small = np.frexp(a)[0] * np.float32(2.0**-64), np.frexp(b)[0] * np.float32(2.0**-64)
    c = np.frexp(a * b)[0] * np.float32(2.0**-126)
    return np.concatenate([a, small[0]]), np.concatenate([b, small[1]]), np.concatenate([-(a * b), c])


def _scattered(stream: int, bits: int) -> Array:
    """Return 4,096 ints of `bits` bits by PCG's output function: numpy's generators take long to import."""
    state = (np.arange(1 + 4096 * stream, 4097 + 4096 * stream, dtype=np.uint64) * 747796405 + 2891336453) & 0xFFFFFFFF
    word = (((state >> ((state >> 28) + 4)) ^ state) * 277803737) & 0xFFFFFFFF
    return ((word >> 22) ^ word).astype(np.int64) & ((1 << bits) - 1)


def wrong_operations(answers: Mapping[str, Array]) -> frozenset[str]:
    """Return the operations of PROBED whose results for the hard inputs are not exact to the bit, and "denormals".

    Where a device makes zeros of all products that are denormal, denormal results are not compared.
    """
    a, b, c = hard_inputs()
    exact = {"add": a + b, "sub": a - b, "mul": a * b, "div": a / b, "sqrt": np.sqrt(a), "floor": np.floor(a),
             "fma": fma(a, b, c),
             "convert": np.clip(a.astype(np.float64), 0, 2.0**31 - 1).astype(np.int32)}  # fmt: skip
    denormal = np.abs(exact["mul"]) < _TINY
    flushed = "mul" in answers and not np.any(answers["mul"][denormal])
    wrong = {"denormals"} if flushed else set()
    for name, results in answers.items():
        compared = ~(np.abs(exact[name]) < _TINY) | (exact[name] == 0) if flushed else np.full(COUNT, True)
        if flushed and name == "fma":
            compared &= c < 0  # c itself is denormal
        if not np.array_equal(results[compared], exact[name][compared]):
            wrong.add(name)
    return frozenset(wrong)


def is_exact_in_binary64(answers: Mapping[str, Array], *, flushed: bool) -> bool:
    """Return whether operations of binary64 on the hard inputs have given the exact results, bit for bit.

    `answers` has some of the results that `in_binary64` makes, by name. Where the device makes zeros of denormals of
    binary32 (`flushed`), only the half of the inputs without them is compared.
    """
    exact = in_binary64()
    compared = slice(COUNT // 2 if flushed else COUNT)
    if "fma" in answers:  # `fma` takes long
        exact = exact | {"fma": fma(exact["x"], exact["mul"], -exact["x"])}
    return all(np.array_equal(values[compared], exact[name][compared]) for name, values in answers.items())


@cache
def in_binary64() -> dict[str, Array]:
    """Return the exact results, in binary64, of the operations of a probe on the hard inputs a, b and c.

    `x` is a * b, which is exact, and the other operand `mul` is x * c, which is rounded. `narrow` is rounded to
    binary32: of ties in the first half, and with denormal results in the second.
    """
    a, b, c = (array.astype(np.float64) for array in hard_inputs())
    x = a * b
    y = x * c
    half = COUNT // 2
    return {
        "x": x,
        "mul": y,
        "add": x + y,
        "sub": a - y,
        "div": x / y,
        "sqrt": np.sqrt(x),
        "floor": np.floor(a * 0.3),
        "narrow": np.concatenate([a[:half] * 1.5, x[half:]]).astype(np.float32),
    }


NO_BINARY64: Final = (
    "this device does not compute exactly in binary64: strict mode refuses the elementary functions here; "
    'math="portable" has all'
)


EMULATED: Final = "this device has no exact fma of this precision: fuse=True is slower here than without it"
"""The note on kernels with `fuse` where each fused multiply-add takes several operations."""


def emulates_fma(wrong: Collection[str], precision: Precision) -> bool:
    """Return whether a device with these faults computes a fused multiply-add by several operations."""
    return "fma" in wrong or precision == "f16"


def notes_of(wrong: Iterable[str], *, binary64: bool) -> tuple[str, ...]:
    """Describe a device: operations that are corrected or cannot be, binary64 that it lacks, and flushed denormals."""
    operations = set(wrong) - {"denormals", *_OF_COMPILERS}
    notes = []
    if corrected := sorted(operations & CORRECTABLE):
        names = " and ".join(_NAMES.get(name, name) for name in corrected)
        notes.append(f"this device gets {names} wrong: strict and relaxed mode correct it")
    if hopeless := sorted(operations - CORRECTABLE):
        notes.append(f"this device gets {' and '.join(hopeless)} wrong: strict mode refuses programs with it")
    if not binary64:
        notes.append(NO_BINARY64)
    if "zeros" in wrong:
        notes.append(
            "this device confuses zeros (0 * x with 0, or -0.0 with 0.0): strict and relaxed mode hide them from it"
        )
    if "exits" in wrong:
        notes.append("this device gets exits of loops wrong: what they compare is hidden from its compiler")
    if "denormals" in wrong:
        notes.append("this device flushes denormals to zero")
    return tuple(notes)


def uncorrected(wrong: frozenset[str]) -> frozenset[str]:
    """Return the faults of a device by which its bits in strict mode may differ from numpy's."""
    return wrong - CORRECTABLE - _OF_COMPILERS


def refuse_wrong(module: Module, wrong: Iterable[str], device: str) -> None:
    """Raise CompileError if a prepared module has an operation that the device rounds wrongly and no pass corrects."""
    hopeless = set(wrong) - CORRECTABLE
    if not hopeless:
        return
    for function in module.functions:
        for s in walk(function.body):
            if isinstance(s, Let) and s.op in hopeless:
                raise CompileError(f"{device} gets {s.op} wrong", loc=s.value.loc, cure='math="relaxed"')
