"""Gravity between two thousand bodies: every element walks through a table of all the others.

python examples/nbody.py [numpy|opencl|glsl]
"""

import sys

import numpy as np
from pictures import save

import shpy as sh
from shpy import SH_FOR

SOFTENING = 0.05  # added to each distance, so that bodies that meet do not fly apart


def simulation(position, velocity, mass, step, backend=None):
    """Return a function that takes one leapfrog step and gives positions and velocities, (n, 3) each."""
    bodies = sh.Table(np.column_stack([position, mass]), sh.Attrib4f)

    @sh.program
    def pull(x: sh.Point3f) -> sh.Vector3f:
        total = sh.Vector3f(0, 0, 0)
        with SH_FOR(len(mass)) as i:
            body = bodies[i]
            away = body.xyz - x
            inverse = sh.rsqrt(sh.dot(away, away) + SOFTENING**2)
            total += body.w * inverse * inverse * inverse * away
        return total

    kernel = pull.compile(backend)
    position, velocity = position.astype(np.float32), velocity.astype(np.float32)

    def advance():
        nonlocal position, velocity
        velocity = velocity + np.float32(step) * kernel(position)
        position = position + np.float32(step) * velocity
        bodies.update(np.column_stack([position, mass]))
        return position, velocity

    return advance


def galaxies(count, seed=1):
    """Two discs of light bodies around heavy ones, on their way past each other: positions, velocities, masses."""
    rng = np.random.default_rng(seed)
    parts = []
    for side, tilt in ((-1, 0.4), (1, -0.7)):
        radius = 0.15 + 0.5 * rng.random(count // 2)
        angle = 2 * np.pi * rng.random(count // 2)
        disc = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
        around = np.stack([-disc[:, 1], disc[:, 0], disc[:, 2]], axis=-1)
        turn = np.array([[1, 0, 0], [0, np.cos(tilt), np.sin(tilt)], [0, -np.sin(tilt), np.cos(tilt)]])
        x, v = radius[:, None] * disc @ turn, around / np.sqrt(radius)[:, None] @ turn
        x[0] = v[0] = 0
        mass = np.where(np.arange(count // 2) == 0, 1, 0.02 / count)
        parts.append((x + (1.1 * side, 0.5 * side, 0), v - (0.7 * side, 0, 0), mass))
    return (np.concatenate(arrays) for arrays in zip(*parts, strict=True))


def picture(position, size=640, reach=1.75):
    """Draw the bodies from above, one disc in blue, the other in gold: (size, size, 3)."""
    glow = np.zeros((size, size, 3))
    for half, color in zip(np.split(position, 2), ((0.5, 0.7, 1.4), (1.4, 0.9, 0.4)), strict=True):
        counts = np.histogram2d(*half[:, 1::-1].T, bins=size, range=((-reach, reach), (-reach, reach)))[0]
        for i, j in np.ndindex(13, 13):  # a bright core and a wide halo
            far = (i - 6) ** 2 + (j - 6) ** 2
            glow += (0.6**far + 0.06 * 0.92**far) * np.roll(counts, (i - 6, j - 6), (0, 1))[..., None] * color
    return 1 - np.exp(-0.9 * glow - (0.02, 0.03, 0.07))


if __name__ == "__main__":
    x, v, m = galaxies(2048)
    before = m @ v
    advance = simulation(x, v, m, 0.02, *sys.argv[1:])
    for _ in range(100):
        x, v = advance()
    print(f"momentum changed by {np.abs(m @ v - before).max():.1e} in all")
    save("nbody", picture(x))
