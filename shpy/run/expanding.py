"""Broadcasting on a device: a stream's elements are repeated along axes that it lacks.

Stage: run. A kernel reads its inputs at one flat index, so a stream of another shape is expanded first, as numpy's
`broadcast_to(x, shape).copy()` does it.

    expanding(sh.Point3f)                        # a program of the elements and of `axes`
    axes((3, 1), (2, 3, 4))                      # [[4, 3, 1]]: the element at flat index i is that at (i // 4) % 3 * 1
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.lang.data.tables import TableType
from shpy.lang.programs.control import SH_FOR
from shpy.lang.programs.record import RecordedProgram, record_body
from shpy.lang.recording.recorder import recording
from shpy.lang.values.builtins import grid_index
from shpy.lang.values.structure import layout_of
from shpy.lang.values.types import Attrib1i, Attrib3i
from shpy.streams.elements import Shape


@lru_cache(maxsize=64)
def expanding(cls: Any) -> RecordedProgram:
    """Return the program that reads, for each element of the larger shape, the stream's element for it."""

    def body(arguments: Mapping[str, Any]) -> Any:
        data, axes = arguments["data"], arguments["axes"]
        place = Attrib1i(0)
        with SH_FOR(0, axes.shape[0]) as k:
            axis = axes[k]
            place += grid_index(1) // axis.x % axis.y * axis.z
        return data[place]

    types: dict[str, Any] = {"data": TableType(cls, 1), "axes": TableType(Attrib3i, 1)}
    with recording("expanded", None) as record:
        return record_body(record, types, layout_of(cls, "expanded"), body)


def axes(shape: Shape, common: Shape) -> NDArray[np.int32]:
    """Return a row for each axis along which `shape` has several elements.

    It has the number of elements of `common` after the axis, the extent, and the number of those of `shape` after it.
    """
    rows = [
        (math.prod(common[len(common) - k :]), shape[-k - 1], math.prod(shape[len(shape) - k :]))
        for k in range(len(shape))
        if shape[-k - 1] != 1
    ]
    return np.array(rows, np.int32)
