"""Programs over streams: one that discards elements, and one that reads its neighbours."""

import shpy as sh


@sh.program
def kept(x: sh.Attrib1f) -> sh.Attrib1f:
    sh.SH_DISCARD(x <= 0)
    return x * x - 1


@sh.program
def smooth(u: sh.Table[sh.Attrib1f]) -> sh.Attrib1f:
    i = sh.grid_index(1)
    return 0.25 * u[i - 1] + 0.5 * u[i] + 0.25 * u[i + 1]
