import numpy as np

from shpy.backends.numpy.lanes import compact, few, put_aside, spread


def dot2(a_x, a_y, b_x, b_y):
    return a_x * b_x + a_y * b_y


def mandelbrot(c, lanes):
    status = np.int32(1)  # test_numpy_text.py:27
    z_x = np.zeros(lanes, np.float32)  # test_numpy_text.py:29
    z_y = np.zeros(lanes, np.float32)
    n = np.float32(0.0)  # test_numpy_text.py:30
    iterations = np.int32(0)  # test_numpy_text.py:31
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
        t = 2.0 * z_x * z_y + c[1]  # test_numpy_text.py:32
        z_x = z_x * z_x - z_y * z_y + c[0]
        z_y = t
        n = n + 1.0  # test_numpy_text.py:33
        leaving = live & ((dot2(z_x, z_y, z_x, z_y) > 4.0) | (n >= 256.0))
        if leaving.any():  # test_numpy_text.py:31
            put_aside(n_out, lane, leaving, n)
            live = live & ~leaving
            if not live.any():
                break
    return n_out, status_out  # test_numpy_text.py:35
