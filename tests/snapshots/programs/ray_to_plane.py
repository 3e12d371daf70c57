import numpy as np

from shpy.backend.numpy.lanes import select


def ray_to_plane(ray_o, ray_d, height, lanes):
    status = np.full(lanes, 1, np.int32)  # snapshot_programs.py:148
    t = (height - ray_o[1]) / ray_d[1]  # snapshot_programs.py:150
    t2 = t < 0.0  # snapshot_programs.py:151
    if t2.any():
        status = select(t2, 0, status)
    o_2 = ray_o + t * ray_d  # snapshot_programs.py:152
    d_2 = -ray_d
    return o_2, d_2, status
