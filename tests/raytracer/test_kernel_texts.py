"""Kernels hold only what their scene uses: texts stay as they were before a feature existed.

A digest is that of the program's IR without the lines of Python and without data (test_shared_kernels.py). A new one
is right only where the kernel of a scene that uses none of a new feature was meant to change.
"""

import hashlib
import re

import pytest

from raytracer import Scene
from raytracer.integrators.renderer import eye_rays
from raytracer.kernels.eye_rays import EyeRays
from raytracer.kernels.tracer import Tracer
from raytracer.scene.layout import Layout
from shpy.passes.forget import forget_data

DIGESTS = {
    ("boxes", "bvh", "numpy"): "6be27c578a1ddac3",
    ("boxes", "bvh", "opencl"): "123bd27121c045b8",
    ("boxes", "grid", "numpy"): "73a2c3e64fbb6f20",
    ("mirror-box", "bvh", "numpy"): "9c2dac2106d1d795",
    ("mixed", "grid", "numpy"): "31820924e911b59e",
}


@pytest.mark.parametrize(("name", "accel", "backend"), DIGESTS)
def test_the_kernel_is_what_it_was(name, accel, backend):
    scene = Scene.builtin(name)
    tracer = Tracer(Layout.of(scene, accel), scene.background, scene.ambient, 3, backend)
    module = forget_data(eye_rays(tracer, EyeRays()).ir)
    text = re.sub(r"^file .*\n| @\d+:\d+", "", str(module), flags=re.MULTILINE)
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == DIGESTS[name, accel, backend]
