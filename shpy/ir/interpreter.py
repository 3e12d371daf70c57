"""Runs a module for one element: the executable meaning of the IR, against which everything else is measured.

Stage: represent. It takes a verified module, as recorded or lowered, and the data of one element; it gives the outputs
and the status. Operations are those of the op table, executed with numpy scalars and (size,) arrays of the working
precision. The tree is compiled into closures once, so that ten thousand iterations of a loop take a fraction of a
second.

    Interpreter(double).run_element([3.0])      # ([np.float32(6.0)], Status.WRITTEN), where double gives 2 * x
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from shpy.errors import ShpyTypeError
from shpy.ir.closures import Array, Compiler, LaneOracle, Run, Trace
from shpy.ir.constants import decode, dtypes_at
from shpy.ir.nodes import Module, Status
from shpy.ir.types import Type

__all__ = ["Interpreter", "LaneOracle", "Trace"]


class Interpreter:
    """A module, ready to run at a precision.

    `loop_limit` is how many iterations a loop without a known bound may take each time it is entered; an element that
    begins another iteration ends with status FIRST_LOOP + k, k counting as in `traverse.limited_loops`. None sets no
    limit. A module that gives its own status as a last output counts its iterations itself.
    """

    def __init__(
        self,
        module: Module,
        precision: Literal["f16", "f32", "f64"] = "f32",
        loop_limit: int | None = 1_048_576,
    ) -> None:
        self.module = module
        self.dtypes = dtypes_at(precision)
        self.has_status = len(module.entry.outputs) > len(module.outputs)
        self.loop_limit = None if self.has_status else loop_limit
        self._plain = self._compile(traced=False)
        self._traced: Compiler | None = None

    def run_element(
        self,
        inputs: Sequence[Any],
        params: Mapping[str, Any] | None = None,
        tables: Mapping[str, Any] | None = None,
        index: tuple[int, ...] = (),
        shape: tuple[int, ...] = (),
        trace: Trace | None = None,
        lane_oracle: LaneOracle | None = None,
    ) -> tuple[list[Any], int]:
        """Run one element.

        `inputs` are numbers or (size,) arrays in the entry's order; `params` by name, those left out at their initial
        value; `tables` by name, arrays (*shape[, size]) or objects with such an `array`; `index` and `shape` this
        element's place and the size of the run. Gives the outputs (zeros unless the status is WRITTEN) and the status.
        """
        if trace is not None and self._traced is None:
            self._traced = self._compile(traced=True)
        compiled = (self._traced if trace is not None and self._traced else self._plain).entry
        run = Run(self._params(params or {}), self._tables(tables or {}), index, shape, trace, lane_oracle)
        frame = compiled.frame(run)
        ports = self.module.entry.inputs
        if len(inputs) != len(ports):
            raise ShpyTypeError(f"{self.module.name} takes {len(ports)} inputs, not {len(inputs)}")
        for port, data in zip(ports, inputs, strict=True):
            frame[compiled.places[port.id]] = self.cast(port.type, data)
        status = compiled.run(frame)
        slots = self.module.entry.outputs
        if self.has_status and status == Status.WRITTEN:
            status = int(frame[compiled.slots[slots[-1].id]])
        written = status == Status.WRITTEN
        return [
            self.cast(slot.type, frame[compiled.slots[slot.id]] if written else np.zeros(slot.type.size))
            for slot in slots[: len(self.module.outputs)]
        ], status

    def cast(self, type: Type, data: Any) -> Any:
        """Return the data as an array of the type's shape and dtype; for a scalar type, as a numpy scalar."""
        dtype = self.dtypes[type.base]
        if type.size == 1 and data.__class__ is dtype:
            return data
        with np.errstate(all="ignore"):
            array = np.asarray(data).astype(dtype)
        return array.reshape(type.size) if type.size > 1 else array.reshape(())[()]

    def _compile(self, traced: bool) -> Compiler:
        return Compiler(self.module, self.dtypes, self.loop_limit, traced)

    def _params(self, values: Mapping[str, Any]) -> dict[str, Any]:
        return {
            param.name: self.cast(param.type, values.get(param.name, decode(param.type, param.value)))
            for param in self.module.params
        }

    def _tables(self, data: Mapping[str, Any]) -> dict[str, Array]:
        return {
            table.name: np.asarray(getattr(data[table.name], "array", data[table.name]), self.dtypes[table.type.base])
            for table in self.module.tables
        }
