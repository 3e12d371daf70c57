"""What a scene does not use is not in its kernel: texts stay as they were before a feature existed.

A digest is that of the program's IR without the lines of Python. A new one is right only where the kernel of a scene
that uses none of a new feature was meant to change.
"""

import hashlib
import re

import pytest

from raytracer import Scene
from raytracer.kernels.eye_rays import EyeRays
from raytracer.kernels.tracer import Tracer
from raytracer.layout import Layout
from raytracer.renderer import eye_rays

DIGESTS = {
    ("boxes", "bvh", "numpy"): "f3378859e081e456",
    ("boxes", "bvh", "opencl"): "173a7a199773e567",
    ("boxes", "grid", "numpy"): "3bae8e4b59d55f4d",
    ("mirror-box", "bvh", "numpy"): "47b78906ceec72a3",
    ("mixed", "grid", "numpy"): "e3d21378f1915a3d",
}


@pytest.mark.parametrize(("name", "accel", "backend"), DIGESTS)
def test_the_kernel_is_what_it_was(name, accel, backend):
    scene = Scene.builtin(name)
    tracer = Tracer(Layout.of(scene, accel), scene.background, scene.ambient, 3, backend)
    text = re.sub(r"^file .*\n| @\d+:\d+", "", str(eye_rays(tracer, EyeRays()).ir), flags=re.MULTILINE)
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == DIGESTS[name, accel, backend]
