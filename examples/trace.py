"""Looking into a program: the steps of one element, line by line, in the reference interpreter.

Newton's method for a cube root jumps far when it starts near zero. The trace shows where: at the division by x * x.

    python examples/trace.py
"""

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


def jump(steps):
    """The step with the largest value, and how many steps there are."""
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
