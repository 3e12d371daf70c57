"""Collective operations on arrays: numpy's own functions, where their result is the one that is defined.

Stage: run.

    COLLECTIVES.sort(memory, False)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from shpy.backend.base import Array, Collectives, FoldPlaces
from shpy.backend.numpy.device.memory import NumpyMemory
from shpy.ir.nodes import Let, Module, Store
from shpy.ir.types import Base, vec
from shpy.passes.modes import Precision
from shpy.passes.promote import promote

_WORDS: Final = {1: np.uint8, 2: np.uint16, 4: np.uint32, 8: np.uint64}


def _indices(array: Array) -> NumpyMemory:
    return NumpyMemory(array.astype(np.int32), vec(Base.I))


def _select(mask: Any) -> NumpyMemory:
    return _indices(np.flatnonzero(mask.array))


def _take(sources: Sequence[Any], index: Any) -> list[NumpyMemory]:
    return [NumpyMemory(np.take(s.array, index.array, axis=0, mode="clip"), s.type) for s in sources]


def _put(values: Any, index: Any, target: Any) -> None:
    """Write values to the elements of `target` at an index; of several values for an element the last one stays."""
    kept = (index.array >= 0) & (index.array < target.count)
    winners = np.full(target.count, -1, np.int64)
    np.maximum.at(winners, index.array[kept], np.flatnonzero(kept))
    is_target = winners >= 0
    target.array[is_target] = values.array[winners[is_target]]


def words_in_order(array: Array, descending: bool) -> Array:
    """Return unsigned integers in the order of the numbers: NaN is the greatest, both zeros are equal."""
    word = np.dtype(_WORDS[array.itemsize])
    if array.dtype.kind == "f":
        top = word.type(1 << (8 * array.itemsize - 1))
        words = np.where(array == 0, word.type(0), array.view(word))
        words ^= np.where(words >= top, ~word.type(0), top)
        words[np.isnan(array)] = ~word.type(0)
    elif array.dtype.kind == "i":
        words = array.view(word) ^ word.type(1 << (8 * array.itemsize - 1))
    elif array.dtype.kind == "b":
        words = (array.view(word) != 0).view(word)  # a bool of numpy may have any byte for True
    else:
        words = array.view(word)
    return ~words if descending else words


def _order(keys: Any, descending: bool, below: int | None) -> NumpyMemory:
    if below is not None:
        keys = NumpyMemory(keys.array.clip(0, below - 1), keys.type)
    words = words_in_order(keys.array, descending)
    if words.itemsize != 4:
        return _indices(np.argsort(words, kind="stable"))
    # A sort of pairs is many times as fast as a sort of indices.
    pairs = words.astype(np.uint64) << np.uint64(32) | np.arange(len(words), dtype=np.uint64)
    pairs.sort()
    return _indices(pairs & np.uint64(0xFFFFFFFF))


def _sort(keys: Any, descending: bool) -> NumpyMemory:
    """Sort stably: +0 and -0, and NaNs of different bits, keep the order that they had."""
    array = keys.array
    result = np.sort(array)[::-1].copy() if descending else np.sort(array)
    if array.dtype.kind == "f":
        for alike in (array == 0, np.isnan(array)):
            some = array[alike]
            if len(some):
                result[result == 0 if some[0] == 0 else np.isnan(result)] = some
    return NumpyMemory(result, keys.type)


def _tally(numbers: Any, bins: int) -> NumpyMemory:
    kept = numbers.array[(numbers.array >= 0) & (numbers.array < bins)]
    return _indices(np.bincount(kept, minlength=bins))


def _fold_places(module: Module, precision: Precision) -> FoldPlaces | None:
    """Return numpy's own fold by place for a sum: 65,536 numbers take 0.08 of the time of a sort and programs.

    None for other programs, and at f16, where numpy rounds in its own way.
    """
    return _add_at_places if precision != "f16" and _is_sum(promote(module)) else None


def _is_sum(module: Module) -> bool:
    """Return whether a program of two elements adds each number of one to that of the other, and does nothing else."""
    entry = module.entry
    ids = [port.id for port in entry.inputs]
    firsts, seconds = ids[: len(ids) // 2], ids[len(ids) // 2 :]
    sums = {s.value.id: s.args for s in entry.body if isinstance(s, Let) and s.op == "add"}
    stored = {s.variable: sums.get(s.value) for s in entry.body if isinstance(s, Store) and s.components is None}
    pairs = list(zip(firsts, seconds, strict=True))
    return [stored.get(o.id) for o in entry.outputs] == pairs and len(entry.body) == 2 * len(pairs)


def _add_at_places(values: Sequence[Any], index: Any, targets: Sequence[Any]) -> None:
    """Add the values of each place in order. A sum begins with -0, to which any number is added without a change."""
    kept: Any = (index.array >= 0) & (index.array < targets[0].count)
    if kept.all():
        kept = slice(None)  # a view takes less time than a copy
    at = index.array[kept].astype(np.intp)
    has_value = np.zeros(targets[0].count, np.bool_)
    has_value[at] = True
    with np.errstate(all="ignore"):
        for value, target in zip(values, targets, strict=True):
            sums = np.full(target.array.shape, -0.0 if target.dtype.kind == "f" else 0, target.dtype)
            columns = (a.reshape(-1, target.type.size).T for a in (sums, value.array[kept]))
            for total, numbers in zip(*columns, strict=True):
                np.add.at(total, at, numbers)
            target.array[has_value] = sums[has_value]


COLLECTIVES: Final = Collectives(_select, _take, _put, sort=_sort, order=_order, tally=_tally, fold_places=_fold_places)
"""The operations of arrays. numpy's kernels make lists of elements by themselves."""
