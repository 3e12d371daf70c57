"""shpy: write a kernel once in Python, run it as GLSL, OpenCL or numpy.

>>> import shpy as sh
>>> @sh.program
... def double(x: sh.Attrib1f) -> sh.Attrib1f:
...     return 2 * x
>>> double([1, 2, 3])
array([2., 4., 6.], dtype=float32)
"""

import shpy_start  # first: it makes Ctrl-C quiet while `python -m shpy` imports the rest

# isort: split

import builtins as _builtins
import importlib
from typing import Any

from shpy.backend.registry import BackendInfo, backends, default_backend
from shpy.errors import (
    BackendUnavailable,
    CompileError,
    LoopLimitExceeded,
    ParseError,
    RecordError,
    ShpyAttributeError,
    ShpyError,
    ShpyIndexError,
    ShpyTypeError,
    ShpyWarning,
    VerifyError,
)
from shpy.lang.data.params import Param
from shpy.lang.data.tables import Table
from shpy.lang.data.textures import Texture2D
from shpy.lang.functions.array import Array
from shpy.lang.functions.subroutine import subroutine
from shpy.lang.library import hash, noise
from shpy.lang.mistakes.foreign import module_cure as _module_cure
from shpy.lang.programs.control import (
    SH_BREAK,
    SH_CONTINUE,
    SH_DISCARD,
    SH_DO,
    SH_ELIF,
    SH_ELSE,
    SH_FOR,
    SH_IF,
    SH_RETURN,
    SH_UNTIL,
    SH_WHILE,
)
from shpy.lang.recording.location import here as _here
from shpy.lang.recording.recorder import is_recording
from shpy.lang.values.builtins import FUNCTIONS
from shpy.lang.values.derivatives import dFdx, dFdy
from shpy.lang.values.matrix import Matrix2f, Matrix3f, Matrix4f, determinant, inverse, transpose
from shpy.lang.values.structs import struct
from shpy.lang.values.structure import swap
from shpy.lang.values.types import TYPES
from shpy.programs import Program, parse, program
from shpy.run.kernel import Kernel
from shpy.run.result import Result
from shpy.streams.stream import Stream
from shpy.tracing import Step

globals().update(TYPES | FUNCTIONS)

# The modules and the names that `__getattr__` loads on first use, each name with its module: most programs use few.
_MODULES = {
    **{name: name for name in ("accuracy", "command", "files", "library", "packages", "testing", "view")},
    "outputs": "pictures.outputs",
    "screen": "display.screen",
    "videos": "pictures.videos",
}
_LATER = {
    **dict.fromkeys(("Chain", "loop", "repeat", "sequence"), "chains.chain"),
    **dict.fromkeys(
        "argsort compact expand gather histogram reduce scan scatter sort top_k unique".split(), "collectives"
    ),
    **dict.fromkeys(("map_blocks", "map_overlap"), "cluster"),
    **dict.fromkeys(("gradient", "jacobian", "jvp"), "gradients.functions"),
    "value_and_gradient": "fitting",
    "ChainResult": "chains.running",
    "animate": "pictures.animation",
    "choice": "choices",
    "share": "chains.share",
    "widget": "notebook.live",
}
_WITH_MORE_PACKAGES = {"widget"}
"""Names that `from shpy import *` leaves out: their packages may be missing."""

# Names of Python's builtins (abs, min, round, …) stay out, so that `from shpy import *` shadows none.
__all__ = sorted(
    [*(_LATER.keys() - _WITH_MORE_PACKAGES)]
    + [
        name
        for name, thing in globals().items()
        if str(getattr(thing, "__module__", "")).startswith("shpy.")
        and not (name[0] == "_" or hasattr(_builtins, name))
    ]
)


def __dir__() -> list[str]:
    """List what is loaded on first use, too."""
    return sorted({*globals(), *_LATER, *_MODULES})


def __getattr__(name: str) -> Any:
    """Load `sh.testing`, `sh.animate` and the like on first use."""
    if name in _MODULES:
        return importlib.import_module(f"shpy.{_MODULES[name]}")
    if name in _LATER:
        value = globals()[name] = getattr(importlib.import_module(f"shpy.{_LATER[name]}"), name)
        return value
    if name == "__version__":
        from shpy.packages import DISTRIBUTION, installed  # here: importing shpy asks for no package

        return installed(DISTRIBUTION) or "0+unknown"  # a folder of sources alone says no version
    if name.startswith("_"):
        raise AttributeError(f"module 'shpy' has no attribute {name!r}")
    raise ShpyAttributeError(f"shpy has no {name!r}", loc=_here(), cure=_module_cure(name, __all__))
