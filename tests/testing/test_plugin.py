"""The pytest plugin: the fixture, the options, in a run of pytest of its own."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from patience import HANGING

PLUGIN = "shpy_start.pytest_plugin"
TESTS = """
import numpy as np
import shpy as sh

@sh.program
def double(x: sh.Attrib1f) -> sh.Attrib1f:
    return 2 * x

@sh.program
def wave(x: sh.Attrib1f) -> sh.Attrib1f:
    return sh.sin(x)

def test_each(shpy_backend):
    assert double.compile(shpy_backend)(np.float32(2)) == 4

def test_all():
    print("compared", sh.testing.assert_equivalent(double, [1, 2]).backends)

def test_close():
    sh.testing.assert_equivalent(wave, np.linspace(0, 100, 999), backends=["numpy", "interpreter", "opencl-1"])
"""


@pytest.fixture
def pytest_runs(tmp_path):
    (tmp_path / "test_user.py").write_text(TESTS)

    def run(*options):
        command = [sys.executable, "-m", "pytest", "-p", PLUGIN, "-v", "-s", "-p", "no:cacheprovider"]
        return subprocess.run(
            [*command, *options], cwd=tmp_path, capture_output=True, text=True, timeout=HANGING,
            env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        )  # fmt: skip

    return run


def test_the_fixture_runs_a_test_on_each_backend(pytest_runs):
    said = pytest_runs("-k", "each").stdout
    for name in ("numpy", "opencl", "glsl"):
        assert f"test_each[{name}] PASSED" in said
    assert "3 passed" in said


def test_the_options_choose_backends_and_distance(pytest_runs):
    said = pytest_runs("--shpy-backends", "numpy,glsl", "--shpy-ulp", "4").stdout
    assert "test_each[numpy] PASSED" in said
    assert "test_each[glsl] PASSED" in said
    assert "test_each[opencl]" not in said
    assert "compared ('numpy', 'glsl')" in said
    assert "4 passed" in said


def test_a_run_without_tests_of_shpy_loads_the_plugin_alone(pytest_runs, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # other plugins may import numpy
    names = "[name for name in sys.modules if name.split('.')[0] in ('numpy', 'raytracer', 'shpy', 'shpy_start')]"
    (tmp_path / "test_user.py").write_text(f"import sys\ndef test_plain(): print('loaded', *sorted({names}))")
    assert f"loaded shpy_start {PLUGIN}\n" in pytest_runs().stdout


def test_an_unknown_backend_is_a_usage_error(pytest_runs):
    done = pytest_runs("--shpy-backends", "numpy,metal")
    assert done.returncode == 4
    assert "there is no backend 'metal'" in done.stderr


def test_the_package_declares_it():
    import tomllib
    from pathlib import Path

    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    assert project["entry-points"]["pytest11"] == {PLUGIN: PLUGIN}
    assert {"testing", "accuracy"} <= project["optional-dependencies"].keys()
