import numpy as np


def checkered(grid_index, grid_shape, lanes):
    uv_x = grid_index[0].astype(np.float32) / grid_shape[0].astype(np.float32)  # snapshot_programs.py:176
    uv_y = grid_index[1].astype(np.float32) / grid_shape[1].astype(np.float32)
    return uv_x, uv_y, ((grid_index[0] ^ grid_index[1]) & 1).astype(np.float32)
