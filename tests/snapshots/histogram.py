import numpy as np

from shpy.backends.numpy.lanes import pick, put
from shpy.ir.meaning import shift_right


def histogram(x, lanes):
    counts = np.zeros((4, lanes), np.int32)
    last = np.zeros((2, lanes), np.float32)  # test_numpy_text.py:47
    i = np.int32(0)  # test_numpy_text.py:48
    while i < 10:
        t = shift_right(x, i) % 4  # test_numpy_text.py:49
        put(counts, t, pick(counts, t) + 1)
        if i % 3 == 1:  # test_numpy_text.py:50
            i = i + 1  # test_numpy_text.py:48
            continue  # test_numpy_text.py:50
        last[1] = pick(counts, i).astype(np.float32)  # test_numpy_text.py:51
        i = i + 1  # test_numpy_text.py:48
    return pick(counts, x), last
