"""Dispatches of OpenCL: how a run becomes one or several launches of its kernel.

Stage: run. PoCL generates code anew for each local size, for a global offset that is not 0, and for the first launch
of 65,535 or more work items along an axis. So a kernel has one local size, its second argument is where a dispatch
begins, and its first launch has `driver.ANY_SIZE` work items, most of them idle: that code serves smaller launches too.

    start = starter(machine, kernel, args, Items(64, 48), PACKETS, pace, 16, reads=False)
    start()
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from shpy.backend.device.pace import Pace
from shpy.backend.opencl.device.driver import Machine

LOCAL_SIZE: Final = 64
"""Work items of a group."""
PACKETS: Final = 16
"""Packets of a group; fewer than LOCAL_SIZE, since a packet computes several elements."""


class Items(NamedTuple):
    """The work items of a run: those of a list (`lines` None), or `columns` in each of so many lines."""

    columns: int
    lines: int | None = None


def starter(
    machine: Machine,
    kernel: Any,
    args: list[Any],
    items: Items,
    group: int,
    pace: Pace,
    each: int,
    *,
    reads: bool,
    shared: bool = False,
) -> Callable[[], None]:
    """Return a function that runs a kernel over work items, each of which stands for `each` elements.

    As many idle ones fill each line's last group. A dispatch begins with a line, or with a group of a list; see `Pace`
    for how many there are and what `reads` means. With `shared` others set the kernel's arguments, too.
    """
    groups = max(1, -(-items.columns // group))
    listed = items.lines is None
    rows, width, step = (groups, group, group) if items.lines is None else (items.lines, items.columns, 1)
    least = -(-machine.device.max_compute_units * group // width)  # each core should have a group
    elements = rows * width * each
    enqueue, queue, start = machine.cl.enqueue_nd_range_kernel, machine.queue, type(args[1])
    moved = False  # whether the kernel may hold another beginning than 0, also after Ctrl-C at any line

    def dispatch(first: int, count: int) -> Any:
        nonlocal moved
        size = (count * group, 1) if listed else (groups * group, count)
        if not reads:
            machine.may_take_long |= not pace.was_brief(elements)
        if first or moved:
            moved = True
            kernel.set_arg(1, start(first * step))
            moved = first > 0
        return enqueue(queue, kernel, size, (group, 1))

    run = pace.driver(rows, dispatch, machine.waiter.wait, width * each, least, reads=reads)
    if not shared:
        kernel.set_args(*args)
        return run

    def set_and_run() -> None:
        kernel.set_args(*args)
        run()

    return set_and_run
