import numpy as np

from shpy.backend.numpy.lanes import maximum, minimum
from shpy.ir.meaning import bits_from_float, convert, mod, sign


def edges(x, y, lanes):
    result0 = minimum(x, y)  # snapshot_programs.py:162
    result1 = sign(x)
    result2 = np.rint(x)
    result3 = convert(x, np.int32)
    result4 = mod(x, y)
    result5 = minimum(maximum(x, 0.0), y)
    result6 = bits_from_float(x)
    return result0, result1, result2, result3, result4, result5, result6
