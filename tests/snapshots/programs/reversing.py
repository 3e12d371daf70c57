import numpy as np

from shpy.backend.numpy.lanes import component, pick, put


def reversing(x, n, lanes):
    stack = np.zeros((4, lanes), np.float32)
    i = np.int32(0)  # snapshot_programs.py:114
    while i < 4:
        put(stack, i, component(x, i))  # snapshot_programs.py:115
        i = i + 1  # snapshot_programs.py:114
    return pick(stack, 3 - n)  # snapshot_programs.py:116
