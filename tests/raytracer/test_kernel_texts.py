"""Kernels hold only what their scene uses: texts stay as they were before a feature existed.

A digest is that of the program's IR without the lines of Python and without data (test_shared_kernels.py). A new one
is right only where the kernel of a scene that uses none of a new feature was meant to change.
"""

import hashlib
import re

import pytest

from raytracer import Scene
from raytracer.kernels.eye_rays import EyeRays
from raytracer.kernels.picture import eye_rays
from raytracer.kernels.tracer import Tracer
from raytracer.scene.layout import Layout
from shpy.run.kernel import forget_data

KERNELS = [
    ("boxes", "bvh", "numpy"),
    ("boxes", "bvh", "opencl"),
    ("boxes", "grid", "numpy"),
    ("mirror-box", "bvh", "numpy"),
    ("mixed", "grid", "numpy"),
]


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("name", "accel", "backend"), KERNELS)
def test_the_kernel_is_what_it_was(name, accel, backend, snapshots):
    scene = Scene.builtin(name)
    tracer = Tracer(Layout.of(scene, accel), scene.background, scene.ambient, 3, backend)
    module = forget_data(eye_rays(tracer, EyeRays()).ir)
    text = re.sub(r"^file .*\n| @\d+:\d+", "", str(module), flags=re.MULTILINE)
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    snapshots.check(f"kernels/{name}.{accel}.{backend}.sha256", f"{digest}\n")
