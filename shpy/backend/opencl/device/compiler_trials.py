"""Functions that a compiler may offer besides OpenCL C, and the small programs that try them: see `trial`.

Stage: run.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from shpy.backend.opencl.device.declarations import GUARD, declarations
from shpy.backend.opencl.device.stack import SIZES, name_of, trial_of
from shpy.backend.opencl.device.trial import DECLARES, Trial
from shpy.backend.opencl.packets.prologue import GUESSES, SIGNS
from shpy.backend.opencl.packets.prologue_wide import try_wide
from shpy.backend.opencl.packets.widen import WIDER, WIDTHS
from shpy.backend.opencl.text.operations import ELEMENTWISE

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
        f"signs{n}": Trial(f"int{n}", f"int{n} mask = a[0]; a[0].x = {text};", (0, -1, *[0] * (n - 2)), (2, -1))
        for n, text in SIGNS.items()
    },
    **{
        f"guess{n}": Trial(f"float{n}", f"a[0] = floor({text.format('a[0]')} + 0.5f);", (0.0625,) * n, (4.0,) * n)
        for n, text in GUESSES.items()
    },
    **{
        f"floats{n}": Trial(
            f"float{n}",
            f"float{n} x = a[0]; a[0] = fma(floor(sqrt(x)), x, convert_float{n}(clamp(convert_int{n}_sat(x), 0, 3)));",
            tuple(k + 0.5 for k in range(n)),
            tuple(math.floor(math.sqrt(k + 0.5)) * (k + 0.5) + min(k, 3) for k in range(n)),
        )
        for n in WIDTHS
    },
    **{
        f"wide{n}": Trial(
            "float16", try_wide(n), tuple(range(16)), tuple(float(k + k % 2 * k) for k in range(15, -1, -1))
        )
        for n in WIDER
    },
    **{name_of(size): trial_of(size) for size in SIZES},
}
TRIALS: Final = {
    name: replace(trial, declarations=declarations(trial.statements), option=GUARD) for name, trial in _TRIALS.items()
}
"""Functions that a compiler may have besides OpenCL C; DECLARES comes first, for it makes the others faster."""
