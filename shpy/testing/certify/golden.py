"""Golden hashes: what strict mode gives on every device, kept in the package as `golden.json`.

Stage: test. A hash stands for the arrays of a run, with one NaN for all NaNs.

    golden()["functions"]["sin"]          # "5f0c…"
    digest([np.zeros(3, np.float32)])
"""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np

from shpy.testing.arrays import Array

FILE: Final = Path(__file__).with_name("golden.json")
KERNELS: Final = Path(__file__).with_name("kernels")
"""The examples' kernels as IR text: the examples are not installed with the package."""


@functools.cache
def golden() -> dict[str, dict[str, str]]:
    """Return the hashes of each section by name."""
    content: dict[str, dict[str, str]] = json.loads(FILE.read_text())
    return content


def digest(arrays: Iterable[Array]) -> str:
    """Return a hash of arrays: of their types, shapes and bits, in little-endian order."""
    whole = hashlib.sha256()
    for array in arrays:
        plain = np.ascontiguousarray(array)
        if plain.dtype.kind == "f":
            plain = np.where(np.isnan(plain), plain.dtype.type(np.nan), plain)
        plain = plain.astype(plain.dtype.newbyteorder("<"), copy=False)
        whole.update(f"{plain.dtype.str} {plain.shape} ".encode())
        whole.update(plain.tobytes())
    return whole.hexdigest()[:16]
