"""shpy: write a kernel once in Python, run it as GLSL, OpenCL or numpy.

>>> import shpy as sh
>>> @sh.program
... def double(x: sh.Attrib1f) -> sh.Attrib1f:
...     return 2 * x
>>> double([1, 2, 3])
array([2., 4., 6.], dtype=float32)
"""

import shpy_start  # noqa: F401  # first: it makes Ctrl-C quiet while `python -m shpy` imports the rest

# isort: split

import importlib
from typing import Any

from shpy.backends.registry import BackendInfo, backends, default_backend
from shpy.chains.chain import Chain, loop, repeat, sequence
from shpy.chains.running import ChainResult
from shpy.choice import choice
from shpy.collectives import argsort, compact, gather, histogram, reduce, scan, scatter, sort
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
from shpy.lang.data.array import Array
from shpy.lang.data.params import Param
from shpy.lang.data.tables import Table
from shpy.lang.data.textures import Texture2D
from shpy.lang.library import hash as hash, noise, unit_float
from shpy.lang.mistakes.foreign import module_cure
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
from shpy.lang.programs.subroutine import subroutine
from shpy.lang.recording.location import here
from shpy.lang.values.builtins import (
    abs as abs,
    acos,
    acosh,
    all as all,
    all_lanes,
    any as any,
    any_lane,
    asin,
    asinh,
    atan,
    atan2,
    atanh,
    bits_from_float,
    ceil,
    clamp,
    cond,
    cos,
    cosh,
    cross,
    degrees,
    distance,
    dot,
    exp,
    exp2,
    faceforward,
    float_from_bits,
    floatBitsToUint,
    floor,
    fma,
    fract,
    grid_index,
    grid_shape,
    inversesqrt,
    isinf,
    isnan,
    ldexp,
    length,
    log,
    log2,
    log10,
    mad,
    max as max,
    min as min,
    mix,
    mod,
    normalize,
    popcount,
    pow as pow,
    radians,
    reflect,
    refract,
    round as round,
    rsqrt,
    saturate,
    sign,
    sin,
    sinh,
    smoothstep,
    sqrt,
    step,
    tan,
    tanh,
    trunc,
    uintBitsToFloat,
)
from shpy.lang.values.derivatives import dFdx, dFdy
from shpy.lang.values.matrix import Matrix2f, Matrix3f, Matrix4f, determinant, inverse, transpose
from shpy.lang.values.structure import struct, swap
from shpy.lang.values.types import TYPES
from shpy.program import Program, parse, program
from shpy.run.kernel import Kernel, Result
from shpy.streams.stream import Stream
from shpy.tracing import Step

# Names of Python's builtins (abs, min, round, …) stay out, so that `from shpy import *` shadows none.
_LATER = ("accuracy", "command", "files", "library", "packages", "testing")

__all__ = [
    *TYPES,
    "SH_BREAK",
    "SH_CONTINUE",
    "SH_DISCARD",
    "SH_DO",
    "SH_ELIF",
    "SH_ELSE",
    "SH_FOR",
    "SH_IF",
    "SH_RETURN",
    "SH_UNTIL",
    "SH_WHILE",
    "Array",
    "BackendInfo",
    "BackendUnavailable",
    "Chain",
    "ChainResult",
    "CompileError",
    "Kernel",
    "LoopLimitExceeded",
    "Matrix2f",
    "Matrix3f",
    "Matrix4f",
    "Param",
    "ParseError",
    "Program",
    "RecordError",
    "Result",
    "ShpyAttributeError",
    "ShpyError",
    "ShpyIndexError",
    "ShpyTypeError",
    "ShpyWarning",
    "Step",
    "Stream",
    "Table",
    "Texture2D",
    "VerifyError",
    "acos",
    "acosh",
    "all_lanes",
    "any_lane",
    "argsort",
    "asin",
    "asinh",
    "atan",
    "atan2",
    "atanh",
    "backends",
    "bits_from_float",
    "ceil",
    "choice",
    "clamp",
    "compact",
    "cond",
    "cos",
    "cosh",
    "cross",
    "dFdx",
    "dFdy",
    "default_backend",
    "degrees",
    "determinant",
    "distance",
    "dot",
    "exp",
    "exp2",
    "faceforward",
    "floatBitsToUint",
    "float_from_bits",
    "floor",
    "fma",
    "fract",
    "gather",
    "grid_index",
    "grid_shape",
    "histogram",
    "inverse",
    "inversesqrt",
    "isinf",
    "isnan",
    "ldexp",
    "length",
    "log",
    "log2",
    "log10",
    "loop",
    "mad",
    "mix",
    "mod",
    "noise",
    "normalize",
    "parse",
    "popcount",
    "program",
    "radians",
    "reduce",
    "reflect",
    "refract",
    "repeat",
    "rsqrt",
    "saturate",
    "scan",
    "scatter",
    "sequence",
    "sign",
    "sin",
    "sinh",
    "smoothstep",
    "sort",
    "sqrt",
    "step",
    "struct",
    "subroutine",
    "swap",
    "tan",
    "tanh",
    "transpose",
    "trunc",
    "uintBitsToFloat",
    "unit_float",
]

globals().update(TYPES)


def __getattr__(name: str) -> Any:
    """Load `sh.testing`, `sh.accuracy`, `sh.files`, `sh.command`, `sh.library` and `sh.packages` on first use."""
    if name in _LATER:
        return importlib.import_module(f"shpy.{name}")
    if name.startswith("_"):
        raise AttributeError(f"module 'shpy' has no attribute {name!r}")
    raise ShpyAttributeError(f"shpy has no {name!r}", loc=here(), cure=module_cure(name, __all__))
