"""The cures of tests/record/misuse.txt, carried out: each program as its message says to write it, and its results.

A section of cured.txt has the name of a misuse, its program with the cure in it, and behind `----` the results of
calls, one in a line: the arguments, an arrow, and what Python or numpy gives for what was meant. The program contains
the cure. Where a cure has `…`, names of its own or alternatives, `| text` behind the name is what stands in the program
for it, and `| ~ words` are those of a cure that the program follows.
"""

import ast
import re
from pathlib import Path

import numpy as np
import pytest
from test_misuse import CASES, PRELUDE

import shpy as sh

TEXT = Path(__file__).with_name("cured.txt")
WORDS = {
    "coroutine": "the program is what `def case` makes of the same text",
    "deep_loops": "the product of the loops is the user's choice of a form",
    "default_of_none": "a number, or no annotation: either may be meant",
    "formatted_value": "a trace is printed, and is no part of a program",
    "glsl_derivative": "a Table's run needs a shape; tests/library/test_derivatives.py runs it",
    "literal_out_of_range": "infinity or a wider type: either may be meant",
    "struct_lacks_a_field": "the value that the field lacks is the user's",
}
"""Misuses whose cure is a choice in words, each with the reason why no text follows from it."""


def sections():
    for part in TEXT.read_text().split("==== ")[1:]:
        head, _, rest = part.partition("\n")
        name, _, written = head.partition(" | ")
        program, _, calls = rest.partition("\n----\n")
        yield name, written, program, calls.strip().splitlines()


CURED = list(sections())
CURES = {name: expected.partition("write instead: ")[2] for name, _, expected in CASES}


def test_every_misuse_is_carried_out_or_its_cure_is_in_words():
    names = [name for name, *_ in CURED]
    assert len(set(names)) == len(names)
    assert set(names).isdisjoint(WORDS)
    assert {*names, *WORDS} == set(CURES)


def spelled(text):
    """Return code without the spaces and brackets that a rewriting may differ in."""
    return re.sub(r"[\s`]", "", text)


@pytest.mark.parametrize(("name", "written", "program", "calls"), CURED, ids=[c[0] for c in CURED])
def test_a_cure_that_a_message_prints_records_and_computes(name, written, program, calls, tmp_path):
    cure = CURES[name]
    if written.startswith("~"):
        assert written.removeprefix("~ ") in cure
    elif written:
        assert spelled(written) in spelled(program)
        assert set(re.findall(r"\w+", written)) & set(re.findall(r"\w+", cure))  # it is of that cure
    else:
        pieces = re.findall(r"`([^`]*)`", cure) or [cure]
        assert [piece for piece in pieces if spelled(piece) not in spelled(program)] == []
    names = {"sh": sh, "np": np, "math": __import__("math"), "F": sh.Attrib1f, "V": sh.Attrib3f}
    names |= {n: getattr(sh, n) for n in sh.__all__ if n.startswith("SH_")}
    exec(compile(PRELUDE, f"{name}.prelude", "exec"), names)
    file = tmp_path / "case.py"
    file.write_text(program)
    exec(compile(program, str(file), "exec"), names)
    kernel = sh.program(names["case"]).compile("numpy")
    assert calls
    for call in calls:
        given, _, wanted = call.partition(" -> ")
        arguments = ast.literal_eval(f"({given},)") if given else ()
        found = kernel(*arguments)
        right = eval(wanted, {"np": np, "math": __import__("math")})
        for one, other in zip(
            found if isinstance(found, tuple) else [found], right if isinstance(right, tuple) else [right], strict=True
        ):
            np.testing.assert_allclose(np.asarray(one), other, rtol=1e-6, atol=1e-6)
