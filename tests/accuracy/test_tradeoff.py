"""Time against error: what is picked keeps the budget on unseen inputs; choices; the picture; the command."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
from accuracy.test_measure import FILE

import shpy as sh
from shpy import SH_FOR, cli
from shpy.accuracy.domain import draw
from shpy.accuracy.tradeoffs import Candidate, Tradeoff
from shpy.choices import combinations


def exactly(x: sh.Attrib1f) -> sh.Attrib1f:
    return sh.sqrt(x)


def roughly(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * 0.5 + 0.5


root = sh.choice("root", {"exactly": exactly, "roughly": roughly})


@sh.program
def twice(x: sh.Attrib1f) -> sh.Attrib1f:
    return root(x) * 2


NEAR_ONE = {"x": (0.999, 1.001)}
FEW = {"backends": ["numpy"], "math": "strict", "precision": "f32", "samples": 200, "elements": 2000, "rounds": 3}


def test_a_choice_is_the_first_until_another_is_picked():
    assert twice(np.float32(4)) == 4
    assert [picks for picks, _ in combinations(twice)] == [{"root": "exactly"}, {"root": "roughly"}]
    assert [program(np.float32(4)) for _, program in combinations(twice)] == [4, 5]
    assert [program(np.float32(4)) for _, program in combinations(root)] == [2, 2.5]


def test_two_choices_of_one_name_have_the_same_alternatives():
    other = sh.choice("root", {"slowly": exactly, "badly": roughly})
    again = sh.choice("root", {"exactly": exactly, "roughly": roughly})

    @sh.program
    def both(x: sh.Attrib1f) -> sh.Attrib1f:
        return root(x) + again(x)

    assert [picks for picks, _ in combinations(both)] == [{"root": "exactly"}, {"root": "roughly"}]

    @sh.program
    def mixed(x: sh.Attrib1f) -> sh.Attrib1f:
        return root(x) + other(x)

    with pytest.raises(sh.ShpyTypeError, match="two choices of the program are called 'root'"):
        list(combinations(mixed))


def test_alternatives_take_the_same_arguments():
    @sh.program
    def shifted(x: sh.Attrib1f) -> sh.Attrib1f:
        return sh.choice("way", {"two": lambda x, y: x + y, "one": lambda x: x})(x, 1)

    with pytest.raises(sh.ShpyTypeError, match="an alternative of the choice 'way' is called with") as caught:
        list(combinations(shifted))
    assert caught.value.loc.file == __file__


def test_choices_inside_choices():
    inner = sh.choice("inner", {"a": lambda x: x + 1, "b": lambda x: x + 2})
    outer = sh.choice("outer", {"plain": lambda x: x, "more": inner})

    @sh.program
    def nested(x: sh.Attrib1f) -> sh.Attrib1f:
        return outer(x) * 1

    found = list(combinations(nested))
    assert [picks for picks, _ in found] == [
        {"outer": "plain"},
        {"outer": "more", "inner": "a"},
        {"outer": "more", "inner": "b"},
    ]
    assert [program(np.float32(0)) for _, program in found] == [0, 1, 2]


@pytest.mark.parametrize("alternatives", [{}, {"a": 3}, {1: abs}, [abs, round], None])
def test_a_choice_needs_alternatives(alternatives):
    with pytest.raises(sh.ShpyTypeError, match="the choice empty needs functions to choose from"):
        sh.choice("empty", alternatives)


def test_alternatives_take_part_and_the_budget_is_kept():
    found = sh.accuracy.tradeoff(twice, NEAR_ONE, sh.accuracy.ulp(1), **FEW)
    by_pick = {c.picks["root"]: c for c in found.candidates}
    assert by_pick["exactly"].error <= 0.5
    assert by_pick["roughly"].error > 1
    assert found.pick is by_pick["exactly"]
    assert found.best.backend == "numpy"
    x = np.random.default_rng(99).uniform(0.999, 1.001, 20_000).astype(np.float32)
    off = sh.accuracy.ulp(found.best(x), 2 * np.sqrt(x.astype(np.float64)))
    assert (off <= 1).all()


def test_a_wider_budget_takes_the_fastest_of_those_that_keep_it():
    found = sh.accuracy.tradeoff(twice, NEAR_ONE, sh.accuracy.ulp(1000), **FEW)
    assert [c.ns for c in found.candidates] == sorted(c.ns for c in found.candidates)
    assert found.fastest is found.candidates[0]
    assert all(c.spread[0] <= c.ns <= c.spread[1] for c in found.candidates)
    assert all(c.code == len(c.kernel.source) for c in found.candidates)


def test_a_relative_budget():
    found = sh.accuracy.tradeoff(twice, NEAR_ONE, sh.accuracy.Budget(1e-5, "relative"), **FEW)
    assert {c.picks["root"]: c.error <= 1e-5 for c in found.candidates} == {"exactly": True, "roughly": True}


def test_precisions_are_judged_by_one_measure():
    found = sh.accuracy.tradeoff(twice, NEAR_ONE, sh.accuracy.ulp(1), **{**FEW, "precision": ["f16", "f32", "f64"]})
    error = {c.variant.precision: c.error for c in found.candidates if c.picks["root"] == "exactly"}
    assert error["f64"] < 1e-6 < 0.1 < error["f32"] <= 0.5 < 100 < error["f16"]


def test_what_does_not_hold_on_unseen_inputs_is_not_picked(monkeypatch):
    """An alternative that is right on exactly the inputs that the choice is made on, and faster."""
    seen = draw(twice, NEAR_ONE, FEW["samples"], np.random.default_rng(0)).leaves["x"]
    known = sh.Table(seen[np.isfinite(seen)], sh.Attrib1f)

    def overfitted(x: sh.Attrib1f) -> sh.Attrib1f:
        found = sh.Attrib1b(False)
        with SH_FOR(0, known.shape[0]) as i:
            found[:] = found | (known[i] == x)
        return sh.cond(found, sh.sqrt(x), 0.0)

    def timed(candidates, *rest):
        for n, candidate in enumerate(candidates):
            candidate.ns = -n

    monkeypatch.setattr(sys.modules["shpy.accuracy.tradeoffs"], "_time", timed)
    roots = sh.choice("root", {"exactly": exactly, "overfitted": overfitted})
    found = sh.accuracy.tradeoff(roots, NEAR_ONE, sh.accuracy.ulp(1), **FEW)
    fastest = found.candidates[0]
    assert fastest.picks["root"] == "overfitted"
    assert fastest.error <= 1
    assert fastest.held is False
    assert found.pick.picks["root"] == "exactly"


@pytest.mark.parametrize(("slower", "picked"), [(1.1, "exactly"), (2.0, "roughly")])
def test_of_variants_that_are_not_separable_in_time_the_closest_is_picked(monkeypatch, slower, picked):
    def timed(candidates, *rest):
        for candidate in candidates:
            candidate.ns = 1.0 if candidate.picks["root"] == "roughly" else slower
            candidate.spread = 0.9 * candidate.ns, 1.2 * candidate.ns

    monkeypatch.setattr(sys.modules["shpy.accuracy.tradeoffs"], "_time", timed)
    found = sh.accuracy.tradeoff(twice, NEAR_ONE, sh.accuracy.ulp(1000), **FEW)
    assert found.fastest.picks == {"root": "roughly"}
    assert found.pick.picks == {"root": picked}
    assert [c.held for c in found.candidates] == [True, True if slower < 2 else None]


def test_progress_counts_variants_and_rounds():
    seen = []
    sh.accuracy.tradeoff(twice, NEAR_ONE, sh.accuracy.ulp(4), progress=lambda *done: seen.append(done), **FEW)
    assert seen == [(done, 5) for done in range(6)]  # two alternatives, three rounds


def test_no_variant_is_close_enough():
    found = sh.accuracy.tradeoff(twice, NEAR_ONE, sh.accuracy.ulp(0.001), **FEW)
    with pytest.raises(sh.ShpyError, match=r"no variant of twice keeps ulp\(0.001\): the closest, numpy"):
        _ = found.best
    assert "→" not in found.table()
    assert not any(row["best"] for row in found.json()["candidates"])


def test_the_frontier_is_what_nothing_beats():
    points = [(1, 9), (2, 5), (3, 7), (4, 5), (5, 1), (6, 2)]
    made = tuple(Candidate(None, {}, None, None, error=e, ns=t) for t, e in points)
    front = Tradeoff("p", sh.accuracy.ulp(1), made, ()).frontier
    assert [(c.ns, c.error) for c in front] == [(1, 9), (2, 5), (5, 1)]


def test_the_command_tradeoff_draws_and_names_its_pick(tmp_path, capsys):
    (tmp_path / "mine.py").write_text(FILE)
    words = ["tradeoff", f"{tmp_path / 'mine.py'}:near_one", "--domain", "x=0.999:1.001", "--backends", "numpy"]
    few = ["--samples", "50", "--elements", "500", "--precision", "f32"]
    picture = tmp_path / "t.png"
    assert cli.main([*words, *few, "--error", "1ulp", "-o", str(picture)]) == 0
    said = capsys.readouterr().out
    assert "near_one: time against error" in said
    assert "the pick for ulp(1): numpy" in said
    assert said.rstrip().endswith("root=plain")
    assert picture.read_bytes().startswith(b"\x89PNG")
    rows = json.loads(picture.with_suffix(".json").read_text())["candidates"]
    assert {row["picks"]["root"] for row in rows} == {"plain", "rough"}
    assert sum(row["best"] for row in rows) == 1


def test_the_command_fails_where_nothing_is_close_enough(tmp_path, capsys):
    (tmp_path / "mine.py").write_text(FILE)
    words = [
        "tradeoff",
        f"{tmp_path / 'mine.py'}:near_one",
        "--backends",
        "numpy",
        "--samples",
        "20",
        "--elements",
        "99",
    ]
    assert cli.main([*words, "--error", "0.001ulp", "--precision", "f16", "--domain", "x=2:3"]) == 1
    assert "no variant of near_one keeps ulp(0.001)" in capsys.readouterr().err


def test_a_precision_that_does_not_hold_a_constant_is_skipped():
    @sh.program
    def enlarged(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * 70000.0

    found = sh.accuracy.tradeoff(enlarged, NEAR_ONE, sh.accuracy.ulp(1), **{**FEW, "precision": ["f16", "f32"]})
    assert {c.variant.precision for c in found.candidates} == {"f32"}
    assert {reason for _, reason in found.skipped} == {"70000.0 is out of the range of f at precision f16"}
