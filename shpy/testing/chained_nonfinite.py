"""The first NaN or infinity of a chain: which run of which kernel wrote it into a stream.

Stage: test. `nonfinite.first_nan` asks for the `OddRun` of a chain, and searches its kernel like any program. The chain
is run once, one kernel at a time, and the streams of a kernel are read before and after each of its runs.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from shpy.chains.chain import Chain
from shpy.chains.member import Member, Node, is_gathered
from shpy.chains.running import Run
from shpy.errors import LoopLimitExceeded
from shpy.ieee import in_ieee_arithmetic
from shpy.lang.data.tables import TableType
from shpy.passes.modes import Precision
from shpy.programs import Program
from shpy.run.host import table_of
from shpy.run.kernel import Kernel
from shpy.streams.elements import Shape
from shpy.streams.stream import Place, Stream
from shpy.testing.arrays import Array, flat_leaves
from shpy.testing.divergence import check_element

KINDS: Final[Mapping[str, Callable[[Any], Array]]] = {"nan": np.isnan, "infinite": np.isinf}
"""The tests of NaN and of infinity: the first kind that outputs have is the one to search."""


@dataclass(frozen=True)
class OddRun:
    """A run of a kernel after which the `element` of a stream, in C order, is of a `kind` of KINDS.

    `number` counts the runs of this kernel from 1. `inputs` are the data of that run by name: arrays, Tables, textures.
    """

    kind: str
    member: Member
    number: int
    element: int
    shape: Shape
    inputs: dict[str, Any]
    place: Place

    @property
    def program(self) -> Program:
        """The kernel's program, with the condition under which the chain runs its elements."""
        return Program(self.member.recorded)

    @property
    def options(self) -> dict[str, Any]:
        """The options of `Program.compile` with which the kernel runs."""
        kernel = self.member.kernel
        if isinstance(kernel, Kernel):
            names = ("precision", "device", "math", "loop_limit", "fuse")
            return {name: getattr(kernel.options, name) for name in names}
        return {"precision": self.place.precision, "device": self.place.device}


@in_ieee_arithmetic
def first_odd_run(
    chain: Chain,
    element: int | None,
    *,
    shape: Any = None,
    backend: str | None = None,
    device: int | None = None,
    precision: Precision | None = None,
    **streams: Any,
) -> OddRun | None:
    """Return the run that wrote the first NaN, where the streams end with one, or else the first infinity; or None.

    `element` restricts it to that number in C order; the other arguments are those of `Chain.run`.
    """
    run = _ReadRun(element, chain, streams, shape, backend, device, precision)
    try:
        result = run.result()
    except LoopLimitExceeded as error:
        result = error.result
    check_element(element, run.largest)
    for kind in KINDS:
        if any(_odd([stream], stream.size, element)[kind].any() for stream in result.streams.values()):
            return run.first.get(kind) or run.carried.get(kind)
    return None


class _ReadRun(Run):
    """A run of a chain that reads the streams of each kernel before and after it.

    `carried` has for each kind the first run after which an element is of this kind. `first` has the first run before
    which that element was not: no NaN (finite) in every stream that the kernel reads by element or replaces.
    """

    def __init__(self, element: int | None, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.first: dict[str, OddRun] = {}
        self.carried: dict[str, OddRun] = {}
        self.largest = 0
        self._element = element
        self._numbers: Counter[Any] = Counter()

    def play(self, node: Node) -> None:
        """Run each kernel of a part once, by itself."""
        for member in node.kernels:
            self.flush()
            shape = self._shape_of(member)
            self.largest = max(self.largest, math.prod(shape))
            values = {name: self._input(name, member) for name in member.inputs if self._has(name)}
            read = [value for name, value in values.items() if not is_gathered(member.inputs[name])]
            names = [name for name, _ in member.outputs]
            replaced = [self.current[name] for name in names if name in self.current]
            before = _odd([*read, *replaced], math.prod(shape))
            inputs = {name: _on_host(name, value, member) for name, value in values.items()}
            super().play(member)
            self.flush()
            self._numbers[member.original] += 1
            after = _odd([self.current[name] for name in names], math.prod(shape), self._element)
            new = {
                "nan": after["nan"] & ~before["nan"],
                "infinite": after["infinite"] & ~(before["nan"] | before["infinite"]),
            }
            for runs, odd in ((self.first, new), (self.carried, after)):
                for kind, places in odd.items():
                    if places.any() and kind not in runs:
                        number = self._numbers[member.original]
                        runs[kind] = OddRun(kind, member, number, int(np.argmax(places)), shape, inputs, self.place)


def _on_host(name: str, value: Any, member: Member) -> Any:
    """Return a copy of the data of an input: an array, or a Table where the kernel reads a stream by index."""
    type_ = member.inputs[name]
    if not isinstance(value, Stream):
        return value
    return table_of(name, type_, value.numpy()) if isinstance(type_, TableType) else value.numpy()


def _odd(streams: Iterable[Stream], size: int, element: int | None = None) -> dict[str, Array]:
    """Return for each kind the elements, (size,), with such a float in a stream; only `element` if it is given."""
    odd = {kind: np.zeros(size, np.bool_) for kind in KINDS}
    for stream in streams:
        for leaf in flat_leaves(stream.numpy()):
            if leaf.dtype.kind == "f" and leaf.size:
                for kind, test in KINDS.items():
                    odd[kind] |= test(leaf).reshape(stream.size, -1).any(axis=1)
    if element is not None:
        for mask in odd.values():
            mask &= np.arange(size) == element
    return odd
