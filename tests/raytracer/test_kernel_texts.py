"""What a scene does not use is not in its kernel: texts stay as they were before a feature existed.

A digest is that of the program's IR without the lines of Python and without data (test_shared_kernels.py). A new one
is right only where the kernel of a scene that uses none of a new feature was meant to change.
"""

import hashlib
import re

import pytest

from raytracer import Scene
from raytracer.kernels.eye_rays import EyeRays
from raytracer.kernels.tracer import Tracer
from raytracer.layout import Layout
from raytracer.renderer import eye_rays
from shpy.passes.forget import forget_data

DIGESTS = {
    ("boxes", "bvh", "numpy"): "b5ba05622ad6771b",
    ("boxes", "bvh", "opencl"): "a545be007ef95cbc",
    ("boxes", "grid", "numpy"): "b02ab28272e1bfa3",
    ("mirror-box", "bvh", "numpy"): "e3ea8499bae8f8a8",
    ("mixed", "grid", "numpy"): "b42fbffcf19986cc",
}


@pytest.mark.parametrize(("name", "accel", "backend"), DIGESTS)
def test_the_kernel_is_what_it_was(name, accel, backend):
    scene = Scene.builtin(name)
    tracer = Tracer(Layout.of(scene, accel), scene.background, scene.ambient, 3, backend)
    module = forget_data(eye_rays(tracer, EyeRays()).ir)
    text = re.sub(r"^file .*\n| @\d+:\d+", "", str(module), flags=re.MULTILINE)
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == DIGESTS[name, accel, backend]
