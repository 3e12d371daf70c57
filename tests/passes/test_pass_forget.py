"""Kernels do not depend on data: programs that differ in values of params and shapes of tables share one."""

import numpy as np
import pytest
from before_after import module

import shpy as sh
from shpy.ir.verifier import verify
from shpy.run import kernel
from shpy.run.kernel import forget_data


def test_values_and_shapes_go():
    found = forget_data(module("%4: f = table data[%k.2]\n%5: f = param sky\n%6: f = add %4, %5\nstore $o.0 = %6"))
    verify(found)
    assert (found.params[0].value, found.tables[0].size) == ((0,), None)


def test_a_shape_that_is_asked_for_stays():
    given = module("%4: i = table_size data\n%5: f = convert %4\nstore $o.0 = %5")
    assert forget_data(given).tables == given.tables


def test_the_least_size_stays_for_which_an_index_is_in_range():
    given = module(
        """
        %4: i = const 3
        %5: i = and %2, %4
        %6: f = table data[%5]
        %7: f = table data[%2]
        %8: f = add %6, %7
        store $o.0 = %8
        """
    )
    assert forget_data(given).tables[0].size == (4,)


def test_programs_share_a_kernel_that_knows_an_index_to_be_in_range(monkeypatch):
    monkeypatch.setattr(kernel, "_executables", {})

    def picked(data):
        table = sh.Table(data, sh.Attrib1f, "table")

        @sh.program
        def picked(k: sh.Attrib1i) -> sh.Attrib1f:
            return table[k & 3] + table[0]

        return picked.compile("opencl", lanes=1)

    four, five, three = (picked(np.arange(n) + 0.5) for n in (4, 5, 3))
    assert four.source == five.source
    assert "sh_at" not in four.source
    assert "sh_at" in three.source
    assert four(7) == five(7) == 4.0
    assert three(7) == 3.0


def scaled(data, by, wanted=sh.Attrib1f):
    table, factor = sh.Table(data, wanted, "table"), sh.Param(sh.Attrib1f, by, name="factor")

    @sh.program
    def scaled(k: sh.Attrib1i) -> wanted:
        return factor * table[k]

    return scaled


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_programs_with_other_data_share_a_kernel_and_keep_their_data(backend, monkeypatch):
    monkeypatch.setattr(kernel, "_executables", {})
    given = [(np.arange(5.0), 2.0), (np.arange(3.0) + 100, -1.0), (np.full(1, 0.5), 0.0), (np.arange(2000.0), 3.0)]
    kernels = [scaled(*one).compile(backend) for one in given]
    assert len(kernel._executables) == 1
    index = np.array([-1, 0, 1, 2, 4, 1999, 5000])
    for _ in range(2):
        for one, (data, by) in zip(kernels, given, strict=True):
            assert np.array_equal(
                one(index), np.float32(by) * data.astype(np.float32)[np.clip(index, 0, len(data) - 1)]
            )
    other = scaled(np.ones((4, 3)), 2.0, sh.Color3f).compile(backend)
    assert len(kernel._executables) == 2
    assert np.array_equal(other(index), np.full((7, 3), 2.0))
