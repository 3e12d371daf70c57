"""The private memory of a program: its local arrays, with all calls inlined, as drivers' compilers do it.

Stage: improve; it changes nothing. A processor's driver lays the arrays of a whole work group on the stack of a thread,
and ends the process where they do not fit. So a backend asks for their size before it builds a kernel.

    private_memory(module, of).size        # bytes of an element, or of a packet; `of` returns those of one variable
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from shpy.errors import CompileError
from shpy.ir.nodes import Loc, Module, Variable
from shpy.ir.traverse import calls_of
from shpy.ir.types import Base

WORD = 4
"""Bytes of a component in private memory: bools are ints there."""


@dataclass(frozen=True, slots=True)
class Private:
    """The bytes of all local arrays of an element or packet, and the line of the array that takes most of them."""

    size: int = 0
    loc: Loc | None = None


NONE = Private()


def check_private(private: Private, most: int, work: str, device: str, cure: str) -> None:
    """Raise CompileError, at the line of the largest array, if the arrays of `work` take more than `most` bytes."""
    if private.size > most:
        raise CompileError(
            f"the local arrays of {work} take {private.size:,} bytes, more than the {most:,} that are safe on {device}",
            loc=private.loc,
            cure=cure,
        )


def bytes_of(variable: Variable) -> int:
    """Return the bytes of a local array of one element: a vector of three takes as much as one of four."""
    type = variable.type
    each = 2 * WORD if type.base is Base.D else WORD
    return (variable.length or 0) * each * (4 if type.size == 3 else type.size)


def private_memory(module: Module, of: Callable[[Variable], int] = bytes_of) -> Private:
    """Return the private memory of a module, in time that is linear in its size; `of` returns the bytes of an array.

    Each call of a function counts, since compilers give each inlined copy arrays of its own.
    """
    copies = dict.fromkeys((f.name for f in module.functions), 0)
    copies[module.entry.name] = 1
    total, largest, loc = 0, 0, None
    for function in reversed(module.functions):
        times = copies[function.name]
        for name in calls_of(function):
            copies[name] += times
        for variable in function.variables:
            if variable.length is not None:
                size = times * of(variable)
                total += size
                if size > largest:
                    largest, loc = size, variable.loc or function.loc
    return Private(total, loc)
