"""`inline_independent`: functions that ignore their arguments; and numpy's loops that leave with such a result."""

from __future__ import annotations

import numpy as np
from backends.running import covering
from passes.before_after import module, text

import shpy as sh
from shpy import SH_BREAK, SH_WHILE
from shpy.ir.verifier import verify
from shpy.passes.inline import inline_independent

FUNCTIONS = """\
pure function half(%a.0: f) -> ($r.0: f) {
  %1: f = param sky
  %2: f = const 0x1p-1
  %3: f = mul %1, %2
  %4: f = add %a.0, %3
  store $r.0 = %3
}

pure function twice(%a.0: f) -> ($r.0: f) {
  %1: f = call half(%a.0)
  %2: f = add %1, %1
  store $r.0 = %2
}

pure function same(%a.0: f) -> ($r.0: f) {
  store $r.0 = %a.0
}

"""


def test_what_makes_the_result_stands_in_place_of_the_call():
    given = module("%4: f = call twice(%a.0)\n%5: f = call same(%4)\nstore $o.0 = %5", FUNCTIONS)
    found = inline_independent(given)
    verify(found)
    said = text(found)
    assert "call twice" not in said
    assert "call same" in said
    assert said.count("param sky") == 1
    assert said.count("mul") == said.count("add") == 1
    assert inline_independent(found) is found


def test_elements_that_leave_a_loop_with_such_a_result():
    @sh.subroutine
    def fixed(x: sh.Attrib1f):
        return sh.Attrib1f(7)

    @sh.program
    def leaves(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
        k = sh.Attrib1i(0)
        y = sh.Attrib1f(x)
        with SH_WHILE(lambda: k < 20):
            k += 1
            y[:] = fixed(x + y)
            SH_BREAK(k > n)
        y += x
        return y

    x, n = np.linspace(-1, 1, 40).astype(np.float32), np.arange(40, dtype=np.int32)
    assert leaves.compile("numpy")(x, n).tolist() == (x + 7).tolist()
    sh.testing.assert_equivalent(leaves, x, n, backends=("interpreter", *covering(2)))
