"""Domain warping: noise read at a place that noise has moved, which noise has moved.

shpy view examples/warp.py, or python examples/warp.py [numpy|opencl|glsl]
"""

import sys

from pictures import save_program

import shpy as sh
from shpy.library import fbm

scale = sh.Param(sh.Attrib1f, 1.6, range=(0.5, 8), title="Scale", description="Waves in the height of the picture")
strength = sh.Param(sh.Attrib1f, 2.2, range=(0, 6), title="Strength", description="How far noise moves a place")
octaves = sh.Param(sh.Attrib1i, 5, range=(1, 8), step=1, title="Octaves")
deep = sh.Param(sh.Color3f, (0.05, 0.09, 0.2), range=(0, 1), title="Deep")
warm = sh.Param(sh.Color3f, (0.92, 0.55, 0.25), range=(0, 1), title="Warm")


def moved(p, by, time):
    """Return two noises at p, which `by` keeps apart."""
    drift = 0.05 * time
    return sh.vec2(fbm(p + sh.vec2(by, drift), octaves), fbm(p + sh.vec2(5.2 - drift, 1.3 + by), octaves))


@sh.program
def warp(uv: sh.TexCoord2f, resolution: sh.Attrib2f, time: sh.Attrib1f) -> sh.Color3f:
    p = scale * (uv - 0.5) * sh.vec2(resolution.x / resolution.y, 1) + 17.3
    first = moved(p, 0.0, time)
    second = moved(p + strength * first, 8.3, time)
    height = fbm(p + strength * second, octaves)
    color = sh.mix(deep, warm, sh.smoothstep(-0.45, 0.6, height))
    color[:] = sh.mix(color, sh.Color3f(0.96, 0.93, 0.84), sh.smoothstep(0.05, 0.75, sh.length(second)) * 0.75)
    color[:] = sh.mix(color, sh.Color3f(0.1, 0.32, 0.38), sh.smoothstep(0.1, 0.6, abs(first.y)))
    shade = 0.75 + 1.1 * height + 0.35 * first.x
    return sh.saturate(color * sh.clamp(shade, 0.25, 1.3))


if __name__ == "__main__":
    save_program(warp, (640, 360), *sys.argv[1:])
