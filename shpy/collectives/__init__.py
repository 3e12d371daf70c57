"""Collective operations over the elements of streams: the order of evaluation is part of their definition.

Stage: run, above programs. Strict kernels give the same bits on every backend, device and lane width.
"""

from shpy.collectives.reducing import reduce
from shpy.collectives.scanning import scan

__all__ = ["reduce", "scan"]
