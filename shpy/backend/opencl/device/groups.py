"""The work group of a kernel: as large as its local arrays allow, which a processor's driver puts on a thread's stack.

Stage: compile. Over the bound packets become narrower first, then groups smaller. A kernel of which not even one work
item fits is refused before the driver sees it, since the driver would build it, and end the process in some later run.

    lanes = starting_width(machine, module, "f32")
    group = group_of(machine, kernel)               # CompileError at the line of the largest array
"""

from __future__ import annotations

from shpy.backend.opencl.device.dispatch import LOCAL_SIZE, PACKETS
from shpy.backend.opencl.device.driver import Machine
from shpy.backend.opencl.text.kernel import Kernel
from shpy.ir.nodes import Module
from shpy.passes.modes import Precision
from shpy.passes.private import check_private, private_memory


def starting_width(machine: Machine, module: Module, precision: Precision) -> int:
    """Return the widest packets, up to the device's vectors, of which a whole group's local arrays fit."""
    each = private_memory(module).size * (2 if precision == "f64" else 1)
    widths = [lanes for lanes in machine.widths if lanes <= machine.lanes]
    return max((n for n in widths if n * PACKETS * each <= machine.most_private), default=min(widths))


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
