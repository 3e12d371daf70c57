"""GLSL on a device without GL_ARB_gpu_shader5, which has no `precise`, in a process of its own: Mesa asks once."""

import os
import subprocess
import sys

from patience import HANGING

LIST = """
from shpy.backend.glsl.device.context import open_context
from shpy.testing.conformance.catalogue import all_cases
assert not open_context(0).limits.keeps_order

import numpy as np
import shpy as sh
@sh.program
def sizes(x: sh.Attrib1f) -> sh.Attrib1f:
    return sh.sign(sh.abs(x))
assert sizes.compile("glsl")(np.float32([np.nan, -2, 0, np.inf, -0.0])).tolist() == [0, 1, 0, 1, 0]
@sh.program
def power(x: sh.Attrib1f) -> sh.Attrib1f:
    return x ** 2.5
try:
    power.compile("glsl")
except sh.CompileError as error:
    assert "pow needs binary64" in str(error)
assert power.compile("glsl", math="portable")(np.float32(4)) == 32
ran = 0
for case in all_cases():
    if "glsl" not in case.refused and case.name.split("-")[0] in NAMES:
        case.check(case.run("glsl"), "glsl")
        ran += 1
print(ran)
"""
NAMES = """add sub mul div fma mad mod sign half mix length normalize smoothstep lt eq ne isnan isinf sin exp
refract
arithmetic_with_zero_is_not_folded signed_zeros_and_infinities comparisons_with_nan denormals_are_kept
fma_rounds_once_and_mad_twice mod_and_floor_division_of_floats a_counter_times_infinity mix_at_its_ends
a_variable_that_is_counted_down products_of_constants an_int_less_itself a_component_less_itself mandelbrot noises
the_square_of_a_root_is_not_its_radicand""".split()


def test_the_conformance_list_without_precise():
    environment = {**os.environ, "MESA_EXTENSION_OVERRIDE": "-GL_ARB_gpu_shader5"}
    done = subprocess.run(
        [sys.executable, "-c", LIST.replace("NAMES", repr(NAMES))], env=environment, capture_output=True, text=True,
        timeout=HANGING, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) >= 30


SOFTPIPE = """
from shpy.backend.glsl.device.context import open_context
from shpy.testing.conformance.catalogue import all_cases
limits = open_context(0).limits
assert limits.keeps_denormals and not limits.stores_apart and not limits.fuses, limits
for case in all_cases():
    if case.name in NAMES:
        case.check(case.run("glsl"), "glsl")
        print(case.name)
"""
CORRECTED = ["an_array_as_a_stack", "fma-f", "fma_rounds_once_and_mad_twice", "fma_keeps_the_sign_of_what_is_flushed"]


def test_what_softpipe_gets_wrong_is_corrected():
    environment = {
        **os.environ,
        "EGL_PLATFORM": "surfaceless",
        "LIBGL_ALWAYS_SOFTWARE": "1",
        "GALLIUM_DRIVER": "softpipe",
    }
    command = [sys.executable, "-c", SOFTPIPE.replace("NAMES", repr(CORRECTED))]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=HANGING, check=False)
    assert done.returncode == 0, done.stderr
    assert sorted(done.stdout.split()) == sorted(CORRECTED)
