"""Programs as FPCore 2.0, the language of FPBench: texts for Herbie, FPTaylor, Satire and other tools.

Stage: above the passes. Takes a recorded module and gives one FPCore. Its value has the bits of the interpreter
wherever all numbers are finite and all ints within 32 bits:

    (FPCore hypotenuse (x y)
      :name "hypotenuse"
      :precision binary32
      :round nearestEven
      :pre (<= 1 x 2)
      (sqrt (+ (* x x) (* y y))))

FPCore has expressions of numbers alone. So vectors are taken apart, subroutines are inlined, composite operations are
written as their definitions, and a variable is the expression that was stored last. Both sides of a branch become `if`s
of what they store, and so do the statements after a break, continue or return. A loop is a `while` over the variables
that it changes, or a `while*` where their new values share expressions. An operation that FPCore lacks and that rounds
once stands in a context of precision `real`. The standard: https://fpbench.org/spec/fpcore-2.0.html.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shpy.fpcore.builder import FPCoreBuilder
from shpy.ir.nodes import Module
from shpy.passes.inline import inline_calls
from shpy.passes.modes import Precision
from shpy.passes.precision import set_precision


def write_fpcore(module: Module, domain: Mapping[str, Any] | None = None, precision: Precision = "f32") -> str:
    """Return the FPCore of a module; see `Program.fpcore`."""
    return FPCoreBuilder(inline_calls(set_precision(module, precision)), precision).text(domain or {})
