import numpy as np

from shpy.backend.numpy.lanes import select


def packets(x, lanes):
    y = x  # snapshot_programs.py:167
    t = x > 1.0  # snapshot_programs.py:168
    if t.any():
        y = select(t, np.sqrt(x), y)  # snapshot_programs.py:169
    return y  # snapshot_programs.py:170
