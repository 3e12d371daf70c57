"""The interface between a shader's text and the runtime: the abilities of a device, and the meaning of each name.

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
class Limits:
    """The limits of a device: texels along an axis, outputs and textures of one program, and how exact it is.

    The sizes by default are the least that OpenGL 3.3 allows.
    """

    width: int = 1024
    outputs: int = 8
    textures: int = 16
    wrong: frozenset[str] = frozenset()
    """The operations that it gets wrong, of FAULTS in `shpy/backend/device/probe.py`."""
    keeps_order: bool = True
    """True if it has `precise`: without it only fast mode compiles."""
    chooses: bool = True
    """True if `a < b ? b : a` gives a where a is NaN."""
    negates: bool = True
    """True if `!(a < b)` holds where a is NaN."""
    signs: bool = True
    """True if the choice of a zero keeps its sign, also where only a product shows it."""
    doubles: bool = False
    """True if the device has binary64, and computes exactly in it."""
    roots: bool = True
    """True if its own square roots of binary64 are exact as well: those of NVIDIA 580.159 are not."""
    reads: bool = True
    """True if its compiler rounds decimal numbers correctly."""

    @property
    def leaves_loops(self) -> bool:
        """True if loops are left when the conditions of their exits hold."""
        return "exits" not in self.wrong

    @property
    def keeps_denormals(self) -> bool:
        """True if no denormal becomes zero."""
        return "denormals" not in self.wrong


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
