"""Kernels, chains and collective operations over Dask arrays, with the bits of one process for any chunks.

Stage: cluster, above programs. Dask schedules, moves and repeats; it is imported on first use.

    y = sh.map_blocks(kernel, x)                           # x: a Dask array
    fields = sh.map_overlap(step, {"u": u}, steps=8)       # u: a Dask array, read at neighbouring indices, too

`arrays` checks what is given, `jobs` is what workers run, `graphs` puts the two together.
"""

from shpy.cluster.blocks import map_blocks
from shpy.cluster.overlap import map_overlap

__all__ = ["map_blocks", "map_overlap"]
