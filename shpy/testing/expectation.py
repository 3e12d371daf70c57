"""The run that a reference expects: an array, or a function of the inputs, in the place of a backend's run.

Stage: test. Takes a `Setting` and the reference that `assert_equivalent` is called with; gives a `Run`.

    reference_run(setting, np.expm1, run)        # numpy's binary64, rounded to the type of the output
"""

from __future__ import annotations

import contextlib
import reprlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import numpy as np

from shpy.errors import ShpyTypeError
from shpy.lang.recording.location import here
from shpy.lang.values.structure import flatten
from shpy.testing.arrays import Array
from shpy.testing.observers import Setting
from shpy.testing.runs import Run

REFERENCE: Final = "reference"
"""The target's name of such a run."""
_CURE: Final = "an array or a function of the inputs, with a part for each output"


def reference_run(setting: Setting, reference: Any, run: Run) -> Run:
    """Return the run that the reference expects, with the types and sizes of `run`.

    A function is called once, with the inputs by position: arrays that broadcast, floats rounded to the working
    precision and then held in binary64. One of mpmath is called for each element. Masked elements (`numpy.ma`) are
    expected to be discarded. Raises ShpyTypeError for a function that raises TypeError or ValueError, for a reference
    that has another shape than the outputs, or is no numbers, or has fractions for an output of integers.
    """
    values = _computed(reference, setting.arrays()) if callable(reference) else reference
    parts = flatten(setting.program.recorded.output, values, "the reference")
    written = np.ones(run.written.size, np.bool_)
    for part in parts:
        mask: Array = np.ma.getmaskarray(part) if isinstance(part, np.ma.MaskedArray) else np.zeros((), np.bool_)
        if mask.ndim > len(setting.element_shape):  # a mask of components
            mask = np.asarray(mask.any(axis=-1))
        written &= ~_broadcast(mask, setting.element_shape, written.size)[:, 0]
    outputs = tuple(
        np.where(written[:, None], _leaf(part, one, setting.element_shape, name), one)
        for part, one, name in zip(parts, run.outputs, setting.program.outputs, strict=True)
    )
    return replace(run, target=REFERENCE, outputs=outputs, written=written, notes=())


def _computed(function: Callable[..., Any], arrays: list[Any]) -> Any:
    if (getattr(function, "__module__", None) or "").startswith("mpmath."):
        return np.vectorize(function, otypes=[object])(*arrays)
    try:
        return function(*arrays)
    except (TypeError, ValueError) as error:
        name = getattr(function, "__name__", repr(function))
        raise ShpyTypeError(
            f"the reference {name} raises {type(error).__name__}: it is called once, with arrays",
            loc=here(),
            cure=f"np.vectorize({name}), where it takes one number at a time",
        ) from error


def _leaf(part: Any, one: Array, shape: tuple[int, ...], name: str) -> Array:
    """Return the reference of one leaf as (n, size) numbers of the type of `one`."""
    numbers = np.ma.getdata(part) if isinstance(part, np.ma.MaskedArray) else np.asarray(part)
    if numbers.dtype == object:  # numbers of mpmath
        with contextlib.suppress(TypeError, ValueError):
            numbers = numbers.astype(np.float64)
    if numbers.dtype.kind not in "fiub":
        spoken = reprlib.repr(numbers.ravel().tolist()[0])
        raise ShpyTypeError(f"the reference of output {name} has {spoken}, no number", loc=here(), cure=_CURE)
    size = one.shape[1]
    try:
        whole = _broadcast(numbers, (*shape, size) if size > 1 else shape, len(one))
    except ValueError:
        expected = (*shape, size) if size > 1 else shape
        raise ShpyTypeError(
            f"the reference of output {name} has the shape {numbers.shape}, and the output {expected}",
            loc=here(),
            cure=_CURE,
        ) from None
    with np.errstate(all="ignore"):
        rounded = whole.astype(one.dtype)
    if one.dtype.kind != "f" and not np.array_equal(rounded, whole):
        fraction = whole[rounded != whole].ravel()[0]
        raise ShpyTypeError(
            f"the reference of output {name} is {fraction} at an element, and the output is of {one.dtype}",
            loc=here(),
            cure=f"np.asarray(reference).astype(np.{one.dtype})",
        )
    return rounded


def _broadcast(array: Array, shape: tuple[int, ...], count: int) -> Array:
    """Return an array that is broadcast to this shape, as (count, components)."""
    return np.broadcast_to(array, shape).reshape(count, -1 if count else 1)
