"""assert_golden: files that are written, kept and refused; what a failure names; the option of pytest."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from patience import HANGING
from testing.faults import op, with_fault

import shpy as sh
from shpy import SH_DISCARD

X = np.linspace(-4, 4, 17).astype(np.float32)


def doubled(factor: float = 2) -> sh.Program:
    @sh.program
    def rounded(x: sh.Attrib1f, y: sh.Attrib2f) -> tuple[sh.Attrib1f, sh.Attrib2f]:
        whole = sh.floor(x)
        SH_DISCARD(x > 3.8)
        return whole * factor, y + whole

    return rounded


def written_otherwise() -> sh.Program:
    """Return a program with the bits of `doubled`."""

    @sh.program
    def rounded(x: sh.Attrib1f, y: sh.Attrib2f) -> tuple[sh.Attrib1f, sh.Attrib2f]:
        SH_DISCARD(x > 3.8)
        return sh.floor(x) + sh.floor(x), sh.floor(x) + y

    return rounded


BACKENDS = ("numpy", "glsl")


def read(folder: Path, program: sh.Program, *inputs, backends=BACKENDS, **named):
    return sh.testing.assert_golden(program, *inputs, name="steps", folder=folder, backends=backends, **named)


def write(folder: Path, program: sh.Program, *inputs, **named):
    return read(folder, program, *inputs, update=True, **named)


def test_a_written_result_holds_on_every_backend(tmp_path):
    write(tmp_path, doubled(), X, [1, 2])
    agreement = read(tmp_path, doubled(), X, [1, 2], backends=None)
    assert agreement.backends == ("golden", "numpy", "opencl-1", "opencl-4", "opencl-8", "opencl-16", "glsl")
    assert [path.name for path in tmp_path.iterdir()] == ["steps.npz"]


def test_a_missing_file_fails_and_says_how_to_write_it(tmp_path):
    with pytest.raises(
        AssertionError, match=r"no golden result .*steps.npz; pytest --shpy-update or update=True writes it"
    ):
        read(tmp_path, doubled(), X, [1, 2])
    assert not list(tmp_path.iterdir())


def test_a_changed_program_is_named_by_its_first_statement(tmp_path):
    write(tmp_path, doubled(), X, [1, 2])
    with pytest.raises(AssertionError) as failure:
        read(tmp_path, doubled(3), X, [1, 2])
    text = str(failure.value)
    assert "rounded: golden and numpy differ in 14 of 17 elements, first in element 0" in text
    assert "    golden       -8.0  (-0x1.0000000000000p+3)" in text
    assert "    numpy        -12.0  (-0x1.8000000000000p+3)" in text
    assert "the first statement that changed, at " in text
    assert "    return whole * factor, y + whole" in text
    assert "  golden       %9: f = const 0x1p+1" in text
    assert "  now          %9: f = const 0x1.8p+1" in text


def test_a_program_that_is_written_otherwise_with_the_same_bits_passes(tmp_path):
    write(tmp_path, doubled(), X, [1, 2])
    read(tmp_path, written_otherwise(), X, [1, 2])


@pytest.mark.parametrize("faulty", ["numpy", "glsl"])
def test_one_wrong_bit_of_a_backend_is_a_failure(tmp_path, monkeypatch, faulty):
    write(tmp_path, doubled(), X, [1, 2])
    with_fault(monkeypatch, faulty, op("floor", "trunc"))
    with pytest.raises(AssertionError) as failure:
        read(tmp_path, doubled(), X, [1, 2])
    text = str(failure.value)
    assert f"rounded: golden and {faulty} differ in 4 of 17 elements, first in element 1" in text
    assert "the recorded program is that of the file; so are the inputs" in text


def test_other_inputs_are_named(tmp_path):
    write(tmp_path, doubled(), X, [1, 2])
    with pytest.raises(AssertionError, match="is that of the file; the inputs, or a Param, are not"):
        read(tmp_path, doubled(), X, [1, 3])
    with pytest.raises(
        AssertionError, match="the golden result has 17 elements of 1 x float32, 2 x float32, and the run 16"
    ):
        read(tmp_path, doubled(), X[1:], [1, 2])


def test_a_param_is_one_of_the_inputs(tmp_path):
    gain = sh.Param(sh.Attrib1f, 2.0)

    @sh.program
    def louder(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * gain

    write(tmp_path, louder, X)
    gain.value = 3
    with pytest.raises(AssertionError, match="the inputs, or a Param, are not"):
        read(tmp_path, louder, X)


def test_the_end_of_elements_counts(tmp_path):
    @sh.program
    def rounded(x: sh.Attrib1f, y: sh.Attrib2f) -> tuple[sh.Attrib1f, sh.Attrib2f]:
        whole = sh.floor(x)
        return whole * 2, y + whole

    write(tmp_path, doubled(), X, [1, 2])
    with pytest.raises(AssertionError, match="golden and numpy differ in 1 of 17 elements, first in element 16"):
        read(tmp_path, rounded, X, [1, 2])


def test_precisions_and_shapes(tmp_path):
    write(tmp_path, doubled(), X, [1, 2], precision="f16")
    read(tmp_path, doubled(), X, [1, 2], precision="f16")
    with pytest.raises(AssertionError, match="1 x float16, 2 x float16, and the run 17 elements of 1 x float32"):
        read(tmp_path, doubled(), X, [1, 2])


def test_a_picture_lies_beside_the_file_of_a_picture(tmp_path):
    @sh.program
    def ramp(uv: sh.TexCoord2f) -> sh.Color3f:
        return sh.Color3f(uv, 0.5)

    y, x = np.mgrid[0:4, 0:6] / np.float32(8)
    write(tmp_path, ramp, np.stack([x, y], -1))
    assert {path.name for path in tmp_path.iterdir()} == {"steps.npz", "steps.png"}
    from PIL import Image

    picture = Image.open(tmp_path / "steps.png")
    assert picture.size == (6, 4)
    assert picture.getpixel((4, 2)) == (128, 64, 128, 255)


def test_an_unchanged_file_is_not_written_again(tmp_path):
    write(tmp_path, doubled(), X, [1, 2])
    before = (tmp_path / "steps.npz").read_bytes()
    moment = (tmp_path / "steps.npz").stat().st_mtime_ns
    write(tmp_path, doubled(), X, [1, 2])
    assert (tmp_path / "steps.npz").stat().st_mtime_ns == moment
    (tmp_path / "steps.npz").unlink()
    write(tmp_path, doubled(), X, [1, 2])
    assert (tmp_path / "steps.npz").read_bytes() == before


def test_a_program_that_is_written_otherwise_is_the_one_to_compare_with_after_an_update(tmp_path):
    write(tmp_path, doubled(), X, [1, 2])
    write(tmp_path, written_otherwise(), X, [1, 2])
    with pytest.raises(AssertionError, match="is that of the file; the inputs, or a Param, are not"):
        read(tmp_path, written_otherwise(), X, [1, 3])


def test_backends_that_differ_write_nothing(tmp_path, monkeypatch):
    with_fault(monkeypatch, "glsl", op("floor", "trunc"))
    with pytest.raises(AssertionError, match="numpy and glsl differ"):
        write(tmp_path, doubled(), X, [1, 2])
    assert not list(tmp_path.iterdir())


def test_a_file_that_holds_something_else_is_refused(tmp_path):
    (tmp_path / "steps.npz").write_bytes(b"PK broken")
    with pytest.raises(sh.ShpyError, match=r"steps\.npz holds no golden result"):
        read(tmp_path, doubled(), X, [1, 2])
    np.savez(tmp_path / "steps.npz", output0=X)
    with pytest.raises(sh.ShpyError, match=r"steps\.npz holds no golden result"):
        read(tmp_path, doubled(), X, [1, 2])


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ({"name": "../steps"}, "name='../steps' is no name of a file"),
        ({"name": ""}, "name='' is no name of a file"),
        ({"math": "fast"}, "math='fast' gives other bits on other backends"),
    ],
)
def test_bad_arguments_are_refused_before_a_run(tmp_path, named, message):
    with pytest.raises(sh.ShpyTypeError, match=message):
        sh.testing.assert_golden(doubled(), X, [1, 2], **{"name": "steps", "folder": tmp_path, **named})


USER = """
import numpy as np
import shpy as sh

@sh.program
def half(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * {factor}

def test_half():
    sh.testing.assert_golden(half, np.arange(5), name="half", backends=["numpy", "interpreter"])
"""


def test_pytest_writes_reads_and_renews(tmp_path):
    def pytest_of_a_user(factor, *options):
        (tmp_path / "test_user.py").write_text(USER.format(factor=factor))
        command = [sys.executable, "-B", "-m", "pytest", "-q"]
        command += ["-p", "shpy_start.pytest_plugin", "-p", "no:cacheprovider"]
        return subprocess.run(
            [*command, *options], cwd=tmp_path, capture_output=True, text=True, timeout=HANGING,
            env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        )  # fmt: skip

    assert "1 passed" in pytest_of_a_user(0.5, "--shpy-update").stdout
    assert (tmp_path / "golden" / "half.npz").rename(tmp_path / "half.npz").is_file()
    assert "there is no golden result" in pytest_of_a_user(0.5).stdout
    (tmp_path / "half.npz").rename(tmp_path / "golden" / "half.npz")
    changed = pytest_of_a_user(0.25).stdout
    assert "half: golden and numpy differ in 4 of 5 elements, first in element 1" in changed
    assert "return x * 0.25" in changed
    assert "1 passed" in pytest_of_a_user(0.25, "--shpy-update").stdout
    assert "1 passed" in pytest_of_a_user(0.25).stdout


def heat(rate: float = 0.25):
    @sh.program
    def spread(u: sh.Table[sh.Attrib1f]):
        k = sh.grid_index(1)
        return {"u": u[k] + (u[k - 1] + u[k + 1] - 2 * u[k]) * rate}

    return sh.repeat(spread, 5)


def test_a_chain_is_held_by_its_streams(tmp_path):
    def read(chain, **options):
        return sh.testing.assert_golden(chain, name="heat", folder=tmp_path, u=X, **options)

    with pytest.raises(AssertionError, match="no golden result"):
        read(heat())
    read(heat(), update=True, backends=["numpy", "opencl"])
    assert read(heat()).backends == ("golden", "numpy", "opencl", "glsl")
    with pytest.raises(AssertionError) as failure:
        read(heat(0.125), backends=["numpy"])
    text = str(failure.value)
    assert "stream u: golden and numpy differ in " in text
    assert "of 17 numbers, first in (" in text
    assert "const 0x1p-2" in text
    assert "const 0x1p-3" in text
    with pytest.raises(sh.ShpyTypeError, match=r"repeat\(.*\) takes its streams by name"):
        sh.testing.assert_golden(heat(), X, name="heat", folder=tmp_path)
    with pytest.raises(sh.ShpyTypeError, match="a chain does not run on opencl-8"):
        read(heat(), backends=["opencl-8"])
