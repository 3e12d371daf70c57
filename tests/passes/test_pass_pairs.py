"""`fold` keeps the bits of programs of one or two operations: each operation, at the edges of every type."""

from collections.abc import Callable

import numpy as np
import pytest

from shpy.ir.builder import Builder
from shpy.ir.constants import DTYPES
from shpy.ir.interpreter import Interpreter
from shpy.ir.nodes import Module, Port, Value
from shpy.ir.ops import OPS
from shpy.ir.types import Base, vec
from shpy.ir.verifier import verify
from shpy.passes.dead import remove_dead
from shpy.passes.fold import fold

EDGES = {
    Base.F: [0.0, -0.0, 0.5, -1.0, 3.0, 1e-45, -3e38, np.inf, -np.inf, np.nan],
    Base.I: [0, 1, -1, 2, -7, 2**31 - 1, -(2**31)],
    Base.U: [0, 1, 2, 7, 2**31, 2**32 - 1],
    Base.B: [False, True],
}
UNARY = {
    base: [n for n, op in OPS.items() if op.takes == ("T",) and op.gives == "T" and base in op.bases] for base in EDGES
}
BINARY = {
    base: [n for n, op in OPS.items() if op.takes == ("T", "T") and op.gives == "T" and base in op.bases]
    for base in EDGES
}


def agrees(base: Base, make: Callable[[Builder, Value], Value]) -> bool:
    """Return whether `fold` changes what `make` builds of one input; raise AssertionError where the bits differ.

    The module is built and not read from a text: to parse 2,500 texts took two thirds of the time.
    """
    b, t = Builder("main"), vec(base)
    b.store(b.output(t, "o"), make(b, b.input(t, "x")))
    module = Module("m", (Port("x", ""),), (Port("o", ""),), (), (), (b.finish(),))
    verify(module)
    changed = remove_dead(fold(module))
    if changed == module:
        return False
    one, other = Interpreter(module), Interpreter(changed)
    with np.errstate(all="ignore"):
        for x in np.array(EDGES[base], DTYPES[base]):
            (before,), _ = one.run_element((x,))
            (after,), _ = other.run_element((x,))
            same = np.asarray(before).tobytes() == np.asarray(after).tobytes()
            assert same or (before != before and after != after), f"{x} gives {after}, not {before}, in\n{module}"
    return True


@pytest.mark.parametrize("base", EDGES, ids=str)
def test_an_operation_after_another(base):
    ops = UNARY[base]
    assert {"neg", "abs"} <= set(ops) or base is Base.B
    changed = [agrees(base, lambda b, x, i=i, o=o: b.let(o, b.let(i, x))) for i in ops for o in ops]
    assert any(changed)


@pytest.mark.parametrize("base", EDGES, ids=str)
def test_an_operation_of_a_value_and_itself_or_a_number(base):
    numbers = {Base.B: [False, True], Base.F: [0.0, -0.0, 1.0, 2.0, -1.0]}.get(base, [0, 1, 2])
    numbers += {Base.I: [-1], Base.U: [2**32 - 1]}.get(base, [])
    for op in BINARY[base]:
        agrees(base, lambda b, x, op=op: b.let(op, x, x))
        for number in numbers:
            agrees(base, lambda b, x, op=op, n=number: b.let(op, x, b.const(vec(base), [n])))
            agrees(base, lambda b, x, op=op, n=number: b.let(op, b.const(vec(base), [n]), x))
