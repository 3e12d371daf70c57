import numpy as np

from shpy.backend.numpy.lanes import pick, put
from shpy.ir.meaning import shift_right


def histogram(x, lanes):
    counts = np.zeros((4, lanes), np.int32)
    last = np.zeros((2, lanes), np.float32)  # test_numpy_text.py:36
    i = np.int32(0)  # test_numpy_text.py:37
    while i < 10:
        t = shift_right(x, i) % 4  # test_numpy_text.py:38
        put(counts, t, pick(counts, t) + 1)
        if i % 3 == 1:  # test_numpy_text.py:39
            i = i + 1  # test_numpy_text.py:37
            continue  # test_numpy_text.py:39
        last[1] = pick(counts, i).astype(np.float32)  # test_numpy_text.py:40
        i = i + 1  # test_numpy_text.py:37
    return pick(counts, x), last
