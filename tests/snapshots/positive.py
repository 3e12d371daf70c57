import numpy as np

from shpy.backend.numpy.lanes import compact, few, minimum, put_aside, select, spread


def positive(x, n, lanes):
    status = np.int32(1)  # test_numpy_text.py:44
    n_2 = n
    total = np.zeros(lanes, np.float32)  # test_numpy_text.py:46
    status_out = spread(status, lanes)
    t = x < 0.0  # test_numpy_text.py:47
    if t.any():
        status_out = select(t, 0, status_out)  # test_numpy_text.py:48
    t2 = ~t
    if t2.any():
        iterations = np.int32(0)  # test_numpy_text.py:50
        total_in = total.copy()
        live = t2
        lane = np.arange(lanes)
        while True:
            if few(live):
                lane, live, n_2, total_in, x = compact(live, lane, live, n_2, total_in, x)
            leaving = live & (n_2 <= 0)
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
            total_in = total_in + minimum(x, 1.0) / n_2.astype(np.float32)  # test_numpy_text.py:51
            n_2 = n_2 - 1  # test_numpy_text.py:52
    return total, status_out  # test_numpy_text.py:53
