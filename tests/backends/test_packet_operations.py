"""Every operation of a type in one kernel of OpenCL: at one lane and in packets, for numbers and for vectors."""

import numpy as np
import pytest
from backends.test_opencl_ops import ELEMENTS, values
from backends.test_packets import same

from shpy.backends.base import Array, Call, Options
from shpy.backends.opencl import backend
from shpy.ir.builder import Builder
from shpy.ir.nodes import Module, Port
from shpy.ir.ops import OPS
from shpy.ir.types import vec
from shpy.testing.conformance.operations import meant


@pytest.mark.parametrize("base", "fdiub")
def test_every_operation_of_one_lane(base: str) -> None:
    check_every_operation(1, base, 1)


@pytest.mark.parametrize(("base", "size", "lanes"), [("f", 3, 4), ("d", 2, 1), ("i", 4, 4), ("u", 3, 1), ("b", 2, 4)])
def test_every_operation_on_vectors(base: str, size: int, lanes: int) -> None:
    check_every_operation(lanes, base, size)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("base", "fdiub")
@pytest.mark.parametrize("lanes", [16, 8])
def test_every_operation(lanes: int, base: str) -> None:
    check_every_operation(lanes, base, 1)


def check_every_operation(lanes: int, base: str, size: int) -> None:
    """All rows of the table for vectors of one base and size in one program, over special values."""
    b = Builder("ops")
    inputs: list[Array] = []
    cases = []
    for name, op in OPS.items():
        types = op.arguments(vec(base, size))
        if types is None:
            continue
        arrays = [np.ascontiguousarray(values(a, k, len(types)).T) for k, a in enumerate(types)]
        made = b.let(name, *(b.input(a) for a in types))
        b.store(b.output(made.type), made)
        inputs += arrays
        cases.append((name, meant(name, types, arrays)))
    function = b.finish()
    ports = tuple(Port(f"p{k}", "") for k in range(len(inputs)))
    module = Module("ops", ports, tuple(Port(f"r{k}", "") for k in range(len(cases))), (), (), (function,))
    outputs = tuple(np.zeros_like(expected) for _, expected in cases)
    backend.compile(module, Options(lanes=lanes)).run(Call((ELEMENTS,), tuple(inputs), outputs, {}, {}))
    for (name, expected), found in zip(cases, outputs, strict=True):
        same(found, expected, name)
