import numpy as np

from shpy.backend.numpy.lanes import compact, few, put_aside, spread


def descend(x, children, lanes):
    node = np.int32(0)  # test_numpy_text.py:59
    level = np.int32(0)  # test_numpy_text.py:60
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
            if not live.any():  # test_numpy_text.py:61
                break
        if np.any(live & (x > 5.0)):  # test_numpy_text.py:62
            node = children.at(node)[0]  # test_numpy_text.py:63
        elif level == 3:  # test_numpy_text.py:64
            node = children.at(node)[1]  # test_numpy_text.py:65
        else:
            node = node + 1  # test_numpy_text.py:67
        level = level + 1  # test_numpy_text.py:60
    return node_out  # test_numpy_text.py:68
