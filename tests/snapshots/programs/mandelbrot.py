import numpy as np

from shpy.backend.numpy.lanes import compact, few, put_aside, spread


def dot2(a_x, a_y, b_x, b_y):
    return a_x * b_x + a_y * b_y


def mandelbrot(c, lanes):
    status = np.int32(1)  # snapshot_programs.py:36
    z_x = np.zeros(lanes, np.float32)  # snapshot_programs.py:38
    z_y = np.zeros(lanes, np.float32)
    n = np.float32(0.0)  # snapshot_programs.py:39
    iterations = np.int32(0)  # snapshot_programs.py:40
    n_out = spread(n, lanes)
    status_out = spread(status, lanes)
    live = np.ones(lanes, np.bool_)
    lane = np.arange(lanes)
    while True:
        if few(live):
            c, lane, live, z_x, z_y = compact(live, c, lane, live, z_x, z_y)
        iterations = iterations + 1
        if iterations > 1048576:
            status = np.int32(2)
            put_aside(status_out, lane, live, status)
            break
        t = 2.0 * z_x * z_y + c[1]  # snapshot_programs.py:41
        z_x = z_x * z_x - z_y * z_y + c[0]
        z_y = t
        n = n + 1.0  # snapshot_programs.py:42
        leaving = live & ((dot2(z_x, z_y, z_x, z_y) > 4.0) | (n >= 256.0))
        if leaving.any():  # snapshot_programs.py:40
            put_aside(n_out, lane, leaving, n)
            live = live & ~leaving
            if not live.any():
                break
    return n_out, status_out  # snapshot_programs.py:44
