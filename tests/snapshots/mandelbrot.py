import numpy as np

from shpy.backends.numpy.lanes import compact, dot, few, put_aside, spread, vector


def mandelbrot(c, lanes):
    status = np.int32(1)  # test_numpy_text.py:27
    z = np.zeros((2, lanes), np.float32)  # test_numpy_text.py:29
    n = np.float32(0.0)  # test_numpy_text.py:30
    turns = np.int32(0)  # test_numpy_text.py:31
    n_out = spread(n, lanes)
    status_out = spread(status, lanes)
    live = np.ones(lanes, np.bool_)
    lane = np.arange(lanes)
    while True:
        if few(live):
            c, lane, live, z = compact(live, c, lane, live, z)
        turns = turns + 1
        if turns > 1048576:
            status = np.int32(2)
            put_aside(status_out, lane, live, status)
            break
        z = vector(z[0] * z[0] - z[1] * z[1], 2.0 * z[0] * z[1]) + c  # test_numpy_text.py:32
        n = n + 1.0  # test_numpy_text.py:33
        leaving = live & ((dot(z, z) > 4.0) | (n >= 256.0))
        if leaving.any():  # test_numpy_text.py:31
            put_aside(n_out, lane, leaving, n)
            live = live & ~leaving
            if not live.any():
                break
    return n_out, status_out  # test_numpy_text.py:35
