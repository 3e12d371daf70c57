"""docs/ir.md: every block is a module, written as it is printed; nothing that the IR has is missing."""

import functools
import re
from pathlib import Path

import numpy as np
import pytest

from shpy.ir import nodes
from shpy.ir.interpreter import Interpreter
from shpy.ir.nodes import Let
from shpy.ir.ops import STRUCTURAL
from shpy.ir.parser import parse
from shpy.ir.text import print_module
from shpy.ir.traverse import walk
from shpy.ir.verifier import verify

PAGE = (Path(__file__).parents[2] / "docs" / "ir.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```ir\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


@functools.cache
def modules():
    """Return the modules of the page by name; of two alike, the first."""
    return {module.name: module for module in map(parse, reversed(BLOCKS))}


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.split("\n")[0])
def test_a_block_is_a_good_module_as_it_is_printed(block):
    module = parse(block)
    verify(module)
    assert print_module(module) == block


def test_every_block_is_marked_as_ir():
    assert PAGE.count("```") == 2 * len(BLOCKS)
    assert len(BLOCKS) > 10


def test_every_node_and_operation_is_there():
    statements = [s for module in map(parse, BLOCKS) for function in module.functions for s in walk(function.body)]
    assert {s.op for s in statements if isinstance(s, Let)} >= set(STRUCTURAL)
    assert {type(s) for s in statements} == {
        getattr(nodes, name)
        for name in ("Let", "Store", "Call", "If", "Loop", "Break", "Continue", "Return", "Discard")
    }
    for node in ("Module", "Port", "Param", "Table", "Function", "Variable", "Let", "Store", "Call", "If", "Loop"):
        assert re.search(rf"\| `{node}\b", PAGE), node


@pytest.mark.parametrize(
    ("name", "given", "output", "status"),
    [
        ("scale", [3.0], 7.0, 1),
        ("absolute", [-2.5], 2.5, 1),
        ("odds", [], 1 + 3 + 5 + 7 + 9, 1),
        ("halve", [5.0], 0.625, 1),
        ("root", [9.0], 3.0, 1),
        ("root", [0.0], 0.0, 1),
        ("root", [-1.0], 0.0, 0),
        ("sums", [[1.0, 2.0, 2.0]], 9.0, 1),
        ("together", [5000.0], 1024.0, 1),
        ("masked", [-2.0], 2.0, 1),
    ],
)
def test_a_block_does_what_the_page_says(name, given, output, status):
    assert Interpreter(modules()[name]).run_element(given) == ([output], status)


def test_the_lookup_clamps():
    image = np.arange(24.0).reshape(2, 3, 4)
    (color,), _ = Interpreter(modules()["lookup"]).run_element(
        [[1, 99]], {"gain": 0.5}, {"image": image, "weights": np.array([1.0, 2.0, 4.0])}
    )
    assert color.tolist() == [20.0, 21.0, 22.0, 23.0]


def test_both_roots_agree():
    plain, lowered = (parse(block) for block in BLOCKS if parse(block).name == "root")
    for x in (-1.0, 0.0, 2.0, float("nan")):
        got, wanted = Interpreter(lowered).run_element([x]), Interpreter(plain).run_element([x])
        assert np.array_equal(got[0], wanted[0], equal_nan=True)
        assert got[1] == wanted[1]
