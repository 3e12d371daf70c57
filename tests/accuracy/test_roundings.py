"""Roundings: the bound holds in every element, and the line that loses the digits is named."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import shpy as sh
from shpy import SH_FOR, SH_IF, SH_WHILE, cli
from shpy.accuracy.reference import evaluate
from shpy.accuracy.stable_forms import stable_forms
from shpy.passes.pipeline import optimise
from shpy.testing.observers import Setting


@sh.program
def quadratic(b: sh.Attrib1f, c: sh.Attrib1f) -> sh.Attrib1f:
    square = b * b
    under = square - c
    root = sh.sqrt(under)  # loses
    return root - b


@sh.program
def heron(a: sh.Attrib1f, b: sh.Attrib1f, c: sh.Attrib1f) -> sh.Attrib1f:
    s = (a + b + c) / 2  # loses
    return sh.sqrt(s * (s - a) * (s - b) * (s - c))


@sh.program
def variance(x: sh.Attrib4f) -> sh.Attrib1f:
    squares = sh.dot(x, x)
    mean = (x.x + x.y + x.z + x.w) / 4  # loses
    return squares - mean * mean * 4


@sh.program
def cosine(x: sh.Attrib1f) -> sh.Attrib1f:
    c = sh.cos(x)  # loses
    top = 1 - c
    return top / (x * x)


@sh.program
def roots(x: sh.Attrib1f) -> sh.Attrib1f:
    more = sh.sqrt(x + 1)  # loses
    less = sh.sqrt(x)
    return more - less


@sh.program
def logarithm(x: sh.Attrib1f) -> sh.Attrib1f:
    more = 1 + x  # loses
    return sh.log(more)


@sh.subroutine
def smooth(x: sh.Attrib1f, d: sh.Attrib1f) -> sh.Attrib1f:
    return sh.smoothstep(0.0, 2.0, x) * d


@sh.program
def shaded(n: sh.Normal3f, light: sh.Vector3f, s: sh.Attrib1f) -> sh.Attrib1f:
    d = sh.max(sh.dot(sh.normalize(n), sh.normalize(light)), 0.1)
    y = sh.Attrib1f(0)
    with SH_FOR(0, 5) as i:
        with SH_IF(d * s > 0.5):
            y += sh.pow(d, s) * 0.3 + smooth(s, d)
        y += sh.mix(d, s, 0.1) * sh.Attrib1f(i)
    return y


PROGRAMS: dict[str, tuple[sh.Program, dict[str, Any], str | None]] = {
    "quadratic": (quadratic, {"b": (1, 100), "c": (0.1, 1)}, "-c / (root + b)"),
    "heron": (
        heron,
        {"a": (1, 1.1), "b": (1, 1.1), "c": (1.9, 2)},
        "sh.sqrt((c + (a + b)) * (b - (c - a)) * (b + (c - a)) * (c + (a - b))) / 4",
    ),
    "variance": (variance, {"x": (100, 101)}, "sh.dot(x - mean, x - mean)"),
    "cosine": (cosine, {"x": (1e-3, 1e-1, "log")}, "2 * sh.sin(x / 2) ** 2"),
    "roots": (roots, {"x": (1e3, 1e5)}, "1 / (more + less)"),
    "logarithm": (logarithm, {"x": (1e-6, 1e-2, "log")}, "sh.log1p(x)"),
    "shaded": (shaded, {"n": (-1, 1), "light": (-1, 1), "s": (0.1, 3)}, None),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", PROGRAMS)
def test_the_bound_holds_and_the_line_is_named(name: str) -> None:
    program, domain, form = PROGRAMS[name]
    report = sh.accuracy.roundings(program, domain, samples=80)
    exact = evaluate(Setting(program, tuple(report.inputs.values()))).outputs[0].high[:, 0]
    error = np.abs(program.compile("numpy")(*report.inputs.values()) - exact)
    assert (error <= report.bounds * 1.001).all()
    assert np.median(report.bounds) < 40 * max(np.median(error), np.spacing(np.float32(np.median(np.abs(exact)))))
    assert np.isclose(sum(line.share for line in report.lines), 1)
    if name != "shaded":
        assert report.lines[0].text.endswith("# loses")
        assert report.lines[0].text in str(report)
    assert [f.new for line in report.lines for f in line.forms] == ([] if form is None else [form])
    assert form is None or f"          write {form} for " in str(report)


def test_conditions() -> None:
    """The quadratic root is well conditioned, the difference of two numbers that are close is not."""
    report = sh.accuracy.roundings(quadratic, PROGRAMS["quadratic"][1], samples=50)
    assert report.conditions["b"][1] < 1.2

    @sh.program
    def difference(x: sh.Attrib1f, y: sh.Attrib1f, k: sh.Attrib1i) -> sh.Attrib1f:
        return (x - y) * sh.Attrib1f(k)

    report = sh.accuracy.roundings(difference, {"x": (10, 10.1), "y": (9.9, 10), "k": (1, 2)}, samples=50)
    assert report.conditions["x"][0] > 20
    assert list(report.conditions) == ["x", "y"]


@sh.subroutine
def near_zero(x: sh.Attrib1f) -> sh.Attrib1f:
    return sh.exp(x) - 1


@sh.program
def lengths(b: sh.Attrib1f, c: sh.Attrib1f, v: sh.Attrib2f) -> sh.Attrib1f:
    y = sh.Attrib1f(0)
    with SH_FOR(0, 3):
        with SH_IF(c > 0):
            step = sh.sqrt(c + 1) - sh.sqrt(c)
            y += sh.Attrib1f(step) * b
    gap = near_zero(v.x * 2) / 2
    return y + gap + v.y * v.y - b * b


def test_forms_in_loops_branches_and_subroutines() -> None:
    """Each form is a text of the user's names, and all of them together keep the value."""
    domain = {"b": (1e-3, 1e-2), "c": (1e3, 1e5, "log"), "v": (1e-5, 1e-4)}
    report = sh.accuracy.roundings(lengths, domain, samples=100)
    forms = {form.old: form.new for line in report.lines for form in line.forms}
    assert forms["sh.sqrt(c + 1) - sh.sqrt(c)"] == "1 / (sh.sqrt(c + 1) + sh.sqrt(c))"
    assert forms["sh.exp(x) - 1"] == "sh.expm1(x)"
    assert report.better is not None
    assert np.median(report.better / report.bounds) < 0.75


FORMS: list[tuple[str, str]] = [
    ("sh.cos(x) - 1", "-2 * sh.sin(x / 2) ** 2"),
    ("1 - sh.exp(-x)", "-sh.expm1(-x)"),
    ("sh.log(1 - x * x)", "sh.log1p(-x ** 2)"),
    ("1 - sh.sqrt(1 - x * x)", "x ** 2 / (sh.sqrt(1 - x ** 2) + 1)"),
    ("sh.sqrt(x * x + 4) - 2", "x ** 2 / (sh.sqrt(x ** 2 + 4) + 2)"),
    ("sh.tan(x) - sh.sin(x)", "2 * sh.tan(x) * sh.sin(x / 2) ** 2"),
    ("(1 + x) * (1 + x) - 1", "x * (1 + x + 1)"),
    ("sh.sin(3 + x) - sh.sin(sh.Attrib1f(3))", "2 * sh.cos((3 + x + 3) / 2) * sh.sin(x / 2)"),
]


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("text", "form"), FORMS)
def test_forms_are_python(text: str, form: str) -> None:
    """The text of a form, written in place of the expression, gives the values that the report promises."""
    x = np.geomspace(1e-3, 1e-1, 40).astype(np.float32)
    programs = []
    for expression in (text, form):
        space: dict[str, Any] = {"sh": sh}
        exec(f"@sh.program\ndef gap(x: sh.Attrib1f) -> sh.Attrib1f:\n    return {expression}\n", space)
        programs.append(space["gap"])
    report = sh.accuracy.roundings(programs[0], {"x": x}, samples=len(x))
    assert [f.new for line in report.lines for f in line.forms] == [form]
    assert report.better is not None
    again = sh.accuracy.roundings(programs[1], {"x": x}, samples=len(x))
    assert np.allclose(again.bounds, report.better, rtol=1e-6)
    error = np.abs(programs[1].compile("numpy")(x) - report.values)
    assert (error <= report.better * 1.001).all()


def test_numbers_uniforms_and_ints_are_rounded_too() -> None:
    """None of them depends on the input, and their roundings are the whole error."""
    gain = sh.Param(sh.Attrib1f, 0.3, name="gain")

    @sh.program
    def several(x: sh.Attrib1f, k: sh.Attrib1i) -> sh.Attrib1f:
        third = sh.Attrib1f(k) / 3
        shade = sh.min(x, 0.1) * 4 + sh.max(x * 0, gain)
        return sh.cond(k > 100, third, shade)

    for low, high, line in ((2**24, 2**25, "third = "), (1, 100, "shade = ")):
        report = sh.accuracy.roundings(several, {"x": (1, 2), "k": (low, high)}, samples=50)
        error = np.abs(several.compile("numpy")(*report.inputs.values()) - report.values)
        assert (error <= report.bounds * 1.001).all()
        assert error.max() > 0.1 * report.bounds.max()
        assert report.lines[0].text.startswith(line)


def test_several_forms_of_a_line() -> None:
    @sh.program
    def ratio(x: sh.Attrib1f) -> sh.Attrib1f:
        return (sh.exp(x) - 1) / (1 - sh.cos(x))

    report = sh.accuracy.roundings(ratio, {"x": (1e-3, 1e-2)}, samples=50)
    (line,) = report.lines
    assert {(f.old, f.new) for f in line.forms} == {
        ("sh.exp(x) - 1", "sh.expm1(x)"),
        ("1 - sh.cos(x)", "2 * sh.sin(x / 2) ** 2"),
    }
    assert report.better is not None
    assert (report.better < 1e-3 * report.bounds).all()


def test_a_form_with_other_values_is_not_stated() -> None:
    """The component has the place of the mean, and is none."""

    @sh.program
    def unlike(v: sh.Attrib4f) -> sh.Attrib1f:
        return sh.dot(v, v) - v.x * v.x * 4

    (form,) = stable_forms(optimise(unlike.recorded.module, fixed=False))
    assert form.new == "sh.dot(v - v.x, v - v.x)"
    report = sh.accuracy.roundings(unlike, {"v": (100, 101)}, samples=50)
    assert report.bounds.max() > 1e-3
    assert report.better is None


def test_forms_of_large_programs() -> None:
    """A long sum is neither read nor written as one, and a form names Params."""
    gain = sh.Param(sh.Attrib1f, 1000.0, name="gain")

    @sh.program
    def long(x: sh.Attrib1f) -> sh.Attrib1f:
        total = x
        for k in range(1500):
            total = total + x * (1 + k / 4096)
        small = sh.sqrt(gain + x) - sh.sqrt(gain)
        return sh.log(1 + total * 1e-9) + small

    texts = [form.new for form in stable_forms(optimise(long.recorded.module, fixed=False))]
    assert texts == ["x / (sh.sqrt(gain + x) + sh.sqrt(gain))", "sh.log1p(total * 1e-09)"]


COMMANDED = """
import shpy as sh

@sh.program
def f(x: sh.Attrib1f):
    upper = sh.sqrt(x + 1)
    return {"y": upper - sh.sqrt(x), "z": upper}
"""


def test_large_errors_point_here(monkeypatch: pytest.MonkeyPatch) -> None:
    domain = PROGRAMS["cosine"][1]
    few: dict[str, Any] = {"backends": ["numpy"], "samples": 100}
    line = "more than 16 ULP: sh.accuracy.roundings(program, domain), or shpy accuracy --lines, names the lines"
    assert line in str(sh.accuracy.measure(cosine, domain, math="strict", **few))
    assert line not in str(sh.accuracy.measure(cosine, domain, math="fast", **few))
    assert line not in str(sh.accuracy.measure(cosine, {"x": (0.5, 1)}, math="strict", **few))
    comparison = sh.accuracy.tradeoff(
        cosine, domain, sh.accuracy.ulp(4), rounds=1, elements=9, math="strict", precision=["f32", "f64"], **few
    )
    assert str(comparison).count(line) == 1
    from matplotlib.figure import Figure  # here: as in test_pareto.py

    figure = Figure()
    monkeypatch.setattr("shpy.accuracy.tradeoffs.new_figure", lambda *size: figure)
    monkeypatch.setattr("shpy.accuracy.tradeoffs.save_figure", lambda *content: None)
    comparison.plot("t.png")
    assert figure.get_supxlabel() == line


def test_the_command_names_the_lines_of_an_output(tmp_path, capsys) -> None:
    (tmp_path / "p.py").write_text(COMMANDED)
    command = [
        "accuracy",
        f"{tmp_path / 'p.py'}:f",
        "--domain",
        "x=1e3:1e6:log",
        "--samples",
        "50",
        "--backends",
        "numpy",
    ]
    assert cli.main([*command, "--math", "strict", "--lines", "y"]) == 0
    printed = capsys.readouterr().out
    assert "f: roundings at f32 may change the result by " in printed
    assert "write 1 / (upper + sh.sqrt(x)) for upper - sh.sqrt(x)" in printed
    assert cli.main([*command, "--math", "fast", "--lines"]) == 2
    assert "write instead: output='y' or output='z'" in capsys.readouterr().err


def test_what_is_refused() -> None:
    @sh.program
    def several(x: sh.Attrib1f):
        return {"a": x, "b": sh.vec2(x, x), "c": x * x}

    with pytest.raises(sh.ShpyTypeError) as caught:
        sh.accuracy.roundings(several, {"x": (0, 1)})
    assert caught.value.message == "sh.accuracy.roundings takes an output of one float, not the outputs of several"
    assert caught.value.cure == "output='a' or output='c'"
    assert sh.accuracy.roundings(several, {"x": (1, 2)}, output="c", samples=9).lines[0].share == 1

    @sh.program
    def unbounded(x: sh.Attrib1f) -> sh.Attrib1f:
        y = sh.Attrib1f(x)
        with SH_WHILE(lambda: y < 10):
            y *= 1.5
        return y

    with pytest.raises(sh.RecordError, match="this loop has no known bound") as refused:
        sh.accuracy.roundings(unbounded, {"x": (1, 2)})
    assert "most=64" in str(refused.value)
    report = sh.accuracy.roundings(unbounded, {"x": (1, 2)}, most=8, samples=9)
    assert report.conditions["x"] == (1.0, 1.0)
