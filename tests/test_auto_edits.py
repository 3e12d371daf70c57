"""The backend "auto" where its programs change: in a file that is edited while the process lives, and in chains."""

import importlib
import sys

import numpy as np
import pytest
from test_auto import EAGER

import shpy as sh
from shpy.run import tiers

X = np.linspace(1, 2, 70_000, dtype=np.float32)
FILE = """
import shpy as sh

@sh.program
def scaled(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * {}
"""


@pytest.fixture(autouse=True)
def eager(monkeypatch):
    monkeypatch.setenv("SHPY_BACKEND", "auto")
    monkeypatch.setattr("shpy.backend.registry._default", None)
    for name, value in EAGER.items():
        monkeypatch.setattr(tiers, name, value)


def test_an_edited_file_is_run_by_its_new_text_from_the_first_call_on(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    file = tmp_path / "edited_while_auto.py"
    file.write_text(FILE.format(3))
    module = importlib.import_module("edited_while_auto")
    before = module.scaled
    before(X)
    assert before.compile().runs_on == "opencl"
    file.write_text(FILE.format("0.1"))
    module = importlib.reload(module)
    assert module.scaled.compile().runs_on == "numpy"
    for _ in range(3):
        assert np.array_equal(module.scaled(X), X * np.float32(0.1))
        assert np.array_equal(before(X), X * 3)
    assert module.scaled.compile().runs_on == "opencl"
    file.write_text(FILE.format(3))  # the first text again, whose executable is on OpenCL by now
    module = importlib.reload(module)
    assert np.array_equal(module.scaled(X), X * 3)


@sh.program
def grow(x: sh.Attrib1f):
    return {"x": x * 3}


@sh.program
def root(x: sh.Attrib1f):
    return {"x": sh.sqrt(x)}


def test_chains_of_kernels_that_opencl_has_taken_over_stay_on_numpy():
    expected = np.sqrt(np.sqrt(X * 3) * 3)
    kernels = [program.compile() for program in (grow, root)]
    for kernel in kernels:
        kernel(X)
    assert [kernel.runs_on for kernel in kernels] == ["opencl", "opencl"]
    chains = [
        sh.repeat(sh.sequence(*kernels), 2),
        sh.repeat(sh.sequence(grow, root), 2),
        sh.repeat(sh.sequence(kernels[0], root.compile("numpy")), 2),
    ]
    for chain in chains:
        stream = chain.run(x=X).streams["x"]
        assert (stream.backend, np.array_equal(stream.numpy(), expected)) == ("numpy", True)
    assert [kernel.runs_on for kernel in kernels] == ["opencl", "opencl"]


def test_a_chain_mixes_no_kernel_of_opencl_with_one_that_auto_has_compiled():
    kernel = grow.compile()
    kernel(X)
    assert kernel.runs_on == "opencl"
    with pytest.raises(sh.ShpyTypeError, match="numpy"):
        sh.repeat(sh.sequence(kernel, root.compile("opencl")), 2).run(x=X)
