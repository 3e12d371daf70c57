"""Looking into a program: the steps of one element, line by line, in the reference interpreter.

Newton's method for a cube root jumps far when it starts near zero. The trace shows where: at the division by x * x.
`slow` counts the iterations from each starting point on a line: there a trace takes the index of one element.

    python examples/trace.py
"""

import numpy as np

import shpy as sh
from shpy import SH_BREAK, SH_FOR


@sh.program
def cube_root(a: sh.Attrib1f, start: sh.Attrib1f) -> sh.Attrib1f:
    x = sh.Attrib1f(start)
    with SH_FOR(0, 60):
        slope = 3 * x * x
        change = (x * x * x - a) / slope
        x -= change
        SH_BREAK(abs(change) <= 1e-6 * abs(x))
    return x


@sh.program
def slow(a: sh.Attrib1f) -> sh.Attrib1i:
    """Count the iterations that each start takes; the start is the element's place in the grid."""
    x = sh.Attrib1f(sh.grid_index(1) + 1) / sh.Attrib1f(sh.grid_shape(1))
    count = sh.Attrib1i(0)
    with SH_FOR(0, 60):
        change = (x * x * x - a) / (3 * x * x)
        x -= change
        count += 1
        SH_BREAK(abs(change) <= 1e-6 * abs(x))
    return count


def jump(steps):
    """Return the step with the largest value, and the number of steps."""
    return max(steps, key=lambda step: abs(float(step.value))), len(steps)


if __name__ == "__main__":
    for start in (1.0, 0.01):
        steps = cube_root.trace(a=2.0, start=start)
        largest, count = jump(steps)
        print(f"from {start}: {count} steps, cube root of 2 = {steps[-1].value}, the largest value on the way:")
        print(f"  {largest}")
    print("\nthe first iterations from 1.0:")
    for step in cube_root.trace(a=2.0, start=1.0)[:8]:
        print(f"  {step}")
    iterations = slow.compile("numpy")(2.0, shape=1000)
    worst = int(np.argmax(iterations))
    print(f"\nof 1000 starts, element {worst} takes the most iterations, {iterations[worst]}. Its last ones:")
    for step in slow.trace(a=2.0, shape=1000, at=worst)[-7:-1]:
        print(f"  {step}")
