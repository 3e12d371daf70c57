"""Newton's basins: which root of z^n - 1 Newton's method reaches from each place, with the Jacobian of any function.

shpy view examples/newton.py, or python examples/newton.py [numpy|opencl|glsl]
"""

import sys

from pictures import save_program

import shpy as sh
from shpy import SH_BREAK, SH_FOR

ROOTS = 3
relaxation = sh.Param(sh.Attrib1f, 1.0, range=(0.3, 1.7), title="Step", description="The part of a step that is taken")


def f(z):
    """Return z^ROOTS - 1 of a complex number."""
    w = z
    for _ in range(ROOTS - 1):
        w = sh.vec2(w.x * z.x - w.y * z.y, w.x * z.y + w.y * z.x)
    return w - sh.vec2(1, 0)


@sh.program
def newton(uv: sh.TexCoord2f, resolution: sh.Attrib2f) -> sh.Color3f:
    z = sh.vec2(*((uv - 0.5) * sh.vec2(resolution.x, -resolution.y) * (3 / resolution.y)))
    count = sh.Attrib1f(0)
    with SH_FOR(0, 60):
        step = sh.inverse(sh.jacobian(f)(z)) @ f(z)
        z -= relaxation * step
        SH_BREAK(sh.dot(step, step) < 1e-8)
        count += 1
    turn = sh.atan(z.y, z.x) + sh.vec3(0, 2.1, 4.2)
    return (0.55 + 0.4 * sh.cos(turn)) * sh.exp(-0.06 * count)


if __name__ == "__main__":
    save_program(newton, (640, 360), *sys.argv[1:])
