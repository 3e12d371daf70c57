import numpy as np


def arithmetic(a, b, v, lanes):
    quadratic = (a * a + 2.0 * a * b - b * b) / (1.0 - a * b)  # snapshot_programs.py:23
    scaled = -v * (a - (b - 1.0)) + 0.5  # snapshot_programs.py:24
    return quadratic, scaled
