import numpy as np

from shpy.backend.numpy.lanes import component, vector


def swizzles(p, k, lanes):
    q = vector(p[3] + p[2], p[1], np.float32(0.0), p[1])  # snapshot_programs.py:32
    return q[[2, 1, 0]], component(q, k)
