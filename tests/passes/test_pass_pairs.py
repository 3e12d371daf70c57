"""`fold` keeps the bits of programs of one or two operations: each operation, at the edges of every type."""

import itertools

import numpy as np
import pytest

from shpy.ir.constants import DTYPES
from shpy.ir.interpreter import Interpreter
from shpy.ir.ops import OPS
from shpy.ir.parser import parse
from shpy.ir.types import Base
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


def agrees(base: Base, body: str) -> bool:
    """Return whether the body's %3 of %0 and %1 is the same after `fold`; raise AssertionError where it differs."""
    t = base.value
    module = parse(
        f"module m\ninput x: Attrib1{t}\ninput y: Attrib1{t}\noutput o: Attrib1{t}\n\n"
        f"function main(%x.0: {t}, %y.1: {t}) -> ($o.0: {t}) {{\n{body}\nstore $o.0 = %3\n}}\n"
    )
    verify(module)
    changed = remove_dead(fold(module))
    if changed == module:
        return False
    one, other = Interpreter(module), Interpreter(changed)
    with np.errstate(all="ignore"):
        for given in itertools.product(np.array(EDGES[base], DTYPES[base]), repeat=2):
            (wanted,), _ = one.run_element(given)
            (found,), _ = other.run_element(given)
            same = np.asarray(wanted).tobytes() == np.asarray(found).tobytes()
            assert same or (wanted != wanted and found != found), f"{body} of {given}: {found}, not {wanted}"
    return True


@pytest.mark.sampled(2)
@pytest.mark.parametrize("base", EDGES, ids=str)
def test_an_operation_after_another(base):
    ops = UNARY[base]
    assert {"neg", "abs"} <= set(ops) or base is Base.B
    t = base.value
    changed = [agrees(base, f"%2: {t} = {a} %x.0\n%3: {t} = {b} %2") for a in ops for b in ops]
    assert any(changed)


@pytest.mark.parametrize("base", EDGES, ids=str)
def test_an_operation_of_a_value_and_itself_or_a_number(base):
    t = base.value
    numbers = {Base.B: ["false", "true"], Base.F: ["0.0", "-0.0", "1.0", "2.0", "-1.0"]}.get(base, ["0", "1", "2"])
    numbers += {Base.I: ["-1"], Base.U: [str(2**32 - 1)]}.get(base, [])
    for op in BINARY[base]:
        agrees(base, f"%3: {t} = {op} %x.0, %x.0")
        for number in numbers:
            agrees(base, f"%2: {t} = const {number}\n%3: {t} = {op} %x.0, %2")
            agrees(base, f"%2: {t} = const {number}\n%3: {t} = {op} %2, %x.0")
