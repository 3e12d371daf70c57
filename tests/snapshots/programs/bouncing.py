import numpy as np

from shpy.backend.numpy.lanes import select


def bounce(position, velocity, floor, lanes):
    result = np.zeros(lanes, np.bool_)
    running = np.ones(lanes, np.bool_)
    position_2 = position.copy()  # snapshot_programs.py:92
    velocity_2 = velocity.copy()
    t = position[1] > floor  # snapshot_programs.py:94
    if t.any():
        result = np.zeros(lanes, np.bool_)  # snapshot_programs.py:95
        running = running & ~t
    position_2[1] = select(running, 2.0 * floor - position[1], position_2[1])  # snapshot_programs.py:96
    velocity_2[1] = select(running, -velocity[1], velocity_2[1])  # snapshot_programs.py:97
    return select(running, True, result), position_2, velocity_2  # snapshot_programs.py:98


def bouncing(position, velocity, lanes):
    hits = np.zeros(lanes, np.int32)  # snapshot_programs.py:103
    i = np.int32(0)  # snapshot_programs.py:104
    while i < 10:
        position = position + velocity * 0.1  # snapshot_programs.py:105
        t, position, velocity = bounce(position, velocity, np.float32(0.0), lanes)  # snapshot_programs.py:106
        hits = select(t, hits + 1, hits)  # snapshot_programs.py:107
        i = i + 1  # snapshot_programs.py:104
    return position, hits
