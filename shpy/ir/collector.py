"""Python's cycle collector, paused while a program is recorded or compiled.

The nodes of the IR name each other by id, so there are no cycles among them for the collector to find; its walks over
hundreds of thousands of new nodes take a third of the time, and more than in proportion as a program grows.

    with uncollected():
        text = print_kernel(prepare(module, options, target).module).text
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["uncollected"]


@contextmanager
def uncollected() -> Iterator[None]:
    """The block runs without the collector, which is left as it was found."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
