"""SHPY_DUMP prints the stages that it names, and nothing else."""

import pytest

import shpy as sh
from shpy.backend import dump

SUM = "value=(operator + (operator * x 8.5):f 1.0):f"
TREES = {
    "numpy": (["dumped"], f"    exit word=return {SUM}"),
    "opencl": (["dumped"], f"    assign target=(index result_out element):f {SUM}"),
    "glsl": (["dumped", "main"], f"    declare type=f name=result {SUM}"),
}


@sh.program
def dumped(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * 8.5 + 1


@pytest.mark.parametrize("backend", TREES)
def test_the_output_tree_is_printed_for_each_function(backend, monkeypatch, capsys):
    monkeypatch.setenv("SHPY_DUMP", "tree")
    dumped.compile(backend, **{"lanes": 1} if backend == "opencl" else {})
    printed = capsys.readouterr().err.splitlines()
    functions, statement = TREES[backend]
    assert [text for text in printed if text.startswith("---")] == [f"--- tree: {name}" for name in functions]
    assert statement in printed


def test_a_stage_that_does_not_exist_is_a_warning(monkeypatch):
    monkeypatch.setenv("SHPY_DUMP", "source, sauce")
    dump._chosen_stages.cache_clear()
    with pytest.warns(sh.ShpyWarning, match="SHPY_DUMP names sauce, and the stages are ir, vector, tree, source"):
        sh.program(lambda: sh.Attrib1f(3)).compile("numpy")
