"""Sorting: the elements of a stream in the order of a key.

Stage: run.

    near_first = sh.sort(rays, key=distance)
    order = sh.argsort(distances)
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.backend.base import Memory
from shpy.collectives.arguments import check_stream, shaped
from shpy.collectives.chunk_sorting import argsort_chunks, sort_chunks
from shpy.collectives.leaves import Leaves
from shpy.collectives.trees import leaf_types, memories_of
from shpy.errors import ShpyTypeError
from shpy.ieee import in_ieee_arithmetic
from shpy.ir.constants import is_int
from shpy.lang.data.hostdata import checked_bool
from shpy.lang.data.tables import TableType
from shpy.lang.data.textures import TextureType
from shpy.lang.recording.location import here
from shpy.lang.values.structure import is_lazy, spoken_type
from shpy.lang.values.types import Attrib1i
from shpy.programs import Program
from shpy.streams.stream import Stream


@in_ieee_arithmetic
def sort(stream: Any, key: Program | None = None, descending: bool = False) -> Any:
    """Return the elements in ascending order, of shape (n,) for n elements; several axes are taken in C order.

    `key` is a program from one element to one number or bool, by which elements are compared; elements of one component
    need none. The order is stable: elements of equal keys keep the order that they had, with `descending=True` too. -0
    and +0 are equal. NaN is greater than every number, whatever its sign and bits, so it stands last, and first if
    descending. Of a Dask array of scalars or vectors it returns a Dask array, for any chunks the same one. Raises
    ShpyTypeError for elements of several components without a key, for a program of other types, and for a `descending`
    that is no bool.
    """
    descending = checked_bool(descending, "descending")
    if is_lazy(stream):
        return sort_chunks(partial(host_keys, key=key, name="sort"), stream, key, descending)
    elements = check_stream(stream, "sort")
    leaves = Leaves(elements.place)
    keys = keys_of(elements, key, "sort")
    if key is None:
        return shaped(elements, [leaves.sort(keys, descending)], (elements.size,))
    order = leaves.order(keys, descending)
    return shaped(elements, leaves.take_each(memories_of(elements), order), (elements.size,))


@in_ieee_arithmetic
def argsort(stream: Any, key: Program | None = None, descending: bool = False, *, below: int | None = None) -> Any:
    """Return the indices, ints of shape (n,), that bring the elements into the order of `sh.sort`.

    `sh.gather(stream, sh.argsort(stream))` is `sh.sort(stream)`; so several streams can be sorted by one of them.
    `below` says that the keys are ints from 0 to `below` - 1, such as numbers of cells: a device that sorts by digits
    takes fewer passes then. A key that is out of range counts as the nearest one in range. Of a Dask array of scalars
    or vectors it returns a Dask array, of int64 where that has more than 2**31 elements. Raises ShpyTypeError as
    `sh.sort` does, and for a `below` that is no int from 1 to 2**31 or beside keys that are no ints.
    """
    descending = checked_bool(descending, "descending")
    if is_lazy(stream):
        return argsort_chunks(partial(host_keys, key=key, name="argsort", below=below), stream, key, descending)
    elements = check_stream(stream, "argsort")
    keys = keys_of(elements, key, "argsort")
    order = Leaves(elements.place).order(keys, descending, _checked_below(below, keys))
    return Stream.over(Attrib1i, (elements.size,), elements.place, [order])


def host_keys(stream: Stream, key: Program | None, name: str, below: int | None = None) -> NDArray[Any]:
    """Return the keys, (n,), clamped to [0, below) if `below` is given."""
    keys = keys_of(stream, key, name)
    values, below = np.asarray(keys.read()).reshape(-1), _checked_below(below, keys)
    return values if below is None else np.clip(values, 0, below - 1)


def _checked_below(below: int | None, keys: Memory) -> int | None:
    if below is None:
        return None
    if not is_int(below) or not 1 <= below <= 1 << 31:
        raise ShpyTypeError(f"below={below!r} is no int from 1 to 2**31", loc=here(), cure="below=number of keys")
    if not keys.type.is_int:
        raise ShpyTypeError(
            f"below={below} is for keys that are ints, and these are {keys.dtype}", loc=here(), cure="leave below out"
        )
    return int(below)


def keys_of(stream: Stream, key: Program | None, name: str) -> Memory:
    """Return the memory of the keys: those of `key`, or the elements themselves."""
    elements = stream if key is None else _computed(stream, key, name)
    entries = elements.leaf_entries()
    if len(entries) != 1 or entries[0].memory.type.size != 1:
        raise ShpyTypeError(
            f"{stream!r} has elements of several components, which have no order",
            loc=here(),
            cure=f"sh.{name}(stream, key=program), where the program gives one number for an element",
        )
    memory: Memory = entries[0].memory
    return memory


def _computed(stream: Stream, key: Any, name: str) -> Any:
    """Return the key of each element; ShpyTypeError unless `key` is a program from an element to a scalar."""
    cure = f"@sh.program of one {spoken_type(stream.type)} that gives one number"
    if not isinstance(key, Program):
        raise ShpyTypeError(f"sh.{name} takes a program as key, not {type(key).__name__}", loc=here(), cure=cure)
    inputs = list(key.inputs.values())
    if (
        len(inputs) != 1
        or isinstance(inputs[0], TableType | TextureType)
        or leaf_types(inputs[0]) != leaf_types(stream.type)
        or [cls.size for cls in key.outputs.values()] != [1]
    ):
        raise ShpyTypeError(f"{key!r} is no key for {stream!r}", loc=here(), cure=cure)
    return key.compile_for(stream)(stream)
