import numpy as np

from shpy.backend.numpy.lanes import compact, few, maximum, put_aside, select, spread


def bisection(x, lanes):
    status = np.int32(1)  # snapshot_programs.py:185
    low = np.zeros(lanes, np.float32)  # snapshot_programs.py:187
    high = maximum(x, 1.0)
    iterations = np.int32(0)  # snapshot_programs.py:188
    status_out = spread(status, lanes)
    low_in = low.copy()
    live = np.ones(lanes, np.bool_)
    lane = np.arange(lanes)
    while True:
        if few(live):
            high, lane, live, low_in, x = compact(live, high, lane, live, low_in, x)
        iterations = iterations + 1
        if iterations > 1048576:
            status = np.int32(2)
            put_aside(status_out, lane, live, status)
            break
        middle = (low_in + high) / 2.0  # snapshot_programs.py:189
        t = middle * middle < x  # snapshot_programs.py:190
        active = live & t
        low_in = select(active, middle, low_in)  # snapshot_programs.py:191
        active_2 = live & ~t
        high = select(active_2, middle, high)  # snapshot_programs.py:193
        leaving = live & (high - low_in <= 1e-06 * high)
        if leaving.any():  # snapshot_programs.py:188
            put_aside(low, lane, leaving, low_in)
            live = live & ~leaving
            if not live.any():
                break
    return low, status_out  # snapshot_programs.py:195
