"""The correctly rounded binary32 of each function, for as many numbers as there are.

glibc's binary64 functions decide nearly all; the few hundred that are left go to MPFR (see rounding.c). gcc builds both
into a library, kept beside this file's other products in the user's cache, so that it is built once.

    rounded("exp", np.float32([1, 2]))      # array([2.7182817, 7.389056 ], dtype=float32)
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["FUNCTIONS", "PAIRS", "OracleError", "everything", "hard", "rounded", "rounded_pairs"]

Floats = NDArray[np.float32]

FUNCTIONS: Final = (
    "exp", "exp2", "log", "log2", "log10", "sin", "cos", "tan", "asin", "acos", "atan",
    "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "rsqrt",
    "expm1", "log1p", "cbrt", "erf", "erfc", "exp10", "sinpi", "cospi",
)  # fmt: skip
"""The oracle's functions of one argument."""
PAIRS: Final = ("pow", "atan2", "hypot")
"""Its functions of two arguments."""
CHUNK: Final = 1 << 22
"""The largest number of elements of a call."""
_HERE: Final = Path(__file__).parent
_CPU: Final = Path("/proc/cpuinfo")
_FAST: Final = ("-O3", "-march=native", "-fPIC")
_STEPS: Final = (
    (*_FAST, "-ffast-math", "-c", "values.c"),  # links nothing: -ffast-math there would flush the process's denormals
    (*_FAST, "-ffp-contract=off", "-c", "rounding.c"),
)


class OracleError(Exception):
    """A tool that is missing, with the command that installs it."""


def rounded(name: str, x: Floats) -> Floats:
    """Return the exact values of a function, rounded half to even."""
    x = np.ascontiguousarray(x, np.float32)
    result = np.empty_like(x)
    _known(name, _library().correctly_rounded(name.encode(), x.size, _at(x), _at(result)))
    return result


def rounded_pairs(name: str, a: Floats, b: Floats) -> Floats:
    """Return the exact values of a function of two arguments, rounded half to even."""
    a, b = (np.ascontiguousarray(v, np.float32) for v in (a, b))
    if a.shape != b.shape:
        raise ValueError(f"{name}: the arguments have the shapes {a.shape} and {b.shape}, which have to be equal")
    result = np.empty_like(a)
    _known(name, _library().correctly_rounded_pairs(name.encode(), a.size, _at(a), _at(b), _at(result)))
    return result


def hard(name: str, x: Floats, margin: float) -> Floats:
    """Return the x whose exact result lies within a relative margin of a midpoint between two binary32 numbers."""
    x = np.ascontiguousarray(x, np.float32)
    places = np.empty(x.size, np.int64)
    count = _library().hard(name.encode(), x.size, _at(x), ctypes.c_double(margin), x.size, _at(places))
    found: Floats = x[places[: _known(name, count)]]
    return found


def everything(first: int = 0, last: int = 1 << 32, stride: int = 1) -> Any:
    """Yield all binary32 numbers in chunks, by their bits: from one pattern up to another, or every stride-th."""
    for start in range(first, last, CHUNK * stride):
        bits = np.arange(start, min(start + CHUNK * stride, last), stride, dtype=np.int64)
        yield bits.astype(np.uint32).view(np.float32)


def _known(name: str, count: int) -> int:
    if count < 0:
        raise OracleError(f"there is no function {name}: it is one of {', '.join(FUNCTIONS + PAIRS)}")
    return count


def _at(array: NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


@functools.cache
def _library() -> Any:
    """Return the C library; build it if there is none of this source for this processor."""
    text = b"".join((_HERE / name).read_bytes() for name in ("values.c", "rounding.c")) + repr(_STEPS).encode()
    text += next((line for line in _CPU.read_bytes().splitlines() if line.startswith(b"flags")), b"")
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "shpy"
    path = folder / f"oracle-{os.uname().machine}-{hashlib.sha256(text).hexdigest()[:16]}.so"
    if not path.exists():
        _build(path)
    library = ctypes.CDLL(str(path))
    for function in (library.correctly_rounded, library.correctly_rounded_pairs, library.hard):
        function.restype = ctypes.c_long
    library.correctly_rounded.argtypes = [ctypes.c_char_p, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
    library.correctly_rounded_pairs.argtypes = [*library.correctly_rounded.argtypes, ctypes.c_void_p]
    library.hard.argtypes = [*library.correctly_rounded.argtypes[:3], ctypes.c_double, ctypes.c_long, ctypes.c_void_p]
    return library


def _build(path: Path) -> None:
    """Compile in a folder of its own, and move the result into its place at once."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        for options in _STEPS:
            _run("gcc", *options[:-1], str(_HERE / options[-1]), folder=folder)
        _run("gcc", "-shared", "-o", "oracle.so", "values.o", "rounding.o", "-lmpfr", "-lgmp", "-lm", folder=folder)
        os.replace(Path(folder) / "oracle.so", path)


def _run(*command: str, folder: str) -> None:
    cure = "it needs gcc and MPFR; on Debian: apt-get install gcc libc6-dev libmpfr-dev"
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    except FileNotFoundError:
        raise OracleError(f"there is no gcc: {cure}") from None
    if done.returncode:
        error = next((line for line in done.stderr.splitlines() if "error" in line or "cannot" in line), done.stderr)
        raise OracleError(f"the oracle could not be built: {error}; {cure}")
