"""Arrays for programs: numbers that are likely to go wrong, and numbers that are likely to make elements diverge.

Stage: test. Takes a program, gives an array for each of its inputs.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from shpy.errors import ShpyTypeError
from shpy.ir.constants import DTYPES
from shpy.ir.types import Base, Type
from shpy.lang.data.tables import TableType
from shpy.lang.data.textures import TextureType
from shpy.lang.recording.location import here
from shpy.lang.values.structure import build_arrays, layout_of, leaves
from shpy.programs import Program, check_count, check_program
from shpy.testing.generated.syntax import F3, F, I, U, Variable

NUMBERS: dict[Base, tuple[float, ...]] = {
    Base.F: (0, 1, 2, -1, 0.5, -0.0, -2.5, 0.1, 3, 1e-3, 1e10, -1e30, float("inf"), float("nan")),
    Base.I: (0, 1, 2, -1, 3, -7, 31, 33, 1000, -(2**31), 2**31 - 1),
    Base.U: (0, 1, 2, 3, 31, 32, 65535, 2**31, 2**32 - 1),
    Base.B: (0, 1),
}
"""Numbers of each base that often reveal faults; the first are what failing programs shrink to."""

INPUTS = (Variable("a", F), Variable("v", F3), Variable("n", I), Variable("h", U))
"""The inputs of every generated program."""


def inputs(program: Program, count: int = 64, seed: int = 0) -> list[Any]:
    """Arrays of `count` elements for each input of a program, in order; about every third number is special.

    An input that is a table gets data of the size that the program names, else five on each axis. Raises ShpyTypeError
    for an input that is a texture: give that yourself.
    """
    check_program(program)
    check_count("count", count, 0)
    check_count("seed", seed, 0)
    rng = np.random.default_rng((count, seed))
    sizes = {table.name: table.size for table in program.ir.tables}
    arguments: list[Any] = []
    for name, layout in program.recorded.inputs.items():
        if isinstance(layout, TextureType):
            raise ShpyTypeError(
                f"{name} is a texture, of which there are none in general",
                loc=here(),
                cure=f"program.bind({name}=sh.Texture2D(array))",
            )
        if isinstance(layout, TableType):
            whole = layout_of(layout.cls, name)
            arrays = []
            for leaf, _, cls in leaves(whole, name):
                extents = sizes.get(leaf) or (5,) * layout.rank
                tail = (cls.size,) if cls.size > 1 else ()
                arrays.append(_array(cls.type, int(np.prod(extents)), rng).reshape(extents + tail))
            arguments.append(build_arrays(whole, iter(arrays)))
        else:
            arguments.append(build_arrays(layout, iter([_array(c.type, count, rng) for *_, c in leaves(layout, name)])))
    return arguments


def elements(count: int) -> list[Any]:
    """Arrays for INPUTS."""
    rng = np.random.default_rng(count)
    return [_array(variable.type, count, rng) for variable in INPUTS]


def _array(type: Type, count: int, rng: np.random.Generator) -> Any:
    """Return `count` values of a type, (count,) or (count, size)."""
    base, dtype = type.base, DTYPES[type.base]
    shape = (count, type.size) if type.size > 1 else (count,)
    with np.errstate(over="ignore"):
        special = np.array(NUMBERS.get(base, NUMBERS[Base.F])).astype(dtype)
    ordinary = rng.integers(0 if base is Base.U else -3, 6, shape).astype(dtype)
    if type.is_float:
        ordinary = rng.uniform(-4, 4, shape).astype(dtype)
    # Use each special number once before any is repeated.
    picked = np.flatnonzero(rng.random(ordinary.size) < 0.3)
    ordinary.flat[picked] = np.resize(rng.permutation(special), picked.size)
    return ordinary
