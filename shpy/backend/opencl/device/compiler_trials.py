"""Functions that a compiler may offer besides OpenCL C, and the private memory of a work group: see `trial`.

Stage: compile. PoCL lays the local arrays of all work items of a group on the stack of the thread that runs it. Nothing
checks them against its end, so a kernel with more ends the process by SIGSEGV. The size of the stack is that of every
new thread of the process: 8 MB where `ulimit -s` says so, 2 MB where it says "unlimited", 512 kB on macOS, 128 kB with
musl. A driver may choose another one, so trials of `SIZES` are run in another process, too.

    limit = most_private(tried=6 << 20, stack=thread_stack())
"""

from __future__ import annotations

import ctypes
import math
import threading
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from shpy.backend.opencl.device.declarations import GUARD, declarations
from shpy.backend.opencl.device.trial import DECLARES, Trial, outcomes
from shpy.backend.opencl.packets.prologue import GUESSES, SIGNS, TRUNCATIONS
from shpy.backend.opencl.packets.prologue_wide import try_wide
from shpy.backend.opencl.packets.widen import WIDER
from shpy.backend.opencl.text.operations import ELEMENTWISE

SIZES: Final = tuple(96 << 10 << 2 * k for k in range(4))
"""Bytes of private memory that are tried: three quarters of 128 kB, 512 kB, 2 MB and 8 MB."""
_LEAST: Final = 16 << 10
"""Bytes that every thread has: the smallest stack that POSIX allows a system to give is as large."""
_STRIDE: Final = 256
"""Ints between two places that a trial touches: less than a page, so that every page is."""


def trial_of(size: int) -> Trial:
    """Return the trial that succeeds where a work item may have an array of this many bytes."""
    length = size // 4
    up, down = f"int i = 0; i < {length}; i += {_STRIDE}", f"int i = {length - _STRIDE}; i >= 0; i -= {_STRIDE}"
    stored, loaded = (f"big[i + (a[{k}] & {_STRIDE - 1})]" for k in (1, 2))
    loops = f"for ({up}) {{ {stored} = i + n; }} for ({down}) {{ s ^= {loaded}; }}"
    statements = f"int big[{length}], n = a[0], s = 0; {loops} a[0] = s;"
    expected = 0
    for i in range(0, length, _STRIDE):
        expected ^= i + 5
    return Trial("int", statements, (5, 3, 3), (expected, 3, 3))


def name_of(size: int) -> str:
    """Return the name of the trial of a size."""
    return f"private{size}"


def thread_stack() -> int | None:
    """Return the bytes of the stack that the C library gives to a new thread; None where it does not tell them."""
    try:
        library = ctypes.CDLL(None)
        attributes, size = ctypes.create_string_buffer(1024), ctypes.c_size_t()
        if library.pthread_attr_init(attributes) or library.pthread_attr_getstacksize(attributes, ctypes.byref(size)):
            return None
        library.pthread_attr_destroy(attributes)
    except (AttributeError, OSError, TypeError):  # Windows has no such functions
        return None
    # A driver may run kernels in the thread that waits for them, which is one of Python's.
    return min(size.value, threading.stack_size() or size.value)


def most_private(tried: int, stack: int | None) -> int:
    """Return the most bytes of local arrays of a work group; `tried`: those that a trial had.

    The rest of the stack is for all else that a kernel holds there, whose size only its compiler knows.
    """
    sizes = [n for n in (tried // 2, None if stack is None else stack * 3 // 8) if n]
    return max(min(sizes, default=0), _LEAST)


_X86: Final = {4: "__SSE__", 8: "__AVX__", 16: "__AVX512DQ__"}
"""The macros of compilers for processors with vectors of as many numbers of 32 bits."""
_ROUNDED = (1.5, -0.5, 2.0, 2.5, -3.0, 0.0, 7.75, 1e9)
_CALLS: Final = (
    "float8 x = vload8(get_global_id(0), (__global float *)a); int8 i = clamp(convert_int8_sat(x), 0, 3); "
    "vstore8(fma(floor(sqrt(x)), x, convert_float8(as_int8(as_uint8(max(i, 1))))), 0, (__global float *)a);"
)
_TRIALS: Final = {
    DECLARES: Trial(
        "float8",
        _CALLS,
        tuple(k + 0.5 for k in range(8)),
        tuple(math.floor(math.sqrt(k + 0.5)) * (k + 0.5) + min(max(k, 1), 3) for k in range(8)),
    ),
    "reduce": Trial("int8", "a[0].x = __builtin_reduce_or(a[0]);", (1, 2, 4, 8, 16, 32, 64, 0), (127, 2, 4)),
    "elementwise": Trial(
        "float8",
        f"float8 x = a[0]; a[0] = {' + '.join(f'__builtin_elementwise_{name}(x)' for name in ELEMENTWISE.values())};",
        _ROUNDED,
        tuple(math.floor(x) + math.ceil(x) + math.trunc(x) + round(x) for x in _ROUNDED),
    ),
    "shuffle": Trial(
        "int8",
        "a[0] = __builtin_shufflevector(a[0], a[1], 0, 8, 1, 9, 2, 10, 3, 11);",
        tuple(range(16)),
        (0, 8, 1, 9, 2, 10, 3, 11),
    ),
    **{
        f"signs{n}": Trial(
            f"int{n}", f"int{n} mask = a[0]; a[0].x = {text};", (0, -1, *[0] * (n - 2)), (2, -1), needs=_X86[n]
        )
        for n, text in SIGNS.items()
    },
    **{
        f"guess{n}": Trial(
            f"float{n}", f"a[0] = floor({text.format('a[0]')} + 0.5f);", (0.0625,) * n, (4.0,) * n, needs=_X86[n]
        )
        for n, text in GUESSES.items()
    },
    **{
        f"truncation{n}": Trial(
            f"int{n}",
            f"float{n} x = as_float{n}(a[0]); a[0] = {text.format('x')};",
            (0x40300000, -0x3FD00000, 0x7FC00000, 0x4F000000, *[0] * (n - 4)),  # 2.75, -2.75, NaN, 2**31
            (2, -2, -(2**31), -(2**31), *[0] * (n - 4)),
            needs=_X86[n],
        )
        for n, text in TRUNCATIONS.items()
    },
    **{
        f"wide{n}": Trial(
            "float16", try_wide(n), tuple(range(16)), tuple(float(k + k % 2 * k) for k in range(15, -1, -1))
        )
        for n in WIDER
    },
}


def _declared(trials: dict[str, Trial]) -> dict[str, Trial]:
    return {name: replace(t, declarations=declarations(t.statements), option=GUARD) for name, t in trials.items()}


TRIALS: Final = _declared(_TRIALS)
"""Functions that a compiler may have besides OpenCL C; DECLARES comes first, for it makes the others faster."""
MEMORY: Final = _declared({name_of(size): trial_of(size) for size in reversed(SIZES)})
"""Trials of private memory, the largest first: a smaller one succeeds where it does."""


def outcomes_here(cl: Any, context: Any, options: list[str], trials: Mapping[str, Trial]) -> frozenset[str] | None:
    """Run trials in this process, with functions declared; None where the driver refuses their kernel."""
    calls = declarations(" ".join(trial.statements for trial in trials.values()))
    return outcomes(cl, context, [*options, GUARD], trials, calls)
