"""Results are written where they belong: a pass over the output tree.

Stage: emit. A stencil does little for each element, and a copy of its result would take as long as an addition. So the
operation that computes an output, where it is the last one, is given the memory of that output.

    def relax(u, place, lanes):             def relax(u, place, lanes, out):
        return 0.25 * (...)           ->        return np.multiply(0.25, ..., out=out)
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Final

from shpy.backend.emit import tree
from shpy.backend.emit.names import Names
from shpy.backend.emit.tree import Assign, Block, Exit, Expr, Name, Named, Operator, Tuple, several
from shpy.ir.nodes import Variable

_UFUNCS: Final = {"+": "np.add", "-": "np.subtract", "*": "np.multiply", "/": "np.divide"}


def written(
    block: Block, outputs: Sequence[Variable], varying: Collection[int], names: Names
) -> tuple[Block, dict[int, Name]]:
    """Return a function's body with results written in place, and names for the memory by the number of the output.

    Only an output of one number a lane is written in place: `varying` are the variables that differ between lanes.
    """
    last, statements = block[-1], list(block)
    memory: dict[int, Name] = {}
    if not isinstance(last, Exit) or last.value is None:
        return block, memory
    results = list(last.value.args if isinstance(last.value, Tuple) else (last.value,))
    for at, output in enumerate(outputs):
        index, e = _computed(block, results[at])
        if not (isinstance(e, Operator) and e.symbol in _UFUNCS and len(e.args) == 2):
            continue
        if not (output.type.size == 1 and output.id in varying):
            continue
        out = Name(output.type, names.take("out" if len(outputs) == 1 else f"{output.name}_out"))
        memory[at] = out
        operation = tree.call(_UFUNCS[e.symbol], e.type, *e.args, Named(e.type, "out", out))
        if index is None:
            results[at] = operation
        else:
            assigned = block[index]
            assert isinstance(assigned, Assign)
            statements[index] = replace(assigned, value=operation)
    statements[-1] = replace(last, value=several(results))
    return tuple(statements), memory


def _computed(block: Block, result: Expr) -> tuple[int | None, Expr]:
    """Return a result's expression, and the index of the assignment right before the return that holds it."""
    for index in range(len(block) - 2, -1, -1):
        s = block[index]
        if not isinstance(s, Assign):
            break
        if s.target == result:
            return index, s.value
    return None, result
