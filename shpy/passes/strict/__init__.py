"""The functions that strict mode expands, so that they give the same bits on every target.

Stage: improve. `FUNCTIONS["sin"]` writes sine as a formula of operations that are rounded correctly everywhere: no
fused multiply-add, no binary64 for a binary32. `lower` makes functions such as `sin_strict` from these formulas. It
imports this package when a module first needs one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from shpy.passes.strict import circular, exponential, logarithm, root
from shpy.passes.terms import Term

FUNCTIONS: Final[Mapping[str, Callable[..., Term]]] = {
    **{f.__name__: f for f in (circular.sin, circular.cos, circular.tan)},
    **{f.__name__: f for f in (circular.asin, circular.acos, circular.atan, circular.atan2)},
    **{f.__name__: f for f in (exponential.exp, exponential.exp2)},
    **{f.__name__: f for f in (exponential.sinh, exponential.cosh, exponential.tanh)},
    **{f.__name__: f for f in (logarithm.log, logarithm.log2, logarithm.log10)},
    **{f.__name__: f for f in (logarithm.asinh, logarithm.acosh, logarithm.atanh)},
    "pow": logarithm.pow_,
    "rsqrt": exponential.rsqrt,
    "hypot": root.hypot,
}
