"""The command `shpy`: what it says of a machine where everything, or hardly anything, is installed."""

import importlib.metadata
import re
import subprocess
import sys

import numpy as np
import pytest
from patience import HANGING
from testing.faults import op, with_fault

import shpy as sh
from shpy import cli, packages


def test_doctor_names_every_backend_with_its_devices(capsys):
    assert cli.main(["doctor", "--all"]) == 0
    said = capsys.readouterr().out
    for backend in sh.backends():
        assert re.search(rf"^  {backend.name} +works$", said, re.MULTILINE)
        assert backend.devices[0].name in said
    assert "3 of 3 backends work; the default is" in said
    assert np.__version__ in said


NOTHING_INSTALLED = """
import sys
sys.modules["pyopencl"] = sys.modules["moderngl"] = None
from shpy.cli import main
print("status", main(["doctor"]), main(["doctor", "--all"]))
"""


def test_doctor_is_content_with_numpy_alone_and_names_the_cure():
    done = subprocess.run([sys.executable, "-c", NOTHING_INSTALLED], capture_output=True, text=True, timeout=HANGING)
    assert done.returncode == 0, done.stderr
    assert "1 of 3 backends work; the default is numpy" in done.stdout
    assert f"to mend it: {sh.packages.install('pyopencl')}" in done.stdout
    assert f"to mend it: {sh.packages.install('moderngl')}" in done.stdout
    assert "status 0 1" in done.stdout


def test_doctor_finds_out_that_a_backend_gives_wrong_numbers(monkeypatch, capsys):
    monkeypatch.setattr(sh.Kernel, "__call__", lambda self, x: np.zeros(5, np.float32))
    assert cli.main(["doctor"]) == 1
    assert "2 * x + 1 of 0 to 4 gave [0. 0. 0. 0. 0.]" in capsys.readouterr().out


def test_doctor_survives_a_driver_that_fails(monkeypatch, capsys):
    def fails(self, x):
        raise OSError("the driver is gone")

    monkeypatch.setattr(sh.Kernel, "__call__", fails)
    assert cli.main(["doctor"]) == 1
    assert "OSError: the driver is gone" in capsys.readouterr().out


def test_doctor_lists_optional_packages_as_the_installed_package_declares_them(monkeypatch, capsys):
    lines = [
        "numpy>=2",
        'rich>=13; extra == "pretty"',
        'nowhere-to-be-found>2; extra == "more"',
        'x[a]; extra == "dev"',
    ]
    declared = {"Provides-Extra": ["pretty", "more", "dev", "empty"], "Requires-Dist": lines}

    class Metadata:
        def get_all(self, key, default):
            return declared.get(key, default)

    version = importlib.metadata.version
    monkeypatch.setattr(importlib.metadata, "metadata", lambda name: Metadata())
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "1.2" if "shpy" in name else version(name))
    assert packages.extras() == {"pretty": ["rich"], "more": ["nowhere-to-be-found"]}
    cli.doctor()
    said = capsys.readouterr().out
    assert re.search(r"nowhere-to-be-found +missing", said)
    assert re.findall(r"to install: .*", said) == [f"to install: {packages.install('nowhere-to-be-found')}"]


def test_version(monkeypatch, capsys):
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "1.2.3")
    with pytest.raises(SystemExit) as end:
        cli.main(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out == "shpy 1.2.3\n"


@pytest.mark.parametrize("arguments", [[], ["surgeon"]])
def test_what_is_not_understood_shows_the_usage(arguments, capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(arguments)
    assert end.value.code == 2
    assert "usage: shpy" in capsys.readouterr().err


IR = """module scaled
input x: Attrib1f
output y: Attrib1f
table line: f[?]

function scaled(%x.0: f) -> ($y.0: f) {
  %1: i = const 1
  %2: f = table line[%1]
  %3: f = mul %x.0, %2
  store $y.0 = %3
}
"""


def test_diff_says_that_backends_agree(tmp_path, capsys):
    (tmp_path / "a.ir").write_text(IR)
    assert cli.main(["diff", str(tmp_path / "a.ir"), "--backends", "numpy,interpreter", "--count", "30"]) == 0
    assert capsys.readouterr().out == "numpy, interpreter agree on 30 elements\n"


def test_diff_names_the_statement_at_which_backends_part(tmp_path, capsys, monkeypatch):
    with_fault(monkeypatch, "opencl", op("mul", "add"))
    (tmp_path / "a.ir").write_text(IR)
    assert cli.main(["diff", str(tmp_path / "a.ir"), "--backends", "numpy,opencl-4"]) == 1
    said = capsys.readouterr().out
    assert "scaled: numpy and opencl-4 differ in " in said
    assert "mul(x, %2)" in said


@pytest.mark.parametrize("text", ["module", IR.replace("mul", "mull"), IR.replace("%3: f", "%3: f2")])
def test_diff_refuses_a_text_that_is_no_program(tmp_path, capsys, text):
    (tmp_path / "a.ir").write_text(text)
    assert cli.main(["diff", str(tmp_path / "a.ir")]) == 2
    assert capsys.readouterr().err.startswith("shpy diff: ")


def test_diff_refuses_a_file_that_is_not_there(capsys):
    assert cli.main(["diff", "nowhere.ir"]) == 2
    assert "nowhere.ir" in capsys.readouterr().err
