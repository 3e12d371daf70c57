"""Collective operations over the elements of streams: the order of evaluation is part of their definition.

Stage: run, above programs. Strict kernels give the same bits on every backend, device and lane width.
"""

from shpy.collectives.choosing import top_k, unique
from shpy.collectives.compaction import compact
from shpy.collectives.expansion import expand
from shpy.collectives.histograms import histogram
from shpy.collectives.reducing import reduce
from shpy.collectives.scanning import scan
from shpy.collectives.scattering import gather, scatter
from shpy.collectives.sorting import argsort, sort

__all__ = [
    "argsort",
    "compact",
    "expand",
    "gather",
    "histogram",
    "reduce",
    "scan",
    "scatter",
    "sort",
    "top_k",
    "unique",
]
