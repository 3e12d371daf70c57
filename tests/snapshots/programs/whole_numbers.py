import numpy as np

from shpy.ir.meaning import floor_div_int, floor_mod_int


def scramble(state):
    word = ((state >> ((state >> 28) + 4)) ^ state) * 277803737  # library.py:32
    return (word >> 22) ^ word  # library.py:33


def pcg(x):
    return scramble(x * 747796405 + 2891336453)  # library.py:40


def whole_numbers(a, b, u, lanes):
    result0 = floor_div_int(a, b)  # snapshot_programs.py:157
    result1 = floor_mod_int(a, b)
    result2 = (a << 2) ^ (b & ~a)
    result3 = u >> 7
    result4 = (pcg(u) >> 8).astype(np.float32) * 5.9604645e-08
    result5 = -2147483648 - a
    return result0, result1, result2, result3, result4, result5
