"""Random structured programs: the interpreter and OpenCL give the same bits, whatever shape the printer finds."""

from typing import Any

import numpy as np
import pytest
from passes.random_ir import LOOP_LIMIT, Sizes, random_inputs, random_module

from shpy.backend.base import Call, Options
from shpy.backend.opencl.device.building import backend
from shpy.ir.constants import DTYPES, to_array
from shpy.ir.interpreter import Interpreter
from shpy.ir.nodes import Status
from shpy.ir.tabledata import TableData
from shpy.passes import pipeline

ELEMENTS = 16


def same(found: Any, expected: Any) -> bool:
    if found.dtype.kind != "f":
        return bool(np.all(found == expected))
    nan = np.isnan(found) & np.isnan(expected)
    return bool(np.all(nan | (found == expected) & (np.signbit(found) == np.signbit(expected))))


def compare(seed: int, sizes: Sizes) -> None:
    module = random_module(seed, sizes)
    entry = module.entry
    each = [random_inputs(1000 * seed + k)[0] for k in range(ELEMENTS)]
    columns = zip(zip(*each, strict=True), entry.inputs, strict=True)
    inputs = tuple(np.array(values, DTYPES[i.type.base]) for values, i in columns)
    tables = {name: TableData(array) for name, array in random_inputs(seed)[1].items()}
    params = {p.name: to_array(p.type, p.value) for p in module.params}
    outputs = tuple(
        np.zeros((ELEMENTS, o.type.size)[: min(2, o.type.size)], DTYPES[o.type.base]) for o in entry.outputs
    )
    executable = backend.compile(module, Options(loop_limit=LOOP_LIMIT, lanes=1))
    status = executable.run(Call((ELEMENTS,), inputs, outputs, params, tables))
    reference = Interpreter(module, loop_limit=LOOP_LIMIT)
    for k in range(ELEMENTS):
        expected, ended = reference.run_element([a[k] for a in inputs], params, tables, (k,), (ELEMENTS,))
        assert (Status.WRITTEN if status is None else status[k]) == ended
        if ended == Status.WRITTEN:
            for output, value, slot in zip(outputs, expected, entry.outputs, strict=True):
                assert same(output[k], value), f"{slot.name} of element {k}: {output[k]}, not {value}"


@pytest.mark.sampled(18)
@pytest.mark.parametrize("seed", range(40))
def test_random_programs(seed: int) -> None:
    compare(seed, Sizes())


@pytest.mark.sampled(12)
@pytest.mark.parametrize("seed", range(40, 60))
def test_random_programs_as_they_were_recorded(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing promoted, folded or removed: the printer meets dead values, dead code and stores of everything."""
    monkeypatch.setattr(pipeline, "optimise", lambda module: module)
    compare(seed, Sizes())
