"""How far results are from the exact ones, and what that costs or saves."""

from shpy.accuracy.units import Budget, relative, steps, ulp

__all__ = ["Budget", "relative", "steps", "ulp"]
