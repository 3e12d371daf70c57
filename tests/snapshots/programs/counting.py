import numpy as np

from shpy.backend.numpy.lanes import compact, few, put_aside, spread


def counting(x, n, lanes):
    result = np.zeros(lanes, np.float32)
    running = np.ones(lanes, np.bool_)
    status = np.int32(1)  # snapshot_programs.py:70
    total = np.zeros(lanes, np.float32)  # snapshot_programs.py:72
    i = np.int32(0)  # snapshot_programs.py:73
    iterations = np.int32(0)
    status_out = spread(status, lanes)
    total_in = total.copy()
    live = np.ones(lanes, np.bool_)
    lane = np.arange(lanes)
    while True:
        if few(live):
            lane, live, n, total_in, x = compact(live, lane, live, n, total_in, x)
        leaving = live & (i >= n)
        if leaving.any():
            put_aside(total, lane, leaving, total_in)
            live = live & ~leaving
            if not live.any():
                break
        iterations = iterations + 1
        if iterations > 1048576:
            status = np.int32(2)
            put_aside(status_out, lane, live, status)
            break
        if i % 3 == 0:  # snapshot_programs.py:74
            i = i + 1  # snapshot_programs.py:73
            continue  # snapshot_programs.py:74
        total_in = total_in + x * i.astype(np.float32)  # snapshot_programs.py:75
        leaving_2 = live & (total_in > 100.0)
        if leaving_2.any():
            put_aside(total, lane, leaving_2, total_in)
            live = live & ~leaving_2
            if not live.any():  # snapshot_programs.py:76
                break
        i = i + 1  # snapshot_programs.py:73
    t = status_out != 1
    if t.any():
        running = running & ~t
    if not running.any():
        return result, status_out
    j = np.int32(8)  # snapshot_programs.py:77
    while j > 0:
        total = total - j.astype(np.float32)  # snapshot_programs.py:78
        j = j + -2  # snapshot_programs.py:77
    return total, status_out  # snapshot_programs.py:79
