"""The packets of a kernel and its work group, by a rule: wide where that hides latency, and as large as memory allows.

Stage: compile. A value of a packet lies in one or several vector registers of the processor. In several, operations do
not wait for each other; in too many, values leave the registers. A processor's driver puts the local arrays of a group
on a thread's stack: over the bound packets become narrower first, then groups smaller. A kernel of which not even one
work item fits is refused before the driver sees it, since the driver would build it, and end the process in a later
run.

    lanes, near = widths_of(machine, prepared.module, "f32")
    group = group_of(machine, kernel)               # CompileError at the line of the largest array
"""

from __future__ import annotations

from typing import Final

from shpy.backend.opencl.device.dispatch import LOCAL_SIZE, PACKETS
from shpy.backend.opencl.device.driver import Machine
from shpy.backend.opencl.text.kernel import Kernel
from shpy.ir.nodes import Function, Loop, Module, Store
from shpy.ir.traverse import variables_of, walk
from shpy.passes.modes import Precision
from shpy.passes.private import check_private, private_memory

_REGISTERS: Final = 32
"""The vector registers that the numbers which a loop carries may fill.

CPU milliseconds at 16, 32 and 64 lanes on AVX-512, whose registers hold 16 (PoCL 3.1, least of 8 rounds in
alternation): a polynomial, which has no loop, 7.4, 5.7, 4.2, and a shader 18.9, 14.6, 11.6; mandelbrot, whose loop
carries 5 numbers, 20.7, 16.3, 15.8; spheres, with 14 numbers, 11.7, 11.9, 13.3. At 16 and 32 lanes, pictures whose
loops carry 56 numbers and more: `mixed` 68 and 91, `glass` 169 and 180, `cornell`, path traced, 97 and 104.
"""
_MOST_EACH: Final = 4
"""The most registers of a value."""
_MOST_OF_LARGE: Final = 2
"""The most registers of a value in a program of more than `_LARGE` statements, and where neighbours in a grid are read.

Wider packets take 1.6 times as long to compile. As above: primary rays 22.4, 21.5, 23.9; blur 6.3, 5.0, 5.2; Gray-Scott
of 256 columns, of whose packets of 64 half stand at a border, 44.9, 41.2, 44.2.
"""
_LARGE: Final = 400


def widths_of(machine: Machine, module: Module, precision: Precision) -> tuple[int, int]:
    """Return the lanes of a prepared module's packets, and those where it reads neighbours in a grid."""
    each = private_memory(module).size
    fitting = [n for n in machine.widths if n * PACKETS * each <= machine.most_private] or [min(machine.widths)]
    register = machine.lanes // (2 if precision == "f64" else 1)
    loops = [_carried(f, s) for f in module.functions for s in walk(f.body) if isinstance(s, Loop)]
    most = min(_MOST_EACH, _REGISTERS // max(loops, default=1) or 1) * register
    most_of_large = min(most, _MOST_OF_LARGE * register)
    if sum(1 for f in module.functions for _ in walk(f.body)) > _LARGE:
        most = most_of_large
    return _widest(fitting, most), _widest(fitting, most_of_large)


def _widest(widths: list[int], most: int) -> int:
    return max((n for n in widths if n <= most), default=min(widths))


def _carried(function: Function, loop: Loop) -> int:
    """Return how many numbers a loop stores, so that the next iteration may read them; at least 1."""
    stored = {s.variable for s in walk(loop.body) if isinstance(s, Store)}
    return sum(v.type.size for v in variables_of(function) if v.id in stored) or 1


def whole_group(lanes: int) -> int:
    """Return the work items of a group of a kernel without large local arrays."""
    return LOCAL_SIZE if lanes == 1 else PACKETS


def group_of(machine: Machine, kernel: Kernel) -> int:
    """Return the work items of a group; CompileError if the local arrays of a single one do not fit."""
    group, size = whole_group(kernel.lanes), kernel.private.size
    most = machine.most_private if size else 0
    work = "an element" if kernel.lanes == 1 else f"a packet of {kernel.lanes} elements"
    cure = 'smaller arrays, or compile("numpy")' if kernel.lanes == 1 else 'lanes="auto", or smaller arrays'
    check_private(kernel.private, most, work, machine.device.name.strip(), cure)
    while machine.shares_stack and group * size > most:
        group //= 2
    return group
