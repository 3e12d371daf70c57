import numpy as np

from shpy.backends.numpy.lanes import vector


def checkered(grid_index, grid_shape, lanes):
    uv = grid_index.astype(np.float32) / grid_shape.astype(np.float32)  # snapshot_programs.py:176
    return vector(uv, ((grid_index[0] ^ grid_index[1]) & 1).astype(np.float32))  # snapshot_programs.py:177
