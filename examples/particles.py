"""Particles that turn by how many others they see on each side; each step sorts them into the cells of a grid.

Source: Schmickl, Stefanec and Crailsheim, "How a life-like system emerges from a simplistic particle motion law", 2016.

python examples/particles.py [numpy|opencl|glsl]
"""

import sys

import numpy as np
from pictures import save

import shpy as sh

CELLS, SIGHT, SIZE = 32, 5.0, 160.0  # a particle sees as far as a cell is wide
COLORS = [(0, 0, 0), (0.1, 0.5, 0.2), (0.1, 0.4, 1), (1, 0.7, 0.1), (1, 0.2, 0.6)]
shades = sh.Table(np.repeat(COLORS, [1, 14, 7, 12, 8], axis=0), sh.Color3f)  # by how many others a particle sees


@sh.struct
class Particle:
    at: sh.Point2f
    angle: sh.Attrib1f


@sh.program
def place(p: Particle, across: sh.Attrib1i) -> sh.Attrib1i:
    """Return the number of the square in which a particle is, of across * across squares."""
    square = sh.min(sh.Attrib2i(p.at / SIZE * sh.Attrib1f(across)), across - 1)
    return square.y * across + square.x


@sh.program
def add(a: sh.Attrib1i, b: sh.Attrib1i) -> sh.Attrib1i:
    return a + b


@sh.program
def move(p: Particle, others: sh.Table[Particle], ends: sh.Table[sh.Attrib1i]) -> tuple[Particle, sh.Attrib1i]:
    """Count who is near in the nine cells around, turn to the side where there are more, and go."""
    heading = sh.Vector2f(sh.cos(p.angle), sh.sin(p.angle))
    cell, near, left = place(p, CELLS), sh.Attrib1i(0), sh.Attrib1i(0)
    for down, right in np.ndindex(3, 3):
        beside = (cell // CELLS + CELLS + down - 1) % CELLS * CELLS + (cell + CELLS + right - 1) % CELLS
        with sh.SH_FOR(sh.cond(beside > 0, ends[beside - 1], 0), ends[beside]) as k:
            away = others[k].at - p.at
            away -= SIZE * sh.round(away / SIZE)  # the world wraps around
            side = heading.x * away.y - heading.y * away.x
            inside = (sh.dot(away, away) < SIGHT * SIGHT) & (side != 0)
            near += sh.Attrib1i(inside)
            left += sh.Attrib1i(inside & (side > 0))
    angle = sh.mod(p.angle + np.radians(180) + np.radians(17) * sh.Attrib1f(near * sh.sign(2 * left - near)), 2 * np.pi)
    return Particle(sh.mod(p.at + 0.67 * sh.Vector2f(sh.cos(angle), sh.sin(angle)), SIZE), angle), near


@sh.program
def glow(crowds: sh.Table[sh.Attrib1i, 2]):
    """Return the light of the pixels around, in the colour of their crowd, as film takes it."""
    near = {(y, x): crowds[sh.grid_index(2) + (y - 5, x - 5)] for y, x in np.ndindex(11, 11)}
    light = sum(shades[crowd] * 2 * np.exp(-((y - 5) ** 2 + (x - 5) ** 2) / 5) for (y, x), crowd in near.items())
    return {"light": 1 - sh.exp(-light)}


def life(count, steps, width, backend=None):
    """Return two streams: the number of neighbours of each particle after some steps, and a picture."""
    rng, cell = np.random.default_rng(7), place.bind(across=CELLS)
    particles = sh.Stream({"at": SIZE * rng.random((count, 2)), "angle": rng.random(count) * 6}, Particle, backend)
    for _ in range(steps):
        particles = sh.sort(particles, key=cell)
        ends = sh.scan(add, sh.histogram(cell(particles), CELLS * CELLS))
        particles, seen = move(particles, sh.Table(particles), sh.Table(ends))
    crowds = sh.scatter(add(seen, 1), place(particles, width), (width, width), combine=add)
    return seen, sh.sequence(glow).run(crowds=crowds, shape=crowds.shape).streams["light"]


if __name__ == "__main__":
    seen, light = life(2600, 2500, 640, *sys.argv[1:])
    print(f"{np.mean(seen.numpy() > 13):.0%} of the particles live in cells after 2500 steps")
    save("particles", light.numpy())
