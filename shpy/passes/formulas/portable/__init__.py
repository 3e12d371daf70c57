"""The formulas of elementary functions in portable mode, and in strict mode at f64: the same bits on every target.

Stage: improve. `FUNCTIONS["sin"]` writes sine as a formula of operations that are rounded correctly everywhere: no
fused multiply-add, no binary64 for a binary32. `lower` makes functions such as `sin_portable` and `sin_strict_d` from
them, and imports this package when a module first needs one. `formulas/strict` has those of strict mode at f32.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from shpy.passes.formulas.portable import circular, cube_root, error, exponential, logarithm, root
from shpy.passes.formulas.terms import Term

FUNCTIONS: Final[Mapping[str, Callable[..., Term]]] = {
    **{f.__name__: f for f in (circular.sin, circular.cos, circular.tan)},
    **{f.__name__: f for f in (circular.asin, circular.acos, circular.atan, circular.atan2)},
    **{f.__name__: f for f in (exponential.exp, exponential.exp2)},
    **{f.__name__: f for f in (exponential.sinh, exponential.cosh, exponential.tanh)},
    **{f.__name__: f for f in (logarithm.log, logarithm.log2, logarithm.log10)},
    **{f.__name__: f for f in (logarithm.asinh, logarithm.acosh, logarithm.atanh)},
    **{f.__name__: f for f in (exponential.expm1, exponential.exp10, logarithm.log1p, cube_root.cbrt)},
    **{f.__name__: f for f in (error.erf, error.erfc, circular.sinpi, circular.cospi)},
    "pow": logarithm.pow_,
    "rsqrt": exponential.rsqrt,
    "hypot": root.hypot,
}
