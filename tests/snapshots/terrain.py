import numpy as np


def terrain(cell, sky, heights, grid_index, lanes):
    h = heights.gather(cell)  # test_numpy_text.py:29
    return sky * h, grid_index
