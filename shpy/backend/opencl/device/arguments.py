"""Arguments of kernels, from numbers and shapes.

Stage: run.

    argument(np.array([1.0, 2.0, 3.0], np.float32))      # a vector of four, as OpenCL has those of three
    extents((480, 640))
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from shpy.backend.base import Array
from shpy.ir.constants import DTYPES
from shpy.ir.types import Type


def argument_dtype(type: Type) -> Any:
    """Return the dtype of a param's component as an argument: no argument may be a bool."""
    return np.int32 if type.is_bool else DTYPES[type.base]


@lru_cache(maxsize=256)
def extents(shape: tuple[int, ...]) -> Any:
    """Return a shape as one argument; nobody changes it."""
    return argument(np.array(shape, np.int32))


def argument(values: Array, type: Type | None = None) -> Any:
    """Return numbers as one argument: a scalar or a vector; a vector of three is padded to four."""
    flat = np.atleast_1d(values)
    if type is not None and type.is_bool and type.size > 1:
        flat = -flat
    if flat.size == 1:
        return flat[0]
    return np.append(flat, flat.dtype.type(0)) if flat.size == 3 else flat
