"""The first operation that gives NaN or infinity.

Stage: test. Takes a program and its inputs; runs it, then the program that watches itself (`watch.py`); gives a
`NonFinite`, or None where every output is finite. Of a chain, `chained_nonfinite` finds the run of the kernel.

    print(first_nan(program, x))
    # element 3: NaN at shade.py:12: n = sh.sqrt(d)
    #   with d = -1.1920929e-07
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from shpy.chains.chain import Chain
from shpy.ir.nodes import Call, Function, Let, Loc, Stmt
from shpy.ir.traverse import rewrite
from shpy.lang.recording.text import written
from shpy.programs import Program
from shpy.testing.arrays import Array
from shpy.testing.chained import check_streams
from shpy.testing.chained_nonfinite import KINDS, first_odd_run
from shpy.testing.divergence import check_element
from shpy.testing.observers import BackendObserver, Setting
from shpy.testing.reference import split_options
from shpy.testing.runs import run

_LIBRARY: Final = Path(__file__).parents[1]
"""The folder of shpy: an operation of its own functions is an event of the user's line that calls them."""
_TITLES: Final = {"nan": "NaN", "infinite": "infinity"}


@dataclass(frozen=True)
class NonFinite:
    """The operation that gave the first NaN or infinity of an element.

    `kind` is "nan" or "infinite", that of the element's outputs; `element` its index and `inputs` its inputs by name.
    `loc`, `name` and `text` are the user's line, the variable and the operation, `value` its value and `operands` the
    values by name; `iterations` are those of the loops around it, the innermost first. Where no operation gave the
    first, since an input, a Param or a constant has it, `loc` is None. Of a chain, `program` is the name of the kernel
    and `run` the number of its run, from 1.
    """

    program: str
    backend: str
    kind: str
    element: tuple[int, ...]
    inputs: dict[str, Any]
    loc: Loc | None = None
    name: str | None = None
    text: str = ""
    value: Any = None
    operands: dict[str, Any] | None = None
    iterations: tuple[int, ...] = ()
    loops: tuple[Loc | None, ...] = ()
    run: int | None = None

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        place = ", ".join(map(str, self.element)) or "the only one"
        number = "" if self.run is None else f", run {self.run}"
        head = f"{self.program} on {self.backend}{number}, element {place}: {_TITLES[self.kind]}"
        if self.loc is None:
            yield f"{head} that no operation gave first: an input, a Param or a constant has it"
        else:
            yield f"{head} at {self.loc}"
            yield f"    {written(self.loc)}"
            yield f"  {f'{self.name} = ' if self.name else ''}{self.text} = {_spoken(self.value)}"
            for name, value in (self.operands or {}).items():
                yield f"    with {name} = {_spoken(value)}"
            for iteration, loop in zip(self.iterations, self.loops, strict=False):
                yield f"  in iteration {iteration} of the loop at {loop}"
        yield f"  inputs: {', '.join(f'{n} = {_spoken(v)}' for n, v in self.inputs.items()) or 'none'}"


def first_nan(
    program: Program | Chain,
    *inputs: Any,
    backend: str | None = None,
    element: int | None = None,
    shape: Any = None,
    **named: Any,
) -> NonFinite | None:
    """Return the operation that gives the first NaN of an element, or the first infinity; None for finite outputs.

    The element is the number `element` in C order, or else the first with a NaN in an output, or else the first with
    an infinity. The operation is the first of the run whose value is NaN (infinite) while no operand is (is infinite
    or NaN): infinities that a program computes with and that do not reach an output are none. A function of the library
    counts as one operation. `backend` is a name as in `testing.targets`, by default "numpy"; `inputs` and other names
    are as in `assert_equivalent`.

    Of a chain the names are those of `chain.run`, and the outputs are its streams. The operation belongs to the first
    run of a kernel that writes NaN into an element without one (infinity into a finite element): streams that the
    kernel reads by element, and those that it replaces, decide about before.
    Raises ShpyIndexError for an `element` that no run has, ShpyTypeError for a chain's streams by position.
    """
    if isinstance(program, Chain):
        check_streams(program, inputs)
        return _first_of_chain(program, element, shape=shape, backend=backend, **named)
    inputs_by_name, options = split_options(named, program)
    return _first(Setting(program, inputs, inputs_by_name, shape, options), backend or "numpy", element)


def _first_of_chain(chain: Chain, element: int | None, **named: Any) -> NonFinite | None:
    odd = first_odd_run(chain, element, **named)
    if odd is None:
        return None
    setting = Setting(odd.program, (), odd.inputs, odd.shape, odd.options)
    first = _first(setting, odd.place.backend, odd.element)
    if first is None:  # the kernel did not write the element: the stream had it before
        index, inputs = setting.index(odd.element), setting.element(odd.element)
        first = NonFinite(odd.program.name, odd.place.backend, odd.kind, index, inputs)
    return replace(first, run=odd.number)


def _first(setting: Setting, backend: str, element: int | None) -> NonFinite | None:
    program = setting.program
    results = run(setting, backend)
    check_element(element, results.written.size)
    chosen = _first_element(results.outputs, results.written, element)
    if chosen is None:
        return None
    kind, element = chosen
    result = NonFinite(program.name, backend, kind, setting.index(element), setting.element(element))
    watching = BackendObserver(replace(setting, program=_with_inner_events(program)), backend, element, finiteness=True)
    event = watching.first_odd(kind)
    if event is None:
        return result
    seen = watching.look(frozenset({watching.site(event)})).seen(event)
    site = seen.site
    assert site is not None
    return replace(
        result,
        loc=site.loc,
        name=site.name,
        text=site.text,
        value=seen.value,
        operands={name: value for (name, _, _), value in zip(site.operands, seen.operands, strict=True)},
        iterations=seen.turns,
        loops=site.loops,
    )


def _with_inner_events(program: Program) -> Program:
    """Return the program with the user's pure functions called by statements: a call by an operation is one event."""

    def is_users(function: Function) -> bool:
        return function.loc is None or _LIBRARY not in Path(function.loc.file).parents

    users = {f.name for f in program.ir.functions if f.pure and is_users(f)}

    def stated(s: Stmt) -> Stmt:
        if isinstance(s, Let) and s.op == "call" and s.attr in users:
            return Call(str(s.attr), s.args, (s.value,), s.value.loc)
        return s

    functions = tuple(
        replace(f, body=rewrite(f.body, stated), pure=f.pure and f.name not in users) for f in program.ir.functions
    )
    return Program(replace(program.recorded, module=replace(program.ir, functions=functions)))


def _first_element(outputs: tuple[Array, ...], written: Array, element: int | None) -> tuple[str, int] | None:
    """Return the kind and the number of the element to look at."""
    floats = [output for output in outputs if output.dtype.kind == "f"]
    for kind, test in KINDS.items():
        odd = np.zeros(written.size, np.bool_)
        for output in floats:
            odd |= test(output).any(axis=1)
        places = np.flatnonzero(odd & written)
        if element is not None:
            places = places[places == element]
        if places.size:
            return kind, int(places[0])
    return None


def _spoken(value: Any) -> str:
    array = np.asarray(value)
    return str(array[()]) if array.ndim == 0 else f"({', '.join(map(str, array.ravel()))})"
