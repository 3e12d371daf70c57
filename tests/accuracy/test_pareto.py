"""A trade-off's choice, its table with a legend, and the picture, which places labels where no point can be."""

from __future__ import annotations

import itertools
import math
import re
from functools import cache

import numpy as np
import pytest

import shpy as sh
from shpy.accuracy.measuring import Variant
from shpy.accuracy.pareto import Comparison, choose, rivals, separable, timed
from shpy.accuracy.pareto_plot import draw
from shpy.accuracy.tradeoffs import Candidate, Tradeoff

EXTREMES = (0.0, 0.0, math.inf, math.inf)


@sh.program
def shade(x: sh.Attrib1f) -> sh.Attrib1f:
    return sh.sqrt(x)


def candidate(ns, error, spread=None, held=None, variant=("numpy", "strict", "f32"), **picks):
    low, high = spread or (ns, ns)
    return Candidate(Variant(*variant), picks, shade, None, error=error, ns=ns, spread=(low, high), code=7, held=held)


def found(*candidates, budget=4):
    return Tradeoff("shade", sh.accuracy.ulp(budget), candidates, ())


def test_times_are_separable_where_quartiles_do_not_overlap():
    assert separable((1, 2), (2.1, 3))
    assert separable((2.1, 3), (1, 2))
    assert not separable((1, 2), (2, 3))
    assert not separable((1, 9), (2, 3))


def test_where_times_do_not_decide_errors_do():
    fast = candidate(1.0, 3.0, (0.9, 1.5), held=True)
    like = candidate(1.2, 2.0, (1.0, 1.4), held=True)
    worse = candidate(1.3, 2.5, (1.0, 1.4), held=True)
    slow = candidate(2.0, 0.1, (1.9, 2.5), held=True)
    assert rivals([fast, like, worse, slow], lambda c: c.error) == (fast, like)
    assert choose([fast, like, worse, slow], lambda c: c.error) is like
    assert choose([], lambda c: c.error) is None
    far = candidate(0.5, 99.0, (0.4, 3.0), held=False)
    t = found(far, fast, like, worse, slow)
    assert t.fastest is fast
    assert t.pick is like
    assert [row["like_fastest"] for row in t.json()["candidates"]] == [True, False, True, True, False]
    assert [row["best"] for row in t.json()["candidates"]] == [False, False, True, False, False]


def test_calls_are_timed_in_turn_each_once_more_than_it_counts(monkeypatch):
    clock = itertools.count()
    monkeypatch.setattr("shpy.accuracy.pareto.time.perf_counter", lambda: float(next(clock)))
    ran, told = [], []
    found = timed([lambda: ran.append("a"), lambda: ran.append("b")], rounds=3, enough=2.5, tell=told.append)
    assert "".join(ran) == "aaabbb" * 3
    assert told == [0, 1, 2, 3]
    assert found == [(0.5, (0.5, 0.5))] * 2


def test_the_table_marks_times_that_are_not_separable_and_says_so():
    close = candidate(1.2, 1.0, (1.0, 1.4), held=True, variant=("opencl", "fast", "f32"), root="rough")
    t = found(candidate(1.0, 3.0, (0.9, 1.5), held=True), close, candidate(9.0, 5.0))
    lines = t.table().splitlines()
    assert [line[:6].split() for line in lines[2:5]] == [["*"], ["→", "≈"], []]
    assert "≈" not in lines[2]
    meaning = re.sub(r"\s+", " ", t.table())
    assert "≈ not separable in time from numpy strict f32, the fastest within 4 ULP: their quartiles overlap" in meaning
    assert "→ the pick: of the variants within 4 ULP that are as fast as the fastest of them, the closest" in meaning


def test_every_column_mark_and_short_name_of_the_table_has_a_line_in_the_legend():
    some = [
        candidate(n + 1.0, 9.0 - n, variant=v)
        for n, v in enumerate([("numpy", "strict", "f64"), ("glsl", "fast", "f16")])
    ]
    table, _, legend = found(*some).table().partition("\n\n")
    explained = [re.split(r"  +", line.strip())[0] for line in legend.splitlines() if not line.startswith(" " * 12)]
    headings = re.split(r"  +", table.splitlines()[1].strip())
    assert headings == ["variant", "ns/element", "quartiles", "error (ulp)", "code", "keeps the budget"]
    assert set(headings) <= set(explained)
    assert {"*", "strict", "fast", "f16", "f64"} <= set(explained)
    assert not {"relaxed", "f32", "≈", "→"} & set(explained)
    assert all(len(line) <= 120 for line in legend.splitlines())


def test_a_long_meaning_goes_on_below_its_beginning():
    meanings = {"a": "short", "longer": "as many words as it takes to go beyond the end of a line " * 4}
    shown = Comparison("title", (), 1.0, "", ("a", "longer", "", ""), meanings, "", "", "", "")
    legend = shown.table().partition("\n\n")[2].splitlines()
    first = next(n for n, line in enumerate(legend) if line.startswith("  longer  as many"))
    column = legend[first].index("as many")
    assert len(legend) - first > 1
    assert legend[first - 1].index("short") == column
    assert all(len(line) - len(line.lstrip()) == column for line in legend[first + 1 :])


def many(count, seed, extremes=EXTREMES):
    rng = np.random.default_rng(seed)
    variants = itertools.cycle(itertools.product(("numpy", "opencl", "glsl"), ("strict", "relaxed", "fast"), ("f32",)))
    errors = [*extremes, *rng.lognormal(0, 6, count - len(extremes))]
    times = rng.lognormal(1, 1, count)
    made = [
        candidate(t, e, (0.9 * t, 1.2 * t), variant=v, noise=f"way{n}")
        for n, (t, e, v) in enumerate(zip(times, errors, variants, strict=False))
    ]
    made.sort(key=lambda c: c.ns)
    next(c for c in made if c.error <= 4).held = True
    return found(*made)


@cache
def sixty():
    """Return a picture of sixty variants, drawn once."""
    return picture(many(60, 5))


def picture(t):
    from matplotlib.figure import Figure  # here: to import it takes longer than most tests, in each process of a run

    figure = Figure(figsize=(10, 6), layout="constrained")
    draw(t._comparison, figure)
    figure.draw_without_rendering()
    return figure, figure.axes[0]


@pytest.mark.slow
@pytest.mark.parametrize(("count", "seed"), [(5, 1), (1, 0), (40, 2), (40, 3), (200, 4)])
def test_labels_cover_neither_each_other_nor_a_point(count, seed):
    t = many(count, seed, EXTREMES if count > 5 else ())
    _, axes = picture(t)
    from matplotlib.text import Annotation, Text

    labels = [text for text in axes.texts if isinstance(text, Annotation)]
    assert [text.get_text().replace("\n", " ") for text in labels] == [str(c) for c in t.frontier]
    boxes = [Text.get_window_extent(text) for text in labels]
    for one, two in itertools.combinations(boxes, 2):
        assert not one.padded(-0.5).overlaps(two)
    points = [
        axes.transData.transform(line.get_xydata()[0]) for line in axes.lines if line.get_marker() in list("os^DvP*X")
    ]
    assert len(points) >= count
    for box in boxes:
        assert not any(box.contains(*point) for point in points)
        assert axes.bbox.x0 <= box.x0
        assert axes.bbox.y0 - 1 <= box.y0


def test_the_picture_has_units_logarithms_and_a_legend_outside_of_the_data():
    figure, axes = sixty()
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("ns per element", "largest error in ULP")
    (legend,) = figure.legends
    assert not legend.get_window_extent().overlaps(axes.bbox)
    said = [text.get_text() for text in legend.get_texts() if text.get_text().strip()]
    assert said[:4] == ["backend", "numpy", "opencl", "glsl"]
    assert said[4:8] == ["mode", "strict", "relaxed", "fast"]
    assert said[8:] == ["frontier", "within 4 ULP", "quartiles of its times", "pick"]
    assert {text.get_text() for text in axes.texts} >= {"exact", "infinite"}


@pytest.mark.slow
@pytest.mark.parametrize(("errors", "budget"), [((0.0, math.inf), 0), ((0.0, 0.0), 0), ((5e-324, 1.7e308), 1)])
def test_errors_without_a_logarithm_or_at_the_ends_of_binary64_are_drawn(errors, budget, tmp_path):
    found(*(candidate(1.0 + n, e, held=True) for n, e in enumerate(errors)), budget=budget).plot(tmp_path / "t.png")
    assert (tmp_path / "t.png").stat().st_size > 1000
    assert (tmp_path / "t.json").exists()


def test_a_backend_has_the_same_colour_in_every_picture():
    def colours(figure):
        handles = zip(figure.legends[0].get_lines(), figure.legends[0].get_texts(), strict=True)
        return {text.get_text(): line.get_color() for line, text in handles}

    every = colours(sixty()[0])
    alone = colours(picture(found(candidate(1.0, 2.0, variant=("glsl", "fast", "f32"))))[0])
    assert alone["glsl"] == every["glsl"] != every["numpy"]
