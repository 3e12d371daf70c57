"""Dispatches of OpenCL: how a run becomes one or several launches of its kernel.

Stage: run. PoCL generates code anew for each local size, for a global offset that is not 0, and for the first launch
of 65,535 or more work items along an axis. So a kernel has one local size, its second argument is where a dispatch
begins (0 whenever no run is under way), and its first launch has `driver.ANY_SIZE` work items, most of them idle:
that code serves smaller launches too.

    launch(machine, kernel, args, Items(4096), LOCAL_SIZE, pace, 1)
    start = starter(machine, kernel, args, Items(64, 48), PACKETS, pace, 16, brief=False)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from shpy.backends.device.pace import Pace
from shpy.backends.opencl.device.driver import Machine

__all__ = ["LOCAL_SIZE", "PACKETS", "Items", "launch", "starter"]

LOCAL_SIZE: Final = 64
"""Work items of a group."""
PACKETS: Final = 16
"""Packets of a group: each is as much work as many elements."""


class Items(NamedTuple):
    """The work items of a run: those of a list (`lines` None), or `columns` in each of so many lines."""

    columns: int
    lines: int | None = None

    @property
    def rows(self) -> int:
        """The extent of the second axis."""
        return 1 if self.lines is None else self.lines


def launch(machine: Machine, kernel: Any, args: list[Any], items: Items, group: int, pace: Pace, each: int) -> None:
    """Run a kernel over work items, and as many idle ones as fill each line's last group.

    In as many dispatches as `pace` says, where an item stands for `each` elements. A dispatch begins with a line, or
    with an item of a list. Ctrl-C ends the wait for it.
    """
    groups = max(1, -(-items.columns // group))
    kernel.set_args(*args)
    # Whole lines, or groups of a list; each core should have a group.
    rows, width = (groups, group) if items.lines is None else (items.lines, items.columns)
    least = -(-machine.device.max_compute_units * group // width)
    if pace.is_brief(groups * group * items.rows * each):  # the host waits when it reads
        machine.cl.enqueue_nd_range_kernel(machine.queue, kernel, (groups * group, items.rows), (group, 1))
        return
    start = type(args[1])
    try:
        for first, count in pace.parts(rows, width * each, least):
            size = (count * group, 1) if items.lines is None else (groups * group, count)
            kernel.set_arg(1, start(first * group if items.lines is None else first))
            machine.waiter.wait(machine.cl.enqueue_nd_range_kernel(machine.queue, kernel, size, (group, 1)))
    finally:
        kernel.set_arg(1, args[1])  # a later run that fits in one dispatch sets no argument


def starter(
    machine: Machine,
    kernel: Any,
    args: list[Any],
    items: Items,
    group: int,
    pace: Pace,
    each: int,
    *,
    brief: bool,
    once: bool = False,
) -> Callable[[], None]:
    """Return what starts a kernel, whose arguments nobody else sets, as `launch` runs it; or anybody, with `once`.

    It waits where the run takes several dispatches, or where it is not known yet whether it does; with `brief`,
    unless the run is known to be brief.
    """
    groups = max(1, -(-items.columns // group))
    size = (groups * group, items.rows)
    if not once:
        kernel.set_args(*args)
    enqueue, queue, elements = machine.cl.enqueue_nd_range_kernel, machine.queue, size[0] * size[1] * each

    def start() -> None:
        if pace.is_brief(elements) if brief else pace.fits(elements):
            if once:
                kernel.set_args(*args)
            machine.may_take_long |= not pace.was_brief(elements)
            enqueue(queue, kernel, size, (group, 1))
        else:
            launch(machine, kernel, args, items, group, pace, each)

    return start
