"""The interface between a shader's text and the runtime: the input, table or uniform that each name stands for.

Stage: between emit and run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from shpy.ir.types import Type

FOLD: Final = 4096
"""Texels in a row of a table: element i stands at (i % FOLD, i / FOLD)."""

RUNNING = "sh_running"
"""A bool that is always true."""

NOTHING = "sh_nothing"
"""A `uint` that is always 0."""

LAST = "sh_last"
"""The last cell of a draw: `ivec2`. A cell is a pixel, the place of one element."""

FIRST = "sh_first"
"""The flat index of the element in cell (0, 0): `int`."""

WIDTH = "sh_width"
"""The elements in a row of cells: `int`."""

GRID_SHAPE = "sh_grid_shape"
"""The number of elements along numpy's axes, then ones: `ivec4`."""


@dataclass(frozen=True, slots=True)
class InputTexture:
    """The `index`-th input: its sampler, and the int uniform that is 1, or 0 where one value serves all elements."""

    index: int
    type: Type
    sampler: str
    each: str


@dataclass(frozen=True, slots=True)
class TableTexture:
    """A table in a shader: the names of its sampler and of the uniform with its shape."""

    name: str
    type: Type
    rank: int
    sampler: str
    shape: str


@dataclass(frozen=True, slots=True)
class Shader:
    """A fragment shader. `params` maps a param's name to its uniform; `outputs` are in the order of the attachments."""

    source: str
    inputs: tuple[InputTexture, ...]
    params: dict[str, tuple[str, Type]]
    tables: tuple[TableTexture, ...]
    outputs: tuple[Type, ...]
