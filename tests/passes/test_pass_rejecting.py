"""The condition under which an element is discarded at the start is found, and only that."""

import numpy as np
import pytest

import shpy as sh
from shpy.backend.device import listed
from shpy.ir.verifier import verify
from shpy.passes.rejecting import find_rejection


@sh.program
def late(x: sh.Attrib1f, t: sh.Table[sh.Attrib1f, 1]) -> sh.Attrib1f:
    sh.SH_DISCARD(t[sh.grid_index(1)] > x)
    y = sh.Attrib1f(x)
    for _ in range(20):
        y = sh.sin(y) + x
    sh.SH_DISCARD(y < 0.5)
    return y


@sh.program
def after_a_loop(x: sh.Attrib1f) -> sh.Attrib1f:
    y = sh.Attrib1f(x)
    with sh.SH_FOR(20):
        y += x
    sh.SH_DISCARD(x > 1)
    return y


@sh.program
def costly(x: sh.Attrib1f) -> sh.Attrib1f:
    y = sh.Attrib1f(x)
    for _ in range(20):
        y = sh.sin(y) + x
    sh.SH_DISCARD(y > 1)
    return y


@sh.program
def whole(x: sh.Attrib1f) -> sh.Attrib1f:
    with sh.SH_IF(x > 1):
        x += 1
        sh.SH_DISCARD()
    return x


def test_the_condition_is_a_program():
    found = find_rejection(late.ir)
    verify(found)
    assert [port.name for port in found.outputs] == ["rejected"]
    (rejected,) = sh.Program.from_ir(found).compile("numpy")(x=[1.0, 2.0, 3.0], t=[0.0, 5.0, 3.5])
    np.testing.assert_array_equal(rejected, [False, True, True])


@pytest.mark.parametrize("program", [after_a_loop, costly, whole])
def test_programs_that_discard_later_have_none(program):
    assert find_rejection(program.ir) is None


@pytest.mark.sampled(2)
@pytest.mark.parametrize("share", [0, 0.1, 0.6, 0.9])
@pytest.mark.parametrize("tile", [1, 7, 1000])
def test_a_list_of_elements_gives_the_same(monkeypatch, share, tile):
    rng = np.random.default_rng(8)
    x, t = rng.random(100, np.float32), (rng.random(100) > share).astype(np.float32) * 2
    out = rng.random(100, np.float32)
    kernel = late.compile("numpy", loop_limit=tile)  # a kernel of this test alone
    kernel._executable.tile = tile
    monkeypatch.setattr(listed, "_WORTH_A_LIST", 1000)
    plain = kernel.run(x, t, out=out.copy())
    monkeypatch.setattr(listed, "_WORTH_A_LIST", 0)
    in_list = kernel.run(x, t, out=out.copy())
    np.testing.assert_array_equal(plain.written, in_list.written)
    np.testing.assert_array_equal(plain.outputs.view(np.int32), in_list.outputs.view(np.int32))
    assert plain.count == in_list.count
