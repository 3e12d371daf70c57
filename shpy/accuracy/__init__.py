"""Accuracy: the distance of results from the exact ones, and the time that a larger distance saves.

Stage: measure, above programs and kernels; `import shpy as sh` brings it as `sh.accuracy`.

    sh.accuracy.measure(program, {"x": (1e-3, 1e3, "log")}).table()        # each backend's error, in ULP
    sh.accuracy.roundings(program, domain)                                 # the lines by their share of the error
    sh.accuracy.tradeoff(program, domain, budget=sh.accuracy.ulp(4)).best    # the fastest kernel that keeps 4 ULP
"""

from shpy.accuracy.measuring import measure
from shpy.accuracy.pareto import frontier
from shpy.accuracy.reference import evaluate
from shpy.accuracy.report import Report
from shpy.accuracy.rounding_lines import Roundings, roundings
from shpy.accuracy.tradeoffs import Tradeoff, tradeoff
from shpy.units import Budget, relative, steps, ulp  # first: tests compare with these

__all__ = [
    "Budget",
    "Report",
    "Roundings",
    "Tradeoff",
    "evaluate",
    "frontier",
    "measure",
    "relative",
    "roundings",
    "steps",
    "tradeoff",
    "ulp",
]
