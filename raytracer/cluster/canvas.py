"""Layers of a picture in files that have no names, so that a large picture takes disk space instead of memory.

Stage: cluster. The operating system writes pages out when it needs the memory, and drops the files with the arrays.
"""

from __future__ import annotations

import shutil
import tempfile
from typing import Any

import numpy as np

from raytracer.errors import SceneError
from raytracer.integrators.layers import unset
from raytracer.memory import PIXEL


def canvas(width: int, height: int) -> dict[str, Any]:
    """Return the layers of a picture, to be filled; SceneError where the folder for temporary files is too full."""
    folder = tempfile.gettempdir()
    needed, free = width * height * PIXEL, shutil.disk_usage(folder).free
    if needed > free:
        raise SceneError(
            f"a picture of {width} x {height} pixels takes {needed:,} bytes in {folder}, where {free:,} are free: "
            "choose a smaller size, or another folder by TMPDIR"
        )
    return unset(width, height, _array_in_file)


def _array_in_file(shape: tuple[int, ...], kind: Any) -> Any:
    with tempfile.TemporaryFile() as file:
        return np.asarray(np.memmap(file, kind, "w+", shape=shape))
