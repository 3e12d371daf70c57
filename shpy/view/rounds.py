"""Loops in a view: the streams that a kernel read in the last round in which it wrote an element.

Stage: view. A loop keeps no rounds, so the chain runs once more, and copies the streams before each execution of the
kernel: the device counts in which of them it wrote the element.

    read_before(chain, member, (3, 5), moment, streams, "opencl")      # {"u": stream, "k": 4}
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from shpy.chains.chain import Chain, Sequence
from shpy.chains.member import Member
from shpy.chains.running import Run
from shpy.display.screen import Moment
from shpy.ieee import in_ieee_arithmetic
from shpy.pictures.evolution import arguments_of


class _Watch(Chain):
    """The part of a chain that stands before a kernel and copies the streams that it reads."""

    def __init__(self, member: Member, at: tuple[int, int]) -> None:
        super().__init__(())
        self.read: dict[str, Any] = {}
        """The streams before the last execution that wrote the element, or before the first if none wrote it."""
        self._member, self._at = member, at
        self._latest: dict[str, Any] | None = None
        self._count = 0

    def perform(self, run: Run) -> None:
        """Copy the streams."""
        self.take_latest(run)
        now = run.current | run.numbers
        self._latest = {name: now[name].copy() for name in self._member.inputs if name in now}

    def take_latest(self, run: Run) -> None:
        """Keep the copies of the latest execution if it wrote the element."""
        run.flush()
        times = run.current.get(("times", self._member))
        count = int(np.asarray(times)[self._at]) if times is not None else 0
        if self._latest is not None and (count > self._count or not self.read):
            self.read = self._latest
        self._count = count


@in_ieee_arithmetic
def read_before(
    chain: Chain, member: Member, at: tuple[int, int], moment: Moment, streams: Mapping[str, Any], backend: str
) -> dict[str, Any]:
    """Return the streams and numbers that a kernel of a loop read when it last wrote the element `at`, by name.

    The chain runs over `streams`, as `evolution.stepped` runs it. Where no round wrote the element, they are those that
    the kernel read in the first round.
    """
    watch = _Watch(member, at)
    watched = _with(chain, watch, member)
    arguments, shape = arguments_of(watched, moment, streams)
    run = Run(watched, arguments, shape, backend, None, None)
    run.result()
    watch.take_latest(run)
    return {name: np.asarray(value)[()] if value.shape == () else value for name, value in watch.read.items()}


def _with(node: Chain | Member, watch: _Watch, member: Member) -> Any:
    """Return a part of a chain with the watch before each execution of the member."""
    if isinstance(node, Chain):
        return node.with_members(tuple(_with(part, watch, member) for part in node.members))
    return Sequence((watch, node)) if node is member else node
