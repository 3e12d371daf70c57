"""Random structured programs: the interpreter, element by element, and numpy, all lanes at once, give the same bits."""

import random
from dataclasses import replace

import numpy as np
import pytest
from passes.random_ir import LOOP_LIMIT, Sizes, random_inputs, random_module

from shpy.backend.base import Call, Options
from shpy.backend.numpy.device.run import NumpyBackend
from shpy.ir.constants import encode
from shpy.ir.interpreter import Interpreter
from shpy.ir.nodes import Let, Param, Status
from shpy.ir.tabledata import TableData
from shpy.ir.traverse import limited_loops

DTYPES = {"a": np.float32, "v": np.float32, "k": np.int32, "h": np.uint32}
LANES = 12


def with_params(module, names):
    """The module with these inputs as params, so that what they reach is uniform."""
    entry = module.entry
    gone = [v for v in entry.inputs if v.name in names]
    lets = tuple(Let(v, "param", (), v.name) for v in gone)
    kept = [(v, port) for v, port in zip(entry.inputs, module.inputs, strict=True) if v.name not in names]
    params = tuple(Param(v.name, "any", v.type, encode(v.type, [0] * v.type.size)) for v in gone)
    return replace(
        module,
        inputs=tuple(port for _, port in kept),
        params=module.params + params,
        functions=(*module.functions[:-1], replace(entry, inputs=tuple(v for v, _ in kept), body=lets + entry.body)),
    )


def inputs_of(seed, uniform):
    """Inputs by name, the same for all lanes where uniform, and the tables."""
    each = [random_inputs(LANES * seed + lane) for lane in range(LANES)]
    given = {name: np.array([e[0][n] for e in each], DTYPES[name]) for n, name in enumerate("avkh")}
    for name in uniform:
        given[name][:] = given[name][0]
    return given, each[0][1]


def assert_same_bits(found, expected, told):
    expected = np.asarray(expected)
    if expected.dtype.kind == "f":
        nan = np.isnan(found) & np.isnan(expected)
        same = nan | (np.asarray(found).view(np.uint32) == expected.view(np.uint32))
    else:
        same = found == expected
    assert np.all(same), f"{told}: {found} instead of {expected}"


def compare(seed, sizes, tile):
    chooser = random.Random(seed)
    uniform = [name for name in "avkh" if chooser.random() < 0.3]
    module = random_module(seed, sizes)
    given, tables = inputs_of(seed, uniform)
    executable = NumpyBackend().compile(with_params(module, uniform), Options(loop_limit=LOOP_LIMIT), tile=tile)
    outputs = (np.zeros(LANES, np.float32), np.zeros((LANES, 3), np.float32), np.zeros(LANES, np.int32))
    call = Call(
        (LANES,),
        tuple(a for name, a in given.items() if name not in uniform),
        outputs,
        {"scale": np.float32(1.5)} | {name: given[name][0] for name in uniform},
        {name: TableData(array) for name, array in tables.items()},
    )
    statuses = executable.run(call)
    reference = Interpreter(module, loop_limit=LOOP_LIMIT)
    for lane in range(LANES):
        expected, status = reference.run_element([a[lane] for a in given.values()], None, tables)
        ended = Status.WRITTEN if statuses is None else statuses[lane]
        told = f"seed {seed}, lane {lane}"
        if min(status, ended) >= Status.FIRST_LOOP:
            line = limited_loops(module)[status - Status.FIRST_LOOP].loc
            assert executable.loops[ended - Status.FIRST_LOOP] == line, told
            continue
        assert ended == status, told
        for output, value in zip(outputs, expected, strict=True):
            assert_same_bits(output[lane], value, told)  # zeros where not written


@pytest.mark.sampled(20)
@pytest.mark.parametrize("start", range(0, 200, 10))
def test_random_programs(start):
    for seed in range(start, start + 10):
        compare(seed, Sizes(), 32_768)


@pytest.mark.parametrize("tile", [1, 5])
def test_the_tile_does_not_matter(tile):
    for seed in range(1000, 1006):
        compare(seed, Sizes(), tile)


def test_larger_programs():
    for seed in range(2000, 2004):
        compare(seed, Sizes(9, 5), 32_768)
