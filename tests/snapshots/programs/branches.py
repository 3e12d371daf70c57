import numpy as np

from shpy.backend.numpy.lanes import select


def branches(x, lanes):
    color = np.zeros((3, lanes), np.float32)  # snapshot_programs.py:49
    t = x < 0.0  # snapshot_programs.py:50
    color[0] = select(t, -x, color[0])  # snapshot_programs.py:51
    t2 = ~t
    if t2.any():
        t3 = x > 1.0  # snapshot_programs.py:52
        active = t2 & t3
        color[1] = select(active, x, color[1])  # snapshot_programs.py:53
        active_2 = active & (x > 2.0)
        color = select(active_2, color * 0.5, color)  # snapshot_programs.py:55
        active_3 = t2 & ~t3
        color[2] = select(active_3, 1.0 - x, color[2])  # snapshot_programs.py:57
    return color  # snapshot_programs.py:58
