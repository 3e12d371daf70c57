import numpy as np

from shpy.backend.numpy.lanes import dot, maximum, normalize, vector


def lit(p, n, turn_0, turn_1, turn_2, light, lanes):
    result0 = vector(dot(turn_0, p), dot(turn_1, p), dot(turn_2, p))  # snapshot_programs.py:139
    result1 = maximum(dot(normalize(n), light), 0.0)
    return result0, result1
