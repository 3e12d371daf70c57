"""The text of each target for a recorded module; on GLSL for a device without faults, which has binary64."""

from collections.abc import Callable

from shpy.backend.base import Options
from shpy.backend.glsl import text_for
from shpy.backend.glsl.text.interface import Limits
from shpy.backend.numpy.device.run import TARGET as NUMPY
from shpy.backend.numpy.text.apart import lay_out
from shpy.backend.numpy.text.module import print_python
from shpy.backend.opencl.device.driver import TARGET as OPENCL
from shpy.backend.opencl.text.kernel import print_kernel
from shpy.ir.nodes import Module
from shpy.passes.pipeline import prepare

TEXTS: dict[str, Callable[[Module], str]] = {
    "numpy": lambda module: print_python(lay_out(prepare(module, Options(), NUMPY).module).vector).text,
    "opencl": lambda module: print_kernel(prepare(module, Options(), OPENCL).module).text,
    "glsl": lambda module: text_for(module, Options(), Limits(doubles=True)),
}
