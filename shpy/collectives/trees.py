"""The balanced binary tree over the elements of a stream: on a device in passes, on the host by slices.

Stage: run. At each level out[i] = f(in[2 i], in[2 i + 1]), and an odd last element passes unchanged, until one is left.
A pass on a device computes several levels, with the same combinations in the same order.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.backend.base import Memory, NodeTypes, Tree
from shpy.collectives.arguments import check_stream
from shpy.collectives.programs import Lift, folding, lifted_pairs, lifting, over_structs, width_for
from shpy.errors import ShpyTypeError
from shpy.ir.nodes import Discard, Let
from shpy.ir.traverse import walk
from shpy.ir.types import vec
from shpy.lang.data.tables import Table, TableType
from shpy.lang.data.textures import TextureType
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Leaf, layout_of, leaves, spoken_type
from shpy.lang.values.types import Attrib1i
from shpy.lang.values.value import CLASSES
from shpy.programs import Program
from shpy.streams.stream import Place, Stream

Shape = tuple[int, ...]
_FEW = 64
"""The least number of elements for which a program over vectors of four is worth its compilation."""
_LARGEST = 2**31 - 64
"""The most elements of which all indices, and those of neighbours behind the last element, are ints of 32 bits."""


def retyped(stream: Stream, type_: Any, shape: Shape) -> Stream:
    """Return a stream over the same memory with another shape and another type, which has the same leaves."""
    return Stream.over(type_, shape, stream.place, [leaf.memory for leaf in stream.leaf_entries()])


def combination(program: Any, stream: Any, name: str) -> tuple[Program, Any]:
    """Return a program(a, b) -> a over structs or values, and its type; ShpyTypeError if it does not fit the stream.

    The type has the leaves of an element of the stream.
    """
    check_combination(program, stream, name)
    return over_structs(program)


def check_combination(program: Any, stream: Any, name: str) -> None:
    """Raise ShpyTypeError where a program(a, b) -> a does not fit the stream."""
    check_stream(stream, f"sh.{name}")
    if stream.size > _LARGEST:
        raise ShpyTypeError(
            f"sh.{name} takes {_LARGEST:,} elements at most, not {stream.size:,}",
            loc=here(),
            cure="several streams",
        )
    if not isinstance(program, Program):
        raise ShpyTypeError(
            f"sh.{name} takes a program of two elements, not {type(program).__name__}",
            loc=here(),
            cure="@sh.program before the function",
        )
    if not _fits(program, stream.type):
        element = spoken_type(stream.type)
        raise ShpyTypeError(
            f"sh.{name} combines two elements of {stream!r} into one, and {program!r} does not",
            loc=here(),
            cure=f"{program.name}(a: {element}, b: {element}) -> {element}",
        )
    _check_body(program, name)


@lru_cache(maxsize=256)
def _fits(program: Program, type_: Any) -> bool:
    """Return whether the program takes two elements of a type and returns one."""
    element = leaf_types(type_)
    inputs = program.inputs.values()
    types = [None if isinstance(t, TableType | TextureType) or t is None else leaf_types(t) for t in inputs]
    return types == [element, element] and [cls.type for cls in program.outputs.values()] == element


@lru_cache(maxsize=256)
def _check_body(program: Program, name: str) -> None:
    for function in program.ir.functions:
        for statement in walk(function.body):
            op = statement.op if isinstance(statement, Let) else "SH_DISCARD"
            if isinstance(statement, Discard) or (isinstance(statement, Let) and op in ("grid_index", "grid_shape")):
                raise ShpyTypeError(
                    f"{program.name} uses {op}, and sh.{name} combines elements, wherever they stand",
                    loc=statement.value.loc if isinstance(statement, Let) else statement.loc,
                    cure="elements that hold their index, and a program of these",
                )


def leaf_types(type_: Any) -> list[Any]:
    """Return the IR type of each leaf of a type of the language."""
    return [cls.type for _, _, cls in leaves(layout_of(type_, "an element"), "")]


def fold(stream: Stream, combine: Program, value_type: Any = None, lift: Lift | None = None) -> Stream:
    """Reduce a stream of shape (n,), or (a, n, b) along its middle axis, to (1,) or (a, 1, b); n is at least 1.

    `lift` converts each element and its index along the axis to a value of type `value_type`, which `combine` takes.
    """
    value_type = stream.type if value_type is None else value_type
    axis = len(stream.shape) // 2
    before, after = stream.shape[:axis], stream.shape[axis + 1 :]
    if not stream.size:
        return Stream.empty((*before, 1, *after), value_type, *stream.place)
    if stream.shape[axis] == 1 and lift is None:
        return stream
    if stream.place.space.on_host:
        return _fold_on_host(stream, combine, value_type, lift)
    own = None if before else own_tree(stream.place, combine, stream.type, value_type, lift)
    if own is not None:
        return _fold_by(own, stream, combine, value_type)
    width = width_for(combine)
    while stream.shape[axis] > 1 or lift is not None:
        shape = (*before, -(-stream.shape[axis] // width), *after)
        stream = run_level(stream, shape, combine, value_type, lift, width)
        lift = None
    return stream


@lru_cache(maxsize=256)
def own_tree(place: Place, combine: Program, element: Any, value_type: Any, lift: Lift | None) -> Tree | None:
    """Return the device's own implementation of fold and scan for a program; None if it has none."""
    tree = place.space.collectives.tree
    if tree is None:
        return None
    types = NodeTypes(tuple(leaf_types(element)), tuple(leaf_types(value_type)), lift is not None)
    both = combine if lift is None else lifted_pairs(lift, combine, element, value_type)
    return tree(both.ir, types, place.precision)


def memories_of(stream: Stream) -> list[Memory]:
    """Return the memory of each leaf of a stream."""
    return list(stream._memories)


def fold_parts(own: Tree, stream: Stream, value_type: Any) -> Stream:
    """Reduce each part of a stream (n,) to one element, by the device's own kernels."""
    parts = Stream.fresh((-(-stream.size // own.each(stream.size)),), value_type, stream.place)
    own.fold(memories_of(stream), memories_of(parts))
    return parts


def _fold_by(own: Tree, stream: Stream, combine: Program, value_type: Any) -> Stream:
    parts = fold_parts(own, stream, value_type)
    return parts if parts.size == 1 else fold(parts, combine, value_type)


def fold_to_host(stream: Stream, combine: Program, value_type: Any = None, lift: Lift | None = None) -> Stream:
    """Reduce a stream (n,) to a stream (1,) on the host: see `fold`."""
    value_type = stream.type if value_type is None else value_type
    place = stream.place
    own = None if place.space.on_host or not stream.size else own_tree(place, combine, stream.type, value_type, lift)
    if own is None:
        return fold(stream, combine, value_type, lift).to("numpy")
    host = Place("numpy", 0, place.precision)
    types = leaf_types(value_type)
    arrays = own.reducing(memories_of(stream))()
    memories = [host.space.wrap(a, t, a.dtype) for a, t in zip(arrays, types, strict=True)]
    return Stream.over(value_type, (1,), host, memories)


def run_level(stream: Stream, shape: Shape, combine: Program, value_type: Any, lift: Lift | None, width: int) -> Stream:
    """Run a pass that combines `width` neighbours on the only axis, or on the middle one of 3."""
    fours = in_fours(stream)
    level = folding(
        combine, stream.type, value_type, lift, len(stream.shape), width, None if fours is None else fours.type
    )
    tables = [Table(stream)] if fours is None else [Table(stream), Table(fours)]
    result: Stream = level.compile_for(stream)(*tables, shape=shape)
    return result


def in_fours(stream: Stream) -> Stream | None:
    """Return the memory of a stream (n,) of scalars as a stream of vectors of four, each of which is a single load.

    Returns None if the elements are not scalars, are few, or do not lie contiguously. It serves OpenCL devices without
    trees of their own, such as GPUs: as one (PoCL, CPU time), a reduction of 10**7 floats takes 1.8 times as long
    without it, and a scan of 10**6 floats 1.3 times.
    """
    leaf, *others = stream.leaf_entries()
    type_ = leaf.memory.type
    if others or len(stream.shape) != 1 or type_.size != 1 or type_.is_bool or stream.size < _FEW:
        return None
    memory = stream.place.space.view(leaf.memory, vec(type_.base, 4), stream.size // 4)
    if memory is None:
        return None
    return Stream.over(CLASSES["Attrib", 4, type_.base], (memory.count,), stream.place, [memory])


def arrays_of(stream: Stream) -> list[NDArray[Any]]:
    """Return the arrays (a, n, b, N) of the leaves of a stream on the host."""
    whole = (1, *stream.shape, 1) if len(stream.shape) == 1 else stream.shape
    arrays = [leaf.memory.native for leaf in stream.leaf_entries()]
    return [array.reshape(*whole, *array.shape[1:]) for array in arrays]


def over_arrays(arrays: list[NDArray[Any]], type_: Any, like: Stream) -> Stream:
    """Return a stream on the host over arrays (a, n, b, N), which are copied where they are not contiguous."""
    shape: Shape = arrays[0].shape[:3]
    memories = [
        like.place.space.wrap(np.ascontiguousarray(a).reshape(math.prod(shape), *a.shape[3:]), cls.type, a.dtype)
        for a, (_, _, cls) in zip(arrays, leaves(layout_of(type_, "an element"), ""), strict=True)
    ]
    return Stream.over(type_, shape, like.place, memories)


def run_pairs(
    combine: Program, firsts: list[NDArray[Any]], seconds: list[NDArray[Any]], type_: Any, like: Stream
) -> list[NDArray[Any]]:
    """Combine arrays (a, n, b, N) of the leaves of a type element by element on the host."""
    if not firsts[0].size:
        return firsts
    kernel = combine.compile_for(like)
    if isinstance(layout_of(type_, "an element"), Leaf):
        first, second = (np.ascontiguousarray(arrays[0]) for arrays in (firsts, seconds))
        return [np.asarray(kernel(first, second)).reshape(first.shape)]
    pairs = (over_arrays(arrays, type_, like) for arrays in (firsts, seconds))
    return arrays_of(kernel(*pairs))


def _fold_on_host(stream: Stream, combine: Program, value_type: Any, lift: Lift | None) -> Stream:
    shape = stream.shape if len(stream.shape) == 3 else (1, *stream.shape, 1)
    if lift is not None:
        index = np.arange(shape[1], dtype=np.int32).reshape(1, -1, 1)
        lifted = lifting(lift, stream.type, value_type).compile_for(stream)
        places = over_arrays([np.broadcast_to(index, shape).copy()], Attrib1i, stream)
        stream = lifted(retyped(stream, stream.type, shape), places)
    arrays = arrays_of(stream)
    while arrays[0].shape[1] > 1:
        whole = arrays[0].shape[1] // 2 * 2
        firsts, seconds = ([a[:, k:whole:2] for a in arrays] for k in (0, 1))
        made_pairs = run_pairs(combine, firsts, seconds, value_type, stream)
        if whole < arrays[0].shape[1]:
            made_pairs = [np.concatenate((p, a[:, whole:]), axis=1) for p, a in zip(made_pairs, arrays, strict=True)]
        arrays = made_pairs
    return over_arrays(arrays, value_type, stream)
