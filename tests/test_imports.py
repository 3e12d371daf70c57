"""Imports load what a plain program needs, and the rest on first use."""

import subprocess
import sys

import pytest
from patience import HANGING

import raytracer
import shpy as sh

LATER = {
    "shpy": {"multiprocessing", "pathlib", "asyncio", "pyopencl", "shpy.chains", "shpy.collectives", "shpy.cluster"},
    "raytracer": {"asyncio", "PIL", "raytracer.cluster", "raytracer.studies", "raytracer.intersector"},
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("package", LATER)
def test_an_import_loads_no_more_than_a_plain_program_needs(package):
    text = f"import sys, numpy; before = set(sys.modules); import {package}; print(*set(sys.modules) - before)"
    ended = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=HANGING, check=True)
    assert LATER[package] & set(ended.stdout.split()) == set()


@pytest.mark.parametrize("package", [sh, raytracer])
def test_names_that_are_loaded_on_first_use_are_listed(package):
    assert set(package.__all__) | package._LATER.keys() <= set(dir(package))
    assert all(getattr(package, name).__module__.startswith(package.__name__) for name in package._LATER)


def test_streams_reach_collectives_without_another_import_and_plain_arrays_need_no_masked_ones():
    text = (
        "import sys, numpy as np, shpy as sh; from raytracer.arrays import numbers; "
        "print(sh.Stream(np.float32([1, 2, 4]), sh.Attrib1f, 'numpy').sum(), *numbers('n', [[0, 1]]).ravel(), "
        "'numpy.ma' in sys.modules)"
    )
    ended = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=HANGING, check=True)
    assert ended.stdout == "7.0 0.0 1.0 False\n"
