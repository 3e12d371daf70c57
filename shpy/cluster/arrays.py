"""Dask arrays as inputs: taken apart into leaves, and checked by their shapes, dtypes and chunks before anything runs.

Stage: cluster.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from shpy import packages
from shpy.errors import ShpyError, ShpyTypeError
from shpy.ir.constants import dtypes_at
from shpy.lang.data.hostdata import as_array
from shpy.lang.data.tables import TableType
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Layout, flatten, is_lazy, layout_of, leaves
from shpy.lang.values.value import with_article
from shpy.run import host
from shpy.streams.elements import InputLeaf, Shape, shape_before_data
from shpy.streams.stream import streams_in


def dask_array() -> Any:
    """Return the module `dask.array`; ShpyError with the command that installs it."""
    try:
        import dask.array
    except ImportError as error:
        raise ShpyError(
            "arrays in chunks need Dask", loc=here(), cure=packages.install("dask", "distributed")
        ) from error
    return dask.array


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """A leaf of an input that is cut into blocks: a Dask array (*shape[, size]); `shape` is that of its elements."""

    name: str
    size: int
    array: Any
    shape: Shape
    lazy: bool
    """False for an array of this process."""


def cut_leaves(layout: Layout, value: Any, name: str, precision: str) -> list[Any]:
    """Return each leaf of an input: a Cut for a Dask array, and for an array of several elements; others as they are.

    Raises ShpyTypeError for dtypes and component axes that do not fit, and for chunks across components or of unknown
    sizes.
    """
    parts = []
    for (path, _, cls), entry in zip(leaves(layout, name), host.entries_of_input(layout, value, name), strict=True):
        if not is_lazy(entry) and not _has_elements(entry, cls.size):
            InputLeaf(path, cls, host.exact(entry, precision, "strict"), _dtype(cls, precision))
            parts.append(entry)
            continue
        array = entry if is_lazy(entry) else dask_array().from_array(np.asarray(entry), chunks=-1)
        shape = shape_before_data(path, cls, array, _dtype(cls, precision))
        if len(shape) < array.ndim and len(array.chunks[-1]) > 1:
            raise ShpyTypeError(
                f"{path} is {with_article(cls)}, and its chunks {array.chunks[-1]} on the last axis cut the components "
                "of elements",
                loc=here(),
                cure=f"{path.partition('[')[0]}.rechunk({{-1: -1}})",  # m[0] is a row of an input m
            )
        parts.append(Cut(path, cls.size, array, shape, is_lazy(entry)))
    return parts


def _dtype(cls: Any, precision: str) -> Any:
    return dtypes_at(precision)[cls.base]


def _has_elements(entry: Any, size: int) -> bool:
    return isinstance(entry, np.ndarray | list) and np.ndim(entry) > (size > 1)


def has_lazy(value: Any) -> bool:
    """Return whether an input is or has a Dask array."""
    if isinstance(value, dict):
        return any(map(has_lazy, value.values()))
    return any(map(has_lazy, value)) if isinstance(value, tuple) else is_lazy(value)


def check_whole(name: str, value: Any, instead: str) -> None:
    """Raise ShpyTypeError for a Dask array as the input `name`, which a kernel reads at any index; name `instead`."""
    if has_lazy(value):
        raise ShpyTypeError(
            f"{name} is read at any index, and a worker has one block of a Dask array",
            loc=here(),
            cure=f"{name}.compute(), which each worker is sent, or {instead}",
        )


def whole_leaves(type_: TableType, value: Any, name: str, precision: str) -> list[Any]:
    """Return the arrays of a Table that is a Dask array, or has some, leaf by leaf; each becomes one chunk.

    Raises ShpyTypeError for dtypes, axes and chunks of unknown sizes that do not fit.
    """
    arrays, shapes = [], {}
    layout = layout_of(type_.cls, "an element")
    for (path, _, cls), entry in zip(leaves(layout, name), flatten(layout, value, name), strict=True):
        array = entry if is_lazy(entry) else dask_array().from_array(as_array(entry, path), chunks=-1)
        shapes[path] = shape = shape_before_data(path, cls, array, _dtype(cls, precision))
        if len(shape) != type_.rank or 0 in shape:
            axes = "1 axis" if type_.rank == 1 else f"{type_.rank} axes"
            raise ShpyTypeError(
                f"{name} is a {type_!r}, and the Dask array {path} has the shape {array.shape}",
                loc=here(),
                cure=f"an array of {axes} of elements, one or more on each",
            )
        arrays.append(array.rechunk(-1))
    if len(set(shapes.values())) > 1:
        listed = ", ".join(f"{path} {shape}" for path, shape in shapes.items())
        raise ShpyTypeError(
            f"{name} has fields of several shapes: {listed}", loc=here(), cure="one element of each field a place"
        )
    return arrays


def check_hosted(inputs: Mapping[str, Any], what: str) -> None:
    """Raise ShpyTypeError for streams: they lie on one device of this process."""
    stream = next(streams_in(iter(inputs.values())), None)
    if stream is not None:
        raise ShpyTypeError(
            f"{stream!r} lies on a device of this process, and sh.{what} runs on others",
            loc=here(),
            cure="stream.numpy(), or a Dask array of it",
        )


def unified(cuts: Sequence[Cut], shape: Shape) -> tuple[list[Any], tuple[tuple[int, ...], ...]]:
    """Return the arrays with chunks that agree where they broadcast, and the chunks of the elements."""
    rank = len(shape)
    pairs: list[Any] = []
    for number, cut in enumerate(cuts):
        labels = tuple(range(rank - len(cut.shape), rank))
        pairs += [cut.array, labels + ((rank + number,) if cut.array.ndim > len(cut.shape) else ())]
    chunks, arrays = dask_array().core.unify_chunks(*pairs)
    return list(arrays), tuple(chunks.get(axis, ()) for axis in range(rank))
