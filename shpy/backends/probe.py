"""What a device gets wrong: the operations that everything else is built from, on inputs chosen to be hard.

Stage: compile. Each device is asked once, by a program of its backend's own; here are the inputs, the exact results and
what follows. A division or root that is wrong is lowered to a corrected one, anything else is an error of compiling.

    a, b = hard_inputs()
    wrong = wrong_operations({"div": ..., "sqrt": ..., ...})      # frozenset() where all is well
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from typing import Final

import numpy as np

from shpy.backends.base import Array
from shpy.errors import CompileError
from shpy.ir.nodes import Let, Module
from shpy.ir.traverse import walk
from shpy.passes.library import CORRECTABLE

__all__ = ["COUNT", "PROBED", "hard_inputs", "notes_of", "refuse_wrong", "wrong_operations"]

PROBED: Final = ("add", "sub", "mul", "div", "sqrt", "floor", "convert")
"""What is asked: `convert` is a float to an int."""
COUNT: Final = 1024
"""Pairs of inputs."""


@cache
def hard_inputs() -> tuple[Array, Array]:
    """Two arrays of COUNT positive binary32 numbers; no sum, product, quotient or root of them is a denormal.

    A third each: quotients and roots that lie as close as possible to the middle of two numbers, and others.
    """
    third = COUNT // 3
    divisor, root = 2**23 + _scattered(0, 23), 2**23 + _scattered(1, 23)
    middle = 2**24 + _scattered(2, 24) | 1
    product = divisor * middle
    dividend = (product + 2**24) >> 25
    closest = np.argsort(np.abs(product - (dividend << 25)))[:third]
    square = (2 * root + 1) ** 2
    radicand = (square + 2**25) >> 26
    nearest = np.argsort(np.abs(square - (radicand << 26)))[:third]
    rest = COUNT - 2 * third
    x, y = ((2**23 + _scattered(n, 23)[:rest]) * 2.0 ** (_scattered(n + 2, 6)[:rest] - 54) for n in (3, 4))
    a = np.concatenate([dividend[closest], radicand[nearest], x])
    b = np.concatenate([divisor[closest], root[nearest], y])
    return a.astype(np.float32), b.astype(np.float32)


def _scattered(stream: int, bits: int) -> Array:
    """4,096 whole numbers of so many bits, by PCG's output function; numpy's generators take long to import."""
    state = (np.arange(1 + 4096 * stream, 4097 + 4096 * stream, dtype=np.uint64) * 747796405 + 2891336453) & 0xFFFFFFFF
    word = (((state >> ((state >> 28) + 4)) ^ state) * 277803737) & 0xFFFFFFFF
    return ((word >> 22) ^ word).astype(np.int64) & ((1 << bits) - 1)


def wrong_operations(found: Mapping[str, Array]) -> frozenset[str]:
    """The operations of PROBED whose results, for the hard inputs, differ from the exact ones in a bit."""
    a, b = hard_inputs()
    exact = {"add": a + b, "sub": a - b, "mul": a * b, "div": a / b, "sqrt": np.sqrt(a), "floor": np.floor(a),
             "convert": np.clip(a.astype(np.float64), 0, 2.0**31 - 1).astype(np.int32)}  # fmt: skip
    return frozenset(name for name, results in found.items() if not np.array_equal(results, exact[name]))


def notes_of(wrong: Iterable[str]) -> tuple[str, ...]:
    """What to tell of a device: which operations are mended, and which cannot be."""
    notes = []
    if mended := sorted(set(wrong) & CORRECTABLE):
        notes.append(f"this device rounds {' and '.join(mended)} wrong: strict and relaxed mode correct it")
    if hopeless := sorted(set(wrong) - CORRECTABLE):
        notes.append(f"this device gets {' and '.join(hopeless)} wrong: strict mode refuses programs with it")
    return tuple(notes)


def refuse_wrong(module: Module, wrong: Iterable[str], device: str) -> None:
    """CompileError if a prepared module has an operation that the device gets wrong and nothing corrects."""
    hopeless = set(wrong) - CORRECTABLE
    if not hopeless:
        return
    for function in module.functions:
        for s in walk(function.body):
            if isinstance(s, Let) and s.op in hopeless:
                raise CompileError(f"{device} gets {s.op} wrong", loc=s.value.loc, cure='math="relaxed"')
