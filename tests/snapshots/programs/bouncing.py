import numpy as np

from shpy.backends.numpy.lanes import select


def bouncing(position, velocity, lanes):
    position_2 = position.copy()  # snapshot_programs.py:101
    velocity_2 = velocity.copy()
    hits = np.zeros(lanes, np.int32)  # snapshot_programs.py:103
    i = np.int32(0)  # snapshot_programs.py:104
    while i < 10:
        position_2 = position_2 + velocity_2 * 0.1  # snapshot_programs.py:105
        result = np.zeros(lanes, np.bool_)  # snapshot_programs.py:95
        t = ~(position_2[1] > 0.0)
        position_2[1] = select(t, 0.0 - position_2[1], position_2[1])  # snapshot_programs.py:96
        velocity_2[1] = select(t, -velocity_2[1], velocity_2[1])  # snapshot_programs.py:97
        result = select(t, True, result)  # snapshot_programs.py:98
        hits = select(result, hits + 1, hits)  # snapshot_programs.py:107
        i = i + 1  # snapshot_programs.py:104
    return position_2, hits
