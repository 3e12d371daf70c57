import numpy as np

from shpy.backends.numpy.lanes import compact, few, put_aside, spread


def descend(x, children, lanes):
    node = np.int32(0)  # test_numpy_text.py:70
    level = np.int32(0)  # test_numpy_text.py:71
    node_out = spread(node, lanes)
    live = np.ones(lanes, np.bool_)
    lane = np.arange(lanes)
    while True:
        if few(live):
            lane, live, x = compact(live, lane, live, x)
        if level >= 8:
            put_aside(node_out, lane, live, node)
            break
        leaving = live & (x < level.astype(np.float32))
        if leaving.any():
            put_aside(node_out, lane, leaving, node)
            live = live & ~leaving
            if not live.any():  # test_numpy_text.py:72
                break
        if np.any(live & (x > 5.0)):  # test_numpy_text.py:73
            node = children.at(node)[0]  # test_numpy_text.py:74
        elif level == 3:  # test_numpy_text.py:75
            node = children.at(node)[1]  # test_numpy_text.py:76
        else:
            node = node + 1  # test_numpy_text.py:78
        level = level + 1  # test_numpy_text.py:71
    return node_out  # test_numpy_text.py:79
