import numpy as np

from shpy.backend.numpy.lanes import compact, few, put_aside, select, spread


def leaving(x, lanes):
    result0 = np.zeros(lanes, np.int32)
    result1 = np.zeros(lanes, np.int32)
    returned = np.zeros(lanes, np.bool_)
    running = np.ones(lanes, np.bool_)
    status = np.int32(1)  # snapshot_programs.py:82
    status_out = spread(status, lanes)
    t = np.isnan(x)  # snapshot_programs.py:84
    if t.any():
        status_out = select(t, 0, status_out)
        running = running & ~t
    if not running.any():
        return result0, result1, status_out
    i = np.int32(0)  # snapshot_programs.py:85
    result0_in_2 = result0.copy()
    result1_in_2 = result1.copy()
    status_in = status_out.copy()
    returned_in_2 = returned.copy()
    live = running
    lane = np.arange(lanes)
    while True:
        if few(live):
            lane, live, result0_in_2, result1_in_2, returned_in_2, status_in, x = compact(live, lane, live, result0_in_2, result1_in_2, returned_in_2, status_in, x)
        if i >= 4:
            put_aside(result0, lane, live, result0_in_2)
            put_aside(result1, lane, live, result1_in_2)
            put_aside(status_out, lane, live, status_in)
            put_aside(returned, lane, live, returned_in_2)
            break
        j = np.int32(0)  # snapshot_programs.py:86
        iterations = np.int32(0)
        result0_in = result0_in_2.copy()
        result1_in = result1_in_2.copy()
        returned_in = returned_in_2.copy()
        live_2 = live
        all_x = x
        lane_2 = np.arange(live.size)
        while j < i:
            if few(live_2):
                lane_2, live_2, result0_in, result1_in, returned_in, x = compact(live_2, lane_2, live_2, result0_in, result1_in, returned_in, x)
            iterations = iterations + 1
            if iterations > 1048576:
                status = np.int32(2)
                put_aside(status_in, lane_2, live_2, status)
                break
            leaving_2 = live_2 & (x < (i * j).astype(np.float32))
            if leaving_2.any():
                result0_in = select(leaving_2, i, result0_in)  # snapshot_programs.py:88
                result1_in = select(leaving_2, j, result1_in)
                returned_in = select(leaving_2, True, returned_in)
                put_aside(result0_in_2, lane_2, leaving_2, result0_in)
                put_aside(result1_in_2, lane_2, leaving_2, result1_in)
                put_aside(returned_in_2, lane_2, leaving_2, returned_in)
                live_2 = live_2 & ~leaving_2
                if not live_2.any():
                    break
            j = j + 1  # snapshot_programs.py:86
        x = all_x
        leaving_3 = live & (status_in != 1)
        if leaving_3.any():
            put_aside(status_out, lane, leaving_3, status_in)
            live = live & ~leaving_3
            if not live.any():
                break
        leaving_4 = live & returned_in_2
        if leaving_4.any():
            put_aside(result0, lane, leaving_4, result0_in_2)
            put_aside(result1, lane, leaving_4, result1_in_2)
            put_aside(status_out, lane, leaving_4, status_in)
            put_aside(returned, lane, leaving_4, returned_in_2)
            live = live & ~leaving_4
            if not live.any():
                break
        i = i + 1  # snapshot_programs.py:85
    leaving_5 = running & (status_out != 1)
    if leaving_5.any():
        running = running & ~leaving_5
    leaving_6 = running & returned
    if leaving_6.any():
        running = running & ~leaving_6
    return select(running, -1, result0), select(running, -1, result1), status_out
