"""Find reads of tables in loops whose index is the sum of a varying and a loop-invariant part.

Stage: emit. The compiler computes the address of the invariant part once, before the loop:

    records[row + side]   ->   (records + side)[row]          for a `side` that is made before the loop

The sum must not wrap, as addresses have 64 bits. A chain of dependent reads, as in a walk through a tree, gets shorter.
Without it, a picture of glass of 254,000 triangles takes 1.04 times the CPU time, and a quarter of a million rays in
random directions as long (PoCL 3.1 with AVX-512).

    steady_parts(survey, Known(function))[read.value.id] == (row, side)
"""

from __future__ import annotations

from shpy.backend.emit.survey import Survey
from shpy.passes.known import Ranges


def steady_parts(survey: Survey, ranges: Ranges) -> dict[int, tuple[int, int]]:
    """Return the changing and the steady part of the index of each read that has both, by the value that is read."""
    parts_by_value: dict[int, tuple[int, int]] = {}
    for value, read in survey.lets.items():
        loop = survey.loop_of(value)
        if read.op != "table" or loop is None or read.value.type.size == 3:  # float3 is packed behind scalars
            continue
        total = survey.lets.get(read.args[0])
        if total is None or total.op != "add" or total.value.type.size > 1 or ranges.may_wrap(total):
            continue
        # A value in scope is computed in this loop or in one around it.
        inside = [survey.loop_of(a) == loop for a in total.args]
        if any(inside) and not all(inside):
            changing, steady = total.args if inside[0] else total.args[::-1]
            parts = [survey.lets.get(part) for part in (changing, steady)]
            if parts[0] is not None and all(part is None or part.op != "const" for part in parts):
                parts_by_value[value] = changing, steady
    return parts_by_value
