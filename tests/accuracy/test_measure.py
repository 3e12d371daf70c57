"""Reports: errors that are known, special values, what is skipped; the picture and its JSON; the command."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from patience import HANGING
from testing.faults import op, with_fault

import shpy as sh
from shpy import cli
from shpy.accuracy.domain import draw, special_values
from shpy.ir.types import vec

FILE = """
import shpy as sh

@sh.program
def third(x: sh.Attrib1f) -> sh.Attrib1f:
    return x / 3 * 3 - x

def plain(x): return sh.sqrt(x)
def rough(x): return x * 0.5 + 0.5
root = sh.choice("root", {"plain": plain, "rough": rough})

@sh.program
def near_one(x: sh.Attrib1f) -> sh.Attrib1f:
    return root(x)
"""


@sh.program
def product(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
    return x * y


def test_a_product_is_half_a_unit_off_at_most():
    report = sh.accuracy.measure(
        product, {"x": (1, 1e3, "log"), "y": (0.5, 2)}, backends=["numpy", "opencl"], math="strict"
    )
    assert [row.backend for row in report.rows] == ["numpy", "opencl"]
    for row in report.rows:
        assert 0.4 < row.ulp[0] <= 0.5
        assert row.ulp[0] >= row.ulp[1] >= row.ulp[2] > 0.1
        assert 2**-26 < row.relative[0] <= 2**-24
        assert sum(row.histogram) == row.count > 2000
        assert sum(row.histogram[2:]) == 0
        x, y = row.worst["x"], row.worst["y"]
        assert row.found == x * y
        assert row.exact == float(x) * float(y)
        assert row.edges == 0
        assert row.specials > 100


def test_a_known_error_is_found_with_its_place(monkeypatch):
    with_fault(monkeypatch, "numpy", op("max", "add"))

    @sh.program
    def wrong(x: sh.Attrib1f) -> sh.Attrib1f:
        return sh.max(x * 2, 2.0**-20)

    report = sh.accuracy.measure(wrong, {"x": (1, 1.999)}, backends="numpy", math="strict")
    assert report.rows[0].ulp[0] == pytest.approx(4, abs=0.1)


def test_special_values_outside_the_domain_are_edges(monkeypatch):
    with_fault(monkeypatch, "numpy", op("isinf", "isnan"))

    @sh.program
    def finite(x: sh.Attrib1f) -> sh.Attrib1f:
        return sh.cond(sh.isinf(x), 0.0, x)

    row = sh.accuracy.measure(finite, {"x": (0, 10)}, backends="numpy", math="strict").rows[0]
    assert row.ulp == (0, 0, 0)
    assert row.edges == 3  # both infinities, and NaN
    assert not np.isfinite(row.edge["x"])


def test_special_values_are_there():
    values = special_values(vec("f")).tolist()
    for wanted in (
        0.0,
        1.0,
        -1.0,
        0.5,
        1.5,
        2.0**-149,
        2.0**-126,
        float("inf"),
        -float("inf"),
        2.0**24,
        3.4028234663852886e38,
    ):
        assert wanted in values
    assert any(np.signbit(v) for v in values if v == 0)
    assert any(v != v for v in values)
    assert np.nextafter(np.float32(1), np.float32(2)) in special_values(vec("f"))
    assert {-(2**31), 2**31 - 1, 0, -1} <= set(special_values(vec("i")).tolist())


def test_domains_are_ranges_arrays_and_samplers():
    rng = np.random.default_rng(1)
    ranges = draw(product, {"x": (1e-6, 1e6, "log"), "y": (-2, 2)}, 1000, rng, special=False).leaves
    assert np.quantile(ranges["x"], 0.5) < 10
    assert ranges["y"].min() < -1.9
    given = draw(product, {"x": [1.0, 2.0], "y": lambda rng, n: rng.normal(size=n)}, 50, rng, special=False).leaves
    assert set(given["x"].tolist()) == {1, 2}
    assert given["y"].shape == (50,)
    inside = draw(product, {"x": (0, 1), "y": [1.0]}, 50, rng)
    assert inside.inside[:50].all()
    outside = inside.leaves["x"][~inside.inside]
    assert np.isnan(outside).any()
    assert not inside.inside[(inside.leaves["x"] > 1) | np.isnan(inside.leaves["x"])].any()


@pytest.mark.parametrize(("low", "high"), [(-1e3, -1e-3), (1e-300, 1e-100), (-1e300, -1e100)])
def test_logarithmic_ranges_have_either_sign_and_any_size(low, high):
    domain = {"x": (low, high, "log"), "y": (0, 1)}
    x = draw(product, domain, 1000, np.random.default_rng(1), precision="f64", special=False).leaves["x"]
    assert low <= x.min() <= x.max() <= high
    middle = np.copysign(np.sqrt(abs(low)) * np.sqrt(abs(high)), low)
    assert 400 < np.count_nonzero(x < middle) < 600


@pytest.mark.parametrize(
    ("domain", "said"),
    [
        ({"x": (0, 1)}, "the domain says nothing of y, an input of product"),
        ({"x": (0, 1), "y": (0, 1), "z": (0, 1)}, "z is no input of product"),
        ({"x": (0, 1, "log"), "y": (0, 1)}, "is no range"),
    ],
)
def test_a_domain_that_does_not_fit(domain, said):
    with pytest.raises(sh.ShpyTypeError, match=said):
        sh.accuracy.measure(product, domain, backends="numpy", samples=10)


def test_ranges_of_ints_may_be_logarithmic_and_hold_the_ints_inside_alone():
    @sh.program
    def same(n: sh.Attrib1i, m: sh.Attrib1u) -> sh.Attrib1i:
        return n + sh.Attrib1i(m)

    rng = np.random.default_rng(3)
    drawn = draw(same, {"n": (-(2**31), -1, "log"), "m": (0.5, 3.5)}, 4000, rng, special=False).leaves
    sizes = np.log2(-drawn["n"].astype(np.float64))
    assert np.histogram(sizes, bins=4, range=(0, 31))[0].min() > 800
    assert set(drawn["m"].tolist()) == {1, 2, 3}


def test_a_program_without_element_inputs_is_measured_on_one_element():
    gain = sh.Param(sh.Attrib1f, 2.0, name="gain")

    @sh.program
    def third() -> sh.Attrib1f:
        return gain / 3

    @sh.program
    def first(table: sh.Table[sh.Attrib1f]) -> sh.Attrib1f:
        return table[0] / 3

    for program, domain in ((third, {}), (first, {"table": [2.0, 1.0]})):
        row = sh.accuracy.measure(program, domain, backends="numpy", math="strict").rows[0]
        assert (row.count, row.found) == (1, np.float32(2 / 3))
        assert 0 < row.ulp[0] <= 0.5


def test_what_a_target_cannot_do_is_said():
    report = sh.accuracy.measure(
        product, {"x": (1, 2), "y": (1, 2)}, backends="glsl", math="strict", precision=["f32", "f64"], samples=20
    )
    assert [row.precision for row in report.rows] == ["f32"]
    assert report.skipped[0][0].endswith("f64")
    assert "not measured: glsl" in report.table()


def test_there_is_no_picture_of_what_no_target_can_run(tmp_path):
    report = sh.accuracy.measure(product, {"x": (0, 1), "y": (0, 1)}, backends="glsl", precision="f64", samples=5)
    assert not report.rows
    with pytest.raises(sh.ShpyError, match="no variant of product was measured") as caught:
        report.plot(tmp_path / "x.png")
    assert caught.value.cure == report.skipped[0][1]
    assert caught.value.loc.file == __file__


def test_table_picture_and_json(tmp_path):
    report = sh.accuracy.measure(
        product, {"x": (1, 2), "y": (1, 2)}, backends=["numpy"], math="strict", samples=200, reference="f64"
    )
    head, titles, row = report.table().splitlines()
    assert head == "product, against f64"
    assert titles.split()[:5] == ["backend", "math", "precision", "output", "max"]
    assert row.startswith("numpy")
    assert "x=1." in row
    report.plot(tmp_path / "error.png")
    assert (tmp_path / "error.png").read_bytes().startswith(b"\x89PNG")
    said = json.loads((tmp_path / "error.json").read_text())
    assert said["rows"][0]["ulp"][0] == report.rows[0].ulp[0]
    assert len(said["rows"][0]["bins"]) == len(said["rows"][0]["histogram"])


def test_the_command_accuracy(tmp_path, capsys):
    (tmp_path / "mine.py").write_text(FILE)
    words = ["accuracy", f"{tmp_path / 'mine.py'}:third", "--domain", "x=1:2", "--backends", "numpy", "--samples", "50"]
    assert cli.main([*words, "-o", str(tmp_path / "e.json")]) == 0
    said = capsys.readouterr().out
    assert "third, against mpmath" in said
    assert json.loads((tmp_path / "e.json").read_text())["program"] == "third"


def test_the_file_of_a_program_may_import_its_neighbours(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "accuracy_neighbour.py").write_text(FILE)
    (tmp_path / "mine.py").write_text("from accuracy_neighbour import third\n")
    words = ["accuracy", f"{tmp_path / 'mine.py'}:third", "--backends", "numpy", "--math", "strict", "--samples", "5"]
    assert cli.main(words) == 0
    assert "third, against mpmath" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere:program"], "nowhere cannot be imported"),
        ([".nowhere:program"], "shpy accuracy: .nowhere is no name of a module"),
        (["program"], "names no program"),
        (["{file}:second"], "has no program 'second'"),
        (["{file}:third", "--domain", "x=1"], "is no range"),
        (["{file}:third", "--domain", "y=1:2"], "y is no input of third"),
    ],
)
def test_the_command_says_what_is_wrong(tmp_path, capsys, words, said):
    (tmp_path / "mine.py").write_text(FILE)
    assert cli.main(["accuracy", *(w.format(file=tmp_path / "mine.py") for w in words)]) == 2
    assert said in capsys.readouterr().err


WITHOUT = """
import sys
sys.modules["mpmath"] = sys.modules["matplotlib"] = None
import shpy as sh

double = sh.Program.from_ir(sh.parse(sys.argv[1]))
try:
    sh.accuracy.measure(double, {"x": (0, 1), "y": (0, 1)}, backends="numpy", samples=5)
except sh.ShpyError as error:
    print(error)
report = sh.accuracy.measure(double, {"x": (0, 1), "y": (0, 1)}, backends="numpy", samples=5, reference="f64")
try:
    report.plot("x.png")
except sh.ShpyError as error:
    print(error)
"""


def test_mpmath_and_matplotlib_are_optional():
    text = str(product.ir)
    done = subprocess.run([sys.executable, "-c", WITHOUT, text], capture_output=True, text=True, timeout=HANGING)
    assert done.returncode == 0, done.stderr
    assert "a reference by mpmath needs mpmath" in done.stdout
    assert "plots need matplotlib" in done.stdout
    assert sh.packages.install("mpmath") in done.stdout
    assert sh.packages.install("matplotlib") in done.stdout


def test_a_matrix_is_measured_row_by_row():
    @sh.program
    def turned(x: sh.Attrib1f) -> sh.Matrix2f:
        return sh.Matrix2f((sh.cos(x), -sh.sin(x)), (sh.sin(x), sh.cos(x)))

    report = sh.accuracy.measure(turned, {"x": (0, 10)}, backends="numpy", math="strict", samples=40)
    assert [row.output for row in report.rows] == ["[0]", "[1]"]
    assert all(max(row.ulp) <= 0.5 for row in report.rows)
