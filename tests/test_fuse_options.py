"""`fuse` goes wherever `math` goes: measurements, commands, pictures, pages."""

import numpy as np
import pytest

import shpy as sh
from shpy import cli
from shpy.view.kernels import Form

SHADER = """
import shpy as sh

@sh.program
def errors(uv: sh.TexCoord2f) -> sh.Color3f:
    p = uv.x * uv.y
    return sh.Color3f(1e7 * (uv.x * uv.y - p))
"""


@sh.program
def residual(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    p = a * b
    return a * b - p


@sh.program
def line(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * 1.9990234375 + 0.3125


@sh.program
def errors(uv: sh.TexCoord2f) -> sh.Color3f:
    p = uv.x * uv.y
    return sh.Color3f(1e7 * (uv.x * uv.y - p))


@pytest.fixture
def shader(tmp_path):
    path = tmp_path / "shader.py"
    path.write_text(SHADER)
    return path


def test_errors_are_measured_with_and_without():
    report = sh.accuracy.measure(
        line, {"x": (1, 2)}, "numpy", ["strict", "fast"], samples=300, reference="f64", fuse=(False, True)
    )
    assert [(row.math, row.fuse) for row in report.rows] == [("strict", False), ("strict", True), ("fast", False)]
    plain, fused = report.rows[:2]
    assert fused.ulp[0] < 0.51 < plain.ulp[0]
    assert "strict fused" in report.table()
    assert [row["fuse"] for row in report.json()["rows"]] == [False, True, False]


def test_a_tradeoff_tries_it():
    few = {"samples": 50, "elements": 100, "rounds": 1, "reference": "f64"}
    t = sh.accuracy.tradeoff(
        line, {"x": (1, 2)}, sh.accuracy.ulp(0.51), "numpy", "strict", "f32", fuse=(False, True), **few
    )
    assert {str(c) for c in t.candidates} == {"numpy strict f32", "numpy strict fused f32"}
    assert t.pick.variant.fuse
    assert t.best.options.fuse
    assert "fused" in t.table()
    assert "a * b + c rounded once" in t.table()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"math": "fast", "fuse": True}, "math='fast' contracts by itself, without fuse=True"),
        ({"fuse": "yes"}, "fuse='yes' is neither"),
        ({"fuse": ()}, r"fuse=\(\) is neither"),
    ],
)
def test_measurements_that_nothing_is_left_of(options, message):
    with pytest.raises(sh.ShpyTypeError, match=message):
        sh.accuracy.measure(line, {"x": (1, 2)}, "numpy", **options)


def test_backends_are_compared_on_the_command_line(tmp_path, capsys):
    path = tmp_path / "residual.ir"
    path.write_text(str(residual.ir))
    assert cli.main(["diff", str(path), "--fuse", "--backends", "numpy,interpreter", "--count", "20"]) == 0
    assert "numpy, interpreter agree on 20 elements" in capsys.readouterr().out
    assert cli.main(["diff", str(path), "--fuse", "--math", "fast", "--backends", "numpy,interpreter"]) == 2
    assert "contracts products and sums already" in capsys.readouterr().err


def test_the_picture_of_a_page_and_its_recipe(shader, tmp_path):
    plain = sh.view.draw(shader, size=(16, 12), backend="numpy")
    fused = sh.view.draw(shader, size=(16, 12), backend="numpy", fuse=True)
    assert not plain[..., :3].any()
    assert fused[..., :3].any()
    output = tmp_path / "a.png"
    words = ["draw", str(shader), "--size", "16x12", "--backend", "opencl", "--fuse", "-o", str(output)]
    assert cli.main(words) == 0
    from PIL import Image

    assert np.array_equal(np.asarray(Image.open(output).convert("RGBA")), fused)


def test_modes_on_a_page_have_names():
    form = Form.named("numpy", "portable fused")
    assert form == Form("numpy", "portable", True)
    assert str(form) == "numpy, portable fused"
    assert str(Form("opencl", "strict")) == "opencl"
    assert Form("opencl", "strict", True).quick() == Form("numpy", "strict", True)


def test_a_page_refuses_it_beside_a_mode_that_contracts(shader, capsys):
    assert cli.main(["view", str(shader), "--math", "fast", "--fuse"]) == 2
    assert "--math fast contracts by itself" in capsys.readouterr().err


def test_animations(tmp_path):
    from PIL import Image

    for fuse in (False, True):
        folder = tmp_path / str(fuse)
        sh.animate(errors, folder, frames=1, size=(16, 12), backend="numpy", fuse=fuse)
        (frame,) = folder.glob("*.png")
        assert np.asarray(Image.open(frame)).any() == fuse


def test_an_animation_of_a_chain_has_kernels_of_its_own(tmp_path):
    chain = sh.repeat(line, 2)
    with pytest.raises(sh.ShpyTypeError) as error:
        sh.animate(chain, tmp_path / "x", frames=1, fuse=True, x=np.zeros(4, np.float32))
    assert error.value.cure == "step.compile(fuse=True) in the chain"
