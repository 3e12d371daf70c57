"""Arithmetic as IEEE 754 defines it, whatever another library has switched on in this thread.

Stage: record, compile, run. Some libraries make the processor flush denormal numbers to zero: Taichi when it starts,
and libraries built with -ffast-math when they are loaded. This holds in their thread, and in the threads that it starts
later. Then numpy's arithmetic is no longer that of strict mode. shpy sets the default environment of C while it
computes, and restores the thread's environment afterwards.

    with ieee_arithmetic():
        np.float32(1e-30) * np.float32(1e-10)     # 1e-40
"""

from __future__ import annotations

import ctypes
import functools
import sys
import threading
from collections.abc import Callable
from functools import cache
from typing import Any, Final, ParamSpec, TypeVar

import numpy as np

from shpy.errors import warn

P = ParamSpec("P")
T = TypeVar("T")

_DENORMAL: Final = np.uint64(1000).view(np.float64).item()
"""A number of Python's, since a product of two of numpy's takes 0.15 µs: a processor flushes those of both sizes."""
_HALF: Final = 0.5
_DEFAULT: Final = ctypes.c_void_p(-1)
"""FE_DFL_ENV on Linux. On other systems it is an address or a structure that only their headers define."""
_ROOM: Final = 256
"""Bytes for an fenv_t, more than on any system."""
_seen: Final = threading.Event()
"""Set once a thread flushed denormals when shpy computed in it."""


def keeps_denormals() -> bool:
    """Return whether this thread's arithmetic keeps denormals: it computes an exact product, which raises no flag."""
    return bool(_DENORMAL * _HALF)


class ieee_arithmetic:
    """A context in which the arithmetic of this thread keeps denormal numbers."""

    __slots__ = ("_before",)

    def __enter__(self) -> None:
        """Set the default environment where denormals are taken for zero."""
        self._before = None if _DENORMAL * _HALF else _set_default()

    def __exit__(self, *_: object) -> None:
        """Restore the environment that the thread had before."""
        if self._before is not None:
            _library().fesetenv(self._before)


def set_ieee_arithmetic() -> None:
    """Make the arithmetic of this thread keep denormal numbers from now on."""
    if not keeps_denormals():
        _set_default()


def was_flushing() -> bool:
    """Return whether a thread of this process flushed denormals when shpy computed in it."""
    return _seen.is_set()


def in_ieee_arithmetic(function: Callable[P, T]) -> Callable[P, T]:
    """Decorate a function that computes: it runs in `ieee_arithmetic`."""

    @functools.wraps(function)
    def run(*args: P.args, **named: P.kwargs) -> T:
        if _DENORMAL * _HALF:
            return function(*args, **named)
        with ieee_arithmetic():
            return function(*args, **named)

    return run


@cache
def _library() -> Any:
    """Return the C library, or None. Its calls keep the interpreter's lock: releasing it takes longer than a call."""
    if sys.platform != "linux":
        return None
    try:
        library = ctypes.PyDLL(None)
        library.fegetenv.argtypes = library.fesetenv.argtypes = [ctypes.c_void_p]
    except (OSError, AttributeError, TypeError):
        return None
    return library


def _set_default() -> Any:
    """Set C's default floating-point environment and return the previous one; warn and return None if that fails."""
    _seen.set()
    library = _library()
    if library is not None:
        before = ctypes.create_string_buffer(_ROOM)
        library.fegetenv(before)
        library.fesetenv(_DEFAULT)
        if keeps_denormals():
            return before
        library.fesetenv(before)
    _warn()
    return None


@cache
def _warn() -> None:
    warn(
        "another library makes this thread's arithmetic take denormal numbers for zero, which shpy cannot undo here: "
        "strict results may differ below 1.18e-38. Import that library after shpy, or use it in another process"
    )
