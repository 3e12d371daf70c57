"""The lowest versions that pyproject.toml allows can be installed together, and run.

A test makes an environment of them, for which pip needs a package index.
"""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from patience import HANGING

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
TOLD = {"pyopencl": (2024, 2, 7), "matplotlib": (3, 8, 4)}
"""The first versions that do not refuse numpy 2.0, from their own metadata and from an import of each."""


def lowest() -> dict[str, str]:
    """The lower bound of each package that users install."""
    extras = ("opencl", "glsl", "raytracer", "accuracy", "cluster", "view", "notebook")
    wanted = [*PROJECT["dependencies"], *(r.partition(";")[0] for name in extras for r in EXTRAS[name])]
    return dict(re.fullmatch(r"([\w-]+(?:\[array\])?)>=([\d.]+)", requirement).groups() for requirement in wanted)


def test_what_refuses_numpy_2_is_not_allowed():
    bounds = lowest()
    assert bounds["numpy"].startswith("2.")
    for name, first in TOLD.items():
        assert tuple(map(int, bounds[name].split("."))) >= first, name


KERNEL = """
import numpy as np
import flip_evaluator, matplotlib.pyplot, mpmath, OpenEXR, rich
import shpy as sh
from raytracer import Scene, render

@sh.program
def wave(x: sh.Attrib1f) -> sh.Attrib2f:
    return sh.Attrib2f(sh.sin(x), sh.pow(x, 1.5))

x = np.linspace(0, 3, 1000, dtype=np.float32)
found = [wave.compile(b)(x) for b in ("numpy", "opencl", "glsl")]
assert all(np.array_equal(found[0], f) for f in found)
pictures = [render(Scene.builtin("mixed"), size=(40, 30), backend=b).pixels for b in ("numpy", "opencl", "glsl")]
assert all(np.array_equal(pictures[0], p) for p in pictures)

import dask.array as da
import distributed
blocks = sh.map_blocks(wave, da.from_array(x, chunks=300))
assert np.array_equal(blocks.compute(), found[0])

import anywidget, uvicorn, websockets
from shpy.view.server import View, application
application(View("shpy.view.session", {"path": "shader.py"}))

@sh.program
def shade(uv: sh.TexCoord2f) -> sh.Attrib1f:
    return uv.x

assert sh.widget(shade, size=(8, 4), backend="numpy")
print(np.__version__)
"""


@pytest.mark.slow
def test_the_lowest_versions_work_together(tmp_path):
    subprocess.run([sys.executable, "-m", "venv", tmp_path], check=True)
    python = tmp_path / "bin/python"
    pinned = [f"{name}=={version}" for name, version in lowest().items()]
    subprocess.run([python, "-m", "pip", "install", "-q", *pinned], check=True)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    ran = subprocess.run(
        [python, "-c", KERNEL], env=environment, capture_output=True, text=True, timeout=HANGING, cwd=tmp_path
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.split()[-1].startswith(lowest()["numpy"])
