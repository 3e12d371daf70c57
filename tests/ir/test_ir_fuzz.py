"""Random changes in texts of the IR: the parser and the verifier raise a ShpyError, or accept the text.

An accepted text gives the same results on the interpreter and on numpy, within its limit of iterations.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, seed, settings, strategies as st

import shpy as sh

ROOT = Path(__file__).parents[2]
TEXTS = re.findall(r"```ir\n(.*?)```", (ROOT / "docs/ir.md").read_text(), re.DOTALL)
TOKEN = re.compile(r"[%$][\w.]+|\w+|[^\w\s]|\n|[ ]+")
TOKENS = sorted({t for text in TEXTS for t in TOKEN.findall(text)})
WORDS = [
    "f",
    "f2",
    "f4",
    "i",
    "u",
    "b",
    "d",
    "h",
    "b3",
    "%0",
    "%1",
    "%99",
    "$0",
    "$1",
    "0",
    "1",
    "-1",
    "4294967296",
    "nan",
]

LARGE = [
    "9" * 19,
    "9" * 20,
    "9" * 5_000,
    "-" + "9" * 19,
    "2147483648",
    f"0x1.{'f' * 5_000}p+0",
    "1e99999",
    "a" * 20_000,
    "%" + "a" * 20_000 + ".0",
    '"a' + ".a" * 500 + '"',
    '"' + "a b" * 5_000 + '"',
    '"' + "\\a" * 5_000 + '"',
    '"a[' + "9" * 500 + ']"',
    "\n" * 20_000,
    "\n# \n" * 5_000,
    " " * 20_000,
    "(" * 5_000,
    "if %0 {\n" * 500,
]
"""Numbers, names and blanks of a size that nobody expects."""


@st.composite
def broken(draw):
    """Draw a text of which a few tokens or lines are removed, doubled, exchanged, replaced or made very large."""
    text = draw(st.sampled_from(TEXTS))
    pieces = TOKEN.findall(text) if draw(st.booleans()) else text.splitlines(True)
    for _ in range(draw(st.integers(1, 4))):
        if not pieces:
            break
        at = draw(st.integers(0, len(pieces) - 1))
        how = draw(st.integers(0, 5))
        if how == 0:
            del pieces[at]
        elif how == 1:
            pieces.insert(at, pieces[draw(st.integers(0, len(pieces) - 1))])
        elif how == 2:
            other = draw(st.integers(0, len(pieces) - 1))
            pieces[at], pieces[other] = pieces[other], pieces[at]
        elif how == 3:
            pieces[at] = draw(st.sampled_from(TOKENS) | st.sampled_from(WORDS))
        elif how == 4:
            pieces[at] = draw(st.sampled_from(LARGE))
        else:
            pieces[at] = draw(st.text(max_size=4))
    return "".join(pieces)


def refused_briefly(error: sh.ShpyError) -> bool:
    """Return False; fail if the error's text is too long to read."""
    assert len(str(error)) < 20_000
    return False


def check(text: str) -> bool:
    """Return whether the text is a program; then it runs, and the interpreter agrees with numpy."""
    try:
        module = sh.parse(text)
        assert sh.parse(str(module)) == module
        program = sh.Program.from_ir(module)
        # A broken text may depend on which elements run together: then there is but one.
        count = 1 if re.search("any_lane|all_lanes", text) else 3
        inputs = sh.testing.inputs(program, count)
        rank = program.compile("numpy", loop_limit=40)._rank
    except sh.ShpyError as error:
        return refused_briefly(error)
    shape = (count,) if rank is None else (1,) * (rank - 1) + (count,)
    backends = ["interpreter", "numpy"]
    sh.testing.assert_equivalent(program, *inputs, backends=backends, loop_limit=40, shape=shape, ulp=16)
    return True


def fuzz(shard: int, examples: int) -> None:
    taken = []

    @seed(shard)
    @settings(max_examples=examples, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(broken())
    def run(text):
        taken.append(check(text))

    run()
    assert 0 < sum(taken) < len(taken)


def test_broken_texts_are_refused_or_run():
    fuzz(1, 400)


@pytest.mark.slow
@pytest.mark.parametrize("shard", range(100, 110))
def test_many_broken_texts_are_refused_or_run(shard):
    fuzz(shard, 2000)


@given(st.text(max_size=200) | st.binary(max_size=200).map(lambda b: b.decode("latin1")))
def test_any_text_is_refused(text):
    with pytest.raises(sh.ParseError):
        sh.parse(text)


@pytest.mark.parametrize("text", TEXTS, ids=lambda text: text.split()[1])
def test_the_texts_themselves_are_programs(text):
    if re.search(r"status\.\d|lane_mask|neighbour|grid_line", text):  # what the passes make
        return
    assert check(text)
