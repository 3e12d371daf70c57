"""Functions that emitted code calls and numpy lacks: gathers, arrays of a lane's own, vectors from components.

Stage: run. A scalar that varies is an array (lanes,), a vector (size, lanes); a uniform one () or (1,), and (size, 1).
A local array is (length, lanes) or (length, size, lanes), with 1 for `lanes` while it is uniform. No index
raises an error: indices are clamped on reading, and stores out of range are dropped.

>>> vector(np.float32([1, 2]), np.float32(3))
array([[1., 2.],
       [3., 3.]], dtype=float32)
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.ir import meaning

__all__ = [
    "clamp",
    "compact",
    "component",
    "dot",
    "few",
    "fold",
    "half",
    "iterations_of",
    "joined",
    "lane_count",
    "maximum",
    "minimum",
    "normalize",
    "on_components",
    "pick",
    "put",
    "put_aside",
    "reflect",
    "select",
    "splat",
    "spread",
    "vector",
]

Array = NDArray[Any]

FEW = 2048
"""Up to this many lanes, numpy takes longer to start a function than to compute."""
MANY = 16_384
"""From here on the rows of several vectors do not fit a cache beside each other: `dot` by rows takes 0.75 to 0.89."""
MANY_ROWS = 16
"""From here on a reduction takes 0.06 to 0.75 of an operation for each row, and of 8 rows 1.4 (numpy 2.4)."""
TOGETHER = 65_536
"""Lanes times iterations of a loop that are computed together: numpy reuses temporaries of this size."""


def vector(*scalars: Array) -> Array:
    """Return the vector with these components."""
    shape = np.broadcast(*scalars).shape
    result = np.empty((len(scalars), *(shape or (1,))), scalars[0].dtype)
    for row, scalar in zip(result, scalars, strict=True):
        row[...] = scalar
    return result


def joined(*parts: Array) -> Array:
    """Return the vector of the components of scalars, and of vectors, one after the other."""
    return vector(*(row for p in parts for row in (p if p.ndim > 1 else (p,))))


def splat(scalar: Array, size: int) -> Array:
    """Return the vector of `size` equal components."""
    result = np.empty((size, *(scalar.shape or (1,))), scalar.dtype)
    result[...] = scalar
    return result


def spread(value: Array, lanes: int | tuple[int, int]) -> Array:
    """Return a uniform value, given to every lane, or to every place of a block."""
    value = np.asarray(value)
    result = np.empty((*value.shape[:-1], *(lanes if isinstance(lanes, tuple) else (lanes,))), value.dtype)
    result[...] = value
    return result


def lane_count(*args: Array) -> int:
    """Return the number of lanes of these values."""
    return max((int(np.shape(a)[-1]) for a in args if np.ndim(a)), default=1)


def half(x: Array) -> Array:
    """Return the nearest binary16, kept as binary32."""
    return x.astype(np.float16).astype(np.float32)


def component(v: Array, i: Array) -> Array:
    """Return the component of a vector at an index of each lane, clamped."""
    return np.asarray(pick(v, i))


def on_components(f: Any, *args: Array) -> Array:
    """Return a function of vectors applied to scalars, as vectors of one component."""
    values = f(*(np.asarray(a)[None] for a in args))
    return np.asarray(values[0] if values.ndim == max(np.ndim(a) for a in args) + 1 else values)


def select(mask: Array, a: Any, b: Any) -> Array:
    """Return `np.where(mask, a, b)`, computed on the bits, which takes 0.15 of the time for random masks."""
    if mask.size < FEW:
        return np.asarray(np.where(mask, a, b))
    dtype = np.result_type(a, b)
    bits = np.dtype(f"i{dtype.itemsize}")
    x, y = np.asarray(a, dtype).view(bits), np.asarray(b, dtype).view(bits)
    chosen: Array = (x ^ y) * mask
    chosen ^= y
    return np.asarray(chosen.view(dtype))


def minimum(a: Any, b: Any) -> Array:
    """Compute the operation `min`; at most one operand is a literal."""
    return _bounded(np.fmin, a, b, np.less_equal) if _is_literal(b) else select((b < a) | (a != a), b, a)


def maximum(a: Any, b: Any) -> Array:
    """Compute the operation `max`; at most one operand is a literal."""
    return _bounded(np.fmax, a, b, np.greater_equal) if _is_literal(b) else select((a < b) | (a != a), b, a)


def clamp(x: Any, low: Any, high: Any) -> Array:
    """Compute the operation `clamp`; the bounds may be literals."""
    return minimum(maximum(x, low), high)


def _is_literal(b: Any) -> bool:
    return type(b) is float and b == b  # numpy's binary64 is a subclass of float


def _bounded(extremum: np.ufunc, x: Array, bound: float, within: np.ufunc) -> Array:
    """Return x, or the bound where x is beyond it; numpy's own function leaves zeros of two signs open."""
    if bound == 0.0:
        keep = within(x, bound)
        if np.size(keep) < FEW or np.signbit(bound):
            return np.asarray(np.where(keep, x, np.asarray(bound, x.dtype)))
        return np.asarray((x.view(f"i{x.dtype.itemsize}") * keep).view(x.dtype))
    return np.asarray(extremum(x, bound))


def dot(a: Array, b: Array) -> Array:
    """Compute the op `dot`, row by row where the products of all rows would fill the cache."""
    if a.shape != b.shape or a.ndim < 2 or a.shape[-1] < MANY:
        return np.asarray(meaning.dot(a, b))
    total: Array = a[0] * b[0]
    product = np.empty_like(total)
    for x, y in zip(a[1:], b[1:], strict=True):
        total += np.multiply(x, y, out=product)
    return total


def reflect(i: Array, n: Array) -> Array:
    """Compute the op `reflect`."""
    return np.asarray(i - 2.0 * dot(n, i) * n)


def normalize(v: Array) -> Array:
    """Compute the op `normalize`, by a division alone where no vector is zero, or too large or small to be squared."""
    squares = dot(v, v)
    return np.asarray(v / np.sqrt(squares) if meaning.in_range(squares) else meaning.normalize(v))


def iterations_of(start: Any, stop: Any, step: int, lanes: int | tuple[int, int]) -> Iterator[Array]:
    """Give the counter's values, shaped (iterations, 1) or (iterations, 1, 1), as many at a time as fill TOGETHER."""
    every, dtype = range(int(start), int(stop), step), np.asarray(start).dtype
    each, axes = max(1, TOGETHER // max(1, int(np.prod(lanes)))), np.size(lanes)
    for first in range(0, len(every), each):
        yield np.array(every[first : first + each], dtype).reshape(-1, *[1] * axes)


def fold(operation: np.ufunc, total: Array, terms: Array) -> Array:
    """Return the total after an operation with each row of `terms`, in order, as a loop over the rows would give it.

    numpy reduces the first of several axes in order, row by row; along a single one it would sum in pairs.
    """
    first = np.asarray(operation(total, terms[0]))
    if len(terms) >= MANY_ROWS and first.size > 1 and terms.flags.carray and first.shape == terms.shape[1:]:
        kept, terms[0] = terms[0].copy(), first
        result = operation.reduce(terms, axis=0)
        terms[0] = kept
        return np.asarray(result)
    result = first
    for row in terms[1:]:
        operation(result, row, out=result)
    return result


def few(live: Array) -> bool:
    """Return whether going on with the live lanes alone saves more than it costs: under three quarters are left."""
    return bool(4 * np.count_nonzero(live) < 3 * live.size)


def put_aside(whole: Array, lane: Array, leaving: Array, value: Array) -> None:
    """Put the value of the leaving lanes, whose numbers outside the loop are in `lane`, into the array of all lanes.

    A mask may hold what is the same for all lanes, as any variable may.
    """
    if leaving.shape != lane.shape:  # the shapes are asked for because broadcast_to takes longer than all the rest
        leaving = np.broadcast_to(leaving, lane.shape)
    at = leaving.nonzero()[0]
    into = lane.take(at)
    for k in range(len(whole)) if whole.ndim > 1 else (...,):
        row = value[k] if np.ndim(value) > 1 else value
        whole[k][into] = row.take(at) if np.size(row) > 1 else row


def compact(live: Array, *values: Array) -> list[Array]:
    """Return the live lanes of each value; a uniform value, without lanes, stays as it is."""
    index, lanes = live.nonzero()[0], live.size
    # Shapes are asked for in place: a call of lane_count for each value takes longer than all else.
    return [v.take(index, axis=-1) if (v.shape[-1] if v.ndim else 1) == lanes else v for v in values]


@lru_cache(maxsize=16)
def _lane_numbers(lanes: int) -> Array:
    return np.arange(lanes)


def _is_uniform(index: Array) -> bool:
    return index.ndim == 0 or index.shape[0] == 1


def clamp_index(i: Array, length: int) -> Array:
    """Return indices clamped to 0 .. length - 1.

    np.clip takes 12 microseconds for any number of lanes up to thousands; for a few these two operations take 1.5.
    """
    return np.asarray(np.minimum(np.maximum(i, 0), length - 1) if i.size < FEW else np.clip(i, 0, length - 1))


def pick(a: Array, i: Array) -> Array:
    """Return the element of a local array at `i`, clamped."""
    if _is_uniform(i):
        return np.array(a[min(max(int(i.item()), 0), len(a) - 1)])
    clamped = clamp_index(i, len(a)).astype(np.intp)
    lane = 0 if a.shape[-1] == 1 else _lane_numbers(a.shape[-1])
    element: Array = a[clamped, lane] if a.ndim == 2 else np.ascontiguousarray(a[clamped, :, lane].T)
    return element


def put(a: Array, i: Array, value: Array, components: tuple[int, ...] | None = None) -> None:
    """Store `value`, or some components, into the element of a local array at `i`; dropped where out of range."""
    length = len(a)
    if _is_uniform(i):
        n = int(i.item())
        if not 0 <= n < length:
            return
        if components is None:
            a[n] = value
        else:
            a[n, list(components)] = value
        return
    lane = ((i >= 0) & (i < length)).nonzero()[0]
    if np.shape(value)[-1:] != i.shape:  # the shapes are asked for because broadcast_to takes longer than all the rest
        value = np.broadcast_to(value, (*np.shape(value)[:-1], len(i)))
    element, value = i.take(lane), value.take(lane, axis=-1)
    if a.ndim == 2:
        a[element, lane] = value
        return
    stored = range(a.shape[1]) if components is None else components
    rows = value if value.ndim == 2 else value[None]
    for row, k in zip(np.broadcast_to(rows, (len(stored), *rows.shape[1:])), stored, strict=True):
        a[element, k, lane] = row
