"""The modes of arithmetic, in a module of their own: importing it costs nothing."""

from typing import Literal

Math = Literal["strict", "relaxed", "fast"]
"""How exact functions are: the same bits everywhere, within OpenCL's bounds, or as fast as can be."""
