import numpy as np

from shpy.backend.numpy.lanes import half


def halves(x, f, lanes):
    return half(half(x * x) + 0.099975586), f + x
