"""Voronoi cells with borders of even width: the distance to a border is that to the line between two points.

shpy view examples/voronoi.py, or python examples/voronoi.py [numpy|opencl|glsl]
"""

import sys

from pictures import save_program

import shpy as sh
from shpy import SH_FOR, SH_IF
from shpy.library import cellnoise

cells = sh.Param(sh.Attrib1f, 7.0, range=(2, 24), title="Cells", description="How many stand above each other")
width = sh.Param(sh.Attrib1f, 0.05, range=(0, 0.3), title="Width", description="Of the borders, in cells")
rings = sh.Param(sh.Attrib1b, True, title="Rings", description="Lines of equal distance to the border")
border = sh.Param(sh.Color3f, (0.98, 0.72, 0.3), range=(0, 1), title="Borders")


def point_in(cell, time):
    """Return the point of a cell, which moves round about in it."""
    return cell + 0.5 + 0.38 * sh.sin(time + 6.2832 * cellnoise(cell + 0.5, 2))


@sh.program
def voronoi(uv: sh.TexCoord2f, resolution: sh.Attrib2f, time: sh.Attrib1f) -> sh.Color3f:
    at = cells * (uv - 0.5) * sh.vec2(resolution.x / resolution.y, 1) + 40
    home = sh.floor(at)
    nearest, least, owner = sh.Attrib2f(0), sh.Attrib1f(9), sh.Attrib2f(0)
    with SH_FOR(-1, 2) as row, SH_FOR(-1, 2) as column:
        cell = home + sh.vec2(column, row)
        away = point_in(cell, time) - at
        square = sh.dot(away, away)
        with SH_IF(square < least):
            least[:], nearest[:], owner[:] = square, away, cell
    edge = sh.Attrib1f(9)
    with SH_FOR(-2, 3) as row, SH_FOR(-2, 3) as column:
        cell = owner + sh.vec2(column, row)
        away = point_in(cell, time) - at
        between = away - nearest
        with SH_IF(sh.dot(between, between) > 1e-5):  # the point itself has no border with itself
            edge[:] = sh.min(edge, sh.dot(0.5 * (away + nearest), sh.normalize(between)))
    hue = cellnoise(owner + 0.5, 3)
    color = sh.mix(sh.Color3f(0.06, 0.16, 0.3), sh.Color3f(0.16, 0.5, 0.55), hue.x) * (0.65 + 0.5 * hue.y)
    with SH_IF(rings):
        color *= 0.86 + 0.14 * sh.sin(75 * edge)
    color *= 0.55 + 0.9 * sh.saturate(edge)
    pixel = cells / resolution.y
    color[:] = sh.mix(border, color, sh.smoothstep(width - pixel, width + pixel, edge))
    color[:] = sh.mix(border, color, sh.smoothstep(0.05 - pixel, 0.05 + pixel, sh.sqrt(least)))
    return sh.saturate(color)


if __name__ == "__main__":
    save_program(voronoi, (640, 360), *sys.argv[1:])
