import numpy as np

from shpy.backend.numpy.lanes import compact, few, put_aside, select, spread


def collatz(n, lanes):
    status = np.int32(1)  # snapshot_programs.py:61
    n_2 = n
    steps = np.int32(0)  # snapshot_programs.py:63
    iterations = np.int32(0)  # snapshot_programs.py:64
    steps_out = spread(steps, lanes)
    status_out = spread(status, lanes)
    live = np.ones(lanes, np.bool_)
    lane = np.arange(lanes)
    while True:
        if few(live):
            lane, live, n_2 = compact(live, lane, live, n_2)
        leaving = live & (n_2 <= 1)
        if leaving.any():
            put_aside(steps_out, lane, leaving, steps)
            live = live & ~leaving
            if not live.any():
                break
        iterations = iterations + 1
        if iterations > 1048576:
            status = np.int32(2)
            put_aside(status_out, lane, live, status)
            break
        n_2 = select(n_2 % 2 == 0, n_2 // 2, 3 * n_2 + 1)  # snapshot_programs.py:65
        steps = steps + 1  # snapshot_programs.py:66
    return steps_out, status_out  # snapshot_programs.py:67
