"""Histogram equalisation of a picture that stays on the device: a histogram, its sums, and a Table of these.

python examples/equalize.py [numpy|opencl|glsl]
"""

import sys

import numpy as np
from pictures import save

import shpy as sh

BINS, RIDGES = 4096, 9


@sh.subroutine
def cloudy(at: sh.Attrib2f) -> sh.Attrib1f:
    """Noise of seven sizes, about -1 to 1."""
    total, size = sh.Attrib1f(0), sh.Attrib1f(1)
    with sh.SH_FOR(7):
        total += size * sh.noise(at / size)
        size *= 0.5
    return total


@sh.program
def mountains(at: sh.Attrib2f) -> sh.Attrib1f:
    """Return the brightness at (x, y), 0 <= y <= 1, of ridges in fog: a picture of little contrast."""
    light = 0.62 + 0.02 * at.y + 0.01 * cloudy(at * (2, 5))
    with sh.SH_FOR(1, RIDGES + 1) as k:
        near = sh.Attrib1f(k) / RIDGES
        wild = cloudy(sh.Attrib2f(at.x * (5 - 3 * near), 7.3 * sh.Attrib1f(k - 1)))
        below = 0.8 - 0.75 * near**0.8 + (0.05 + 0.2 * near) * wild - at.y
        rock = 0.6 - 0.13 * near**1.5 + 0.014 * near * cloudy(at * (9, 6) + sh.Attrib1f(k - 1))
        hazy = sh.mix(rock, 0.62, sh.smoothstep(0.0, 0.5, below) * (1 - 0.8 * near))
        light[:] = sh.mix(light, hazy, sh.smoothstep(0.0, 0.003, below))
    return light


@sh.program
def add(a: sh.Attrib1i, b: sh.Attrib1i) -> sh.Attrib1i:
    return a + b


@sh.program
def spread(light: sh.Attrib1f, darker: sh.Table[sh.Attrib1i], count: sh.Attrib1f) -> sh.Attrib1f:
    """Return the part of all pixels that are no lighter than this one."""
    return sh.Attrib1f(darker[sh.Attrib1i(BINS * light)]) / count


def equalized(picture):
    """Return a stream of light from 0 to 1 in which every shade is as frequent as any other."""
    counts = sh.histogram(picture, BINS, range=(0, 1))
    return spread(picture, sh.Table(sh.scan(add, counts)), picture.size)


def photograph(width, height, backend=None):
    """Return the mountains as a stream (height, width)."""
    y, x = np.mgrid[height:0:-1, :width] / height
    return mountains(sh.Stream(np.stack([x, y], axis=-1), sh.Attrib2f, backend))


if __name__ == "__main__":
    before = photograph(480, 540, *sys.argv[1:])
    after = equalized(before)
    for name, picture in (("before", before), ("after", after)):
        print(f"{name}: light from {picture.min():.3f} to {picture.max():.3f}, {picture.mean():.3f} on average")
    save("equalize", np.hstack([before, after]))
