"""Plans: what a call with arrays of known shapes and dtypes has to do, found out by the first such call.

Stage: run. Most calls of a kernel are like the one before: contiguous arrays of the same shapes, in the dtypes that the
kernel works with. Nothing of these has to be checked or converted again. All other calls go through `host`.

    plan = plan_of(recorded, dtypes, arrays, common, zeros=False)
    plans[signature(arrays)] = plan
    call, outputs = plan.begin(arrays, params, tables)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from shpy.backends.base import Call, TableData
from shpy.ir.types import Base
from shpy.lang.programs.record import Recorded
from shpy.lang.values.structure import Layout, Leaf, build_arrays, leaves

KEPT: Final = 64
"""Plans of a kernel, at most."""
_LARGEST: Final = float(np.finfo(np.float16).max)
"""The largest float that a plan converts: each precision has it."""

Array = NDArray[Any]
Shape = tuple[int, ...]


def signature(arrays: Sequence[Any]) -> tuple[Any, ...] | None:
    """Return the shapes and dtypes of contiguous arrays, `float` for a number; None where there is anything else."""
    found: list[Any] = []
    for array in arrays:
        if type(array) is np.ndarray and array.flags.c_contiguous:
            found.append((array.shape, array.dtype))
        elif type(array) is float and -_LARGEST < array < _LARGEST:
            found.append(float)
        else:
            return None
    return tuple(found)


@dataclass(frozen=True, slots=True)
class Plan:
    """The shapes of a call: of the run, of each flat input, and of each output with its flat form and dtype."""

    shape: Shape
    inputs: tuple[tuple[Shape, Any], ...]
    outputs: tuple[tuple[Shape, Shape, Any], ...]
    layout: Layout
    zeros: bool

    def begin(
        self, arrays: Sequence[Any], params: dict[str, Array], tables: dict[str, TableData], out: Any = None
    ) -> tuple[Call, Any] | None:
        """Return the call, and its outputs in the program's structure; None where `out` needs more checks."""
        flat = [
            array.reshape(shape) if type(array) is np.ndarray else np.full(shape, array, dtype)
            for array, (shape, dtype) in zip(arrays, self.inputs, strict=True)
        ]
        make: Any = np.zeros if self.zeros else np.empty
        if out is None:
            made = [make(shape, dtype) for shape, _, dtype in self.outputs]
            result = made[0] if type(self.layout) is Leaf else build_arrays(self.layout, iter(made))
        else:
            shape, _, dtype = self.outputs[0]
            fits = type(out) is np.ndarray and type(self.layout) is Leaf and out.shape == shape and out.dtype == dtype
            if not fits or not out.flags.carray or any(np.may_share_memory(out, array) for array in flat):
                return None
            made, result = [out], out
        written = tuple(a.reshape(shape) for a, (_, shape, _) in zip(made, self.outputs, strict=True))
        return Call(self.shape, tuple(flat), written, params, tables), result


def plan_of(
    recorded: Recorded, dtypes: Mapping[Base, Any], arrays: Sequence[Any], common: Shape, *, zeros: bool
) -> Plan | None:
    """Return the plan of a call that succeeded; None where an input has several leaves, is converted or broadcast."""
    types = list(recorded.inputs.values())
    if len(arrays) != len(types) or not common:
        return None
    inputs = []
    for array, type_ in zip(arrays, types, strict=True):
        if not isinstance(type_, Leaf):
            return None
        cls = type_.cls
        tail = (cls.size,) if cls.size > 1 else ()
        dtype = np.dtype(dtypes[cls.base])
        if isinstance(array, float):
            if tail or cls.base is not Base.F:
                return None
            inputs.append(((1,), dtype))
            continue
        shape = array.shape[: array.ndim - len(tail)]
        count = math.prod(shape)
        if array.dtype != dtype or array.shape[len(shape) :] != tail or (shape != common and count != 1):
            return None
        inputs.append(((count, *tail), dtype))
    outputs = []
    for _, _, cls in leaves(recorded.output, ""):
        tail = (cls.size,) if cls.size > 1 else ()
        outputs.append(((*common, *tail), (math.prod(common), *tail), np.dtype(dtypes[cls.base])))
    return Plan(common, tuple(inputs), tuple(outputs), recorded.output, zeros)
