"""Requests that make no sense are errors before anything runs, and cures that work."""

import math
import re

import numpy as np
import pytest

import shpy as sh
from shpy import cli
from shpy.accuracy import Budget, measure, tradeoff, ulp


@sh.program
def grown(x: sh.Attrib1f) -> sh.Attrib1f:
    return sh.exp(x)


@sh.program
def wide(x: sh.Attrib1f) -> sh.Attrib2f:
    return sh.exp(x.xx)


@pytest.mark.parametrize("backends", ["opnecl", ["numpy", "cuda"]])
def test_an_unknown_backend_is_an_error(backends):
    for work in (measure, lambda *given, **options: tradeoff(*given, budget=ulp(4), **options)):
        with pytest.raises(sh.BackendUnavailable, match=r"there is no backend '(opnecl|cuda)'"):
            work(grown, {"x": (0, 1)}, backends=backends)


@pytest.mark.parametrize(
    ("work", "program", "domain", "options", "said"),
    [
        (measure, lambda x: x, {"x": (0, 1)}, {}, "is no program"),
        (measure, sh.choice("way", {"exp": sh.exp}), {"x": (0, 1)}, {}, "is no program"),
        (tradeoff, grown.compile("numpy"), {"x": (0, 1)}, {}, "is no program"),
        (measure, grown, [("x", (0, 1))], {}, "a domain is a dict"),
        (measure, grown, {"x": (0, 1)}, {"samples": -1}, "samples is an int from 0 on, not -1"),
        (measure, grown, {"x": (0, 1)}, {"samples": 1.5}, "samples is an int from 0 on, not 1.5"),
        (measure, grown, {"x": (0, 1)}, {"seed": -1}, "seed is an int from 0 on, not -1"),
        (tradeoff, grown, {"x": (0, 1)}, {"seed": "now"}, "seed is an int from 0 on, not 'now'"),
        (tradeoff, grown, {"x": (0, 1)}, {"elements": 0}, "elements is an int from 1 on, not 0"),
        (tradeoff, grown, {"x": (0, 1)}, {"rounds": 0}, "rounds is an int from 1 on, not 0"),
        (tradeoff, grown, {"x": (0, 1)}, {"progress": 3}, "progress=3 is no function"),
        (measure, grown, {"x": (0, 1)}, {"math": 3}, "math=3 is no name and no list of names"),
        (measure, grown, {"x": (0, 1)}, {"backends": 3}, "backends=3 is no name and no list of names"),
        (tradeoff, sh.choice("way", {"f": grown, "g": wide}), {"x": (0, 1)}, {}, r"f and g give .* \[1\] and \[2\]"),
    ],
)
def test_what_cannot_be_measured_is_an_error(work, program, domain, options, said):
    budget = {"budget": ulp(4)} if work is tradeoff else {}
    with pytest.raises(sh.ShpyTypeError, match=said) as caught:
        work(program, domain, **{"backends": "numpy", **budget, **options})
    assert caught.value.loc.file == __file__


def test_elements_of_a_domain_have_one_axis():
    @sh.program
    def placed(x: sh.Attrib1f) -> sh.Attrib1f:
        row, column = sh.grid_index(2)
        return x * sh.Attrib1f(row - column)

    @sh.program
    def numbered() -> sh.Attrib1f:
        return sh.sqrt(sh.Attrib1f(sh.grid_index(1)))

    @sh.program
    def given(x: sh.Attrib1f, place: sh.Attrib2i) -> sh.Attrib1f:
        return x * sh.Attrib1f(place.x - place.y)

    for program, domain, axes in ((placed, {"x": (0, 1)}, 2), (numbered, {}, 1)):
        with pytest.raises(sh.ShpyTypeError, match=rf"uses grid_index\({axes}\)") as caught:
            measure(program, domain, backends="numpy")
        assert caught.value.loc.file == __file__
        assert caught.value.cure == f"an input of type Attrib{axes}i in place of sh.grid_index({axes})"
    assert measure(given, {"x": (0, 1), "place": (0, 9)}, backends="numpy", math="strict", samples=5).rows


def test_an_unknown_mode_is_an_error():
    with pytest.raises(sh.ShpyTypeError, match="math='exact' is unknown"):
        measure(grown, {"x": (0, 1)}, math="exact")


@pytest.mark.parametrize("domain", [(1, 0), (1,), ("0", "1"), (0, 1, "log")])
def test_a_domain_that_is_no_range_is_an_error(domain):
    with pytest.raises(sh.ShpyTypeError, match=r"is no range|its ends are in the wrong order"):
        measure(grown, {"x": domain}, backends="numpy", samples=10)


@pytest.mark.parametrize(
    ("type", "domain", "said"),
    [
        (sh.Attrib1f, (0, math.inf), "its length is not finite"),
        (sh.Attrib1f, (math.nan, 1), "its length is not finite"),
        (sh.Attrib1f, [], "no array of one or more elements of type f"),
        (sh.Attrib1f, "words", "no array of one or more elements of type f"),
        (sh.Attrib1f, [1j], "no array of one or more elements of type f"),
        (sh.Attrib2f, lambda rng, count: rng.random(count), "no array of 10 elements of type f2"),
        (sh.Attrib1i, (0, 2**31), "not in the range of type i"),
        (sh.Attrib1f, lambda count: [1.0] * count, "a function of a domain takes rng and count: .* takes 1 positional"),
        (sh.Attrib1i, (0.2, 0.8), r"\(0.2, 0.8\) is a range without an int"),
        (sh.Attrib1i, (0, 10, "log"), "is no range"),
        (sh.Attrib1u, (1, 10, "linear"), "is no range"),
        (sh.Attrib1i, [2**31], "not in the range of type i"),
        (sh.Attrib1u, (-1, 1), "not in the range of type u"),
        (sh.Attrib1u, [math.nan], "not in the range of type u"),
    ],
)
def test_a_domain_holds_numbers_of_the_type(type, domain, said):
    @sh.program
    def same(x: type) -> type:
        return x

    with pytest.raises(sh.ShpyTypeError, match=said):
        measure(same, {"x": domain}, backends="numpy", samples=10)


def test_numbers_beyond_a_precision_are_infinite_there():
    row = measure(grown, {"x": (1e6, 1e7)}, backends="numpy", math="strict", precision="f16", samples=10).rows[0]
    assert np.isinf(row.worst["x"])
    assert row.ulp[0] == 0


def test_a_budget_has_a_unit():
    with pytest.raises(sh.ShpyTypeError, match="a budget is a number of units, not 4") as caught:
        tradeoff(grown, {"x": (0, 1)}, budget=4)
    for budget in caught.value.cure.split(", or a relative error, "):
        options = {"backends": "numpy", "math": "strict", "precision": "f64", "samples": 50, "elements": 10}
        assert tradeoff(grown, {"x": (0, 1)}, budget=eval(budget), **options).pick.held


@pytest.mark.parametrize(
    ("budget", "said"),
    [
        (ulp(-1), "a number from 0 on, not -1"),
        (ulp(math.nan), "a number from 0 on, not nan"),
        (ulp("4"), "a number from 0 on, not '4'"),
        (Budget(1e-3, "percent"), "the unit of a budget is not 'percent'"),
    ],
)
def test_a_budget_has_a_limit_and_a_known_unit(budget, said):
    with pytest.raises(sh.ShpyTypeError, match=said):
        tradeoff(grown, {"x": (0, 1)}, budget=budget)


@pytest.mark.parametrize("error", ["1ulps", "nan", "much"])
def test_the_command_says_what_an_error_is(error, capsys):
    with pytest.raises(SystemExit):
        cli.main(["tradeoff", "module:program", "--error", error])
    assert f"an error such as 2ulp, or 1e-3 for a relative one, not '{error}'" in capsys.readouterr().err


def test_the_budget_that_a_refusal_names_is_one_that_is_kept():
    options = {"backends": "numpy", "math": "fast", "precision": "f32", "samples": 50, "elements": 100, "rounds": 1}
    with pytest.raises(sh.ShpyError) as caught:
        _ = tradeoff(grown, {"x": (-10, 10)}, budget=ulp(0.1), **options).pick
    assert caught.value.cure.endswith("a smaller domain, or precision=['f64']")
    with pytest.raises(sh.ShpyError) as wide:
        _ = tradeoff(grown, {"x": (-10, 10)}, budget=ulp(0), **{**options, "precision": "f64"}).pick
    assert wide.value.cure.endswith("a smaller domain")
    named = float(re.match(r"a budget of ([\d.]+),", caught.value.cure)[1])
    found = tradeoff(grown, {"x": (-10, 10)}, budget=ulp(named), **options)
    assert found.candidates[0].error <= named
