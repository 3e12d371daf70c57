"""The gradient of a sum over all elements by Params, for fitting them to data.

Stage: above programs and streams. The kernel computes each element's value and derivatives, and the sums are those of
`Stream.sum`, whose order is fixed: all backends give the same bits.

    step = sh.value_and_gradient(error, (gain, color))
    value, (d_gain, d_color) = step(uv=places, target=picture)
    gain.value -= 0.1 * d_gain
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from typing import Any, Literal

from shpy.errors import ShpyTypeError
from shpy.gradients.programs import gradient_of
from shpy.lang.data.tables import Table
from shpy.lang.programs.inline import call_recorded
from shpy.lang.programs.joined import rerecorded
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Layout, build_arrays, flatten
from shpy.passes.modes import Precision
from shpy.programs import Program, check_program
from shpy.streams.stream import Stream, streams_in


def value_and_gradient(
    program: Program, wrt: Any, *, mode: Literal["forward", "reverse"] = "reverse", most: int | None = None
) -> Callable[..., Any]:
    """Return the function that runs a program and returns the sum of its output over all elements, and its gradient.

    The output is one float. `wrt` is a Param, or its name, or a tuple of them for a tuple of gradients; a gradient is
    an array of the Param's shape, of a struct a named tuple. `mode` and `most` are those of `sh.gradient`.

    The function takes the inputs of the program, arrays or streams, and `backend=`, `device=`, `precision=` and
    `shape=` as `Program.compile` and a kernel do. Elements that are discarded do not count. Divide by the number of
    elements for a mean.

    Raises ShpyTypeError for a program with other outputs, and for anything but Params; RecordError where the output
    does not depend on one.
    """
    flat, layout = _gradient(program, tuple(wrt) if isinstance(wrt, tuple | list) else (wrt,), mode, most)

    def run(
        *args: Any,
        backend: str | None = None,
        device: int | None = None,
        precision: Precision = "f32",
        shape: Any = None,
        **inputs: Any,
    ) -> Any:
        stream = next(streams_in(chain(args, inputs.values(), flat.recorded.tables.values())), None)
        if stream is None:
            kernel = flat.compile(backend, device=device, precision=precision)
        else:
            kernel, precision = flat.compile_for(stream), stream.precision
        outputs = kernel(*args, shape=shape, **inputs)
        sums = [_sum(x, cls, precision) for x, cls in zip(outputs, flat.outputs.values(), strict=True)]
        value, *gradients = build_arrays(layout, iter(sums))
        return value, tuple(gradients) if isinstance(wrt, tuple | list) else gradients[0]

    return run


def _gradient(program: Program, params: tuple[Any, ...], mode: Any, most: int | None) -> tuple[Program, Layout]:
    """Return the program of the value and the gradient, with an output for each leaf; and the layout of these."""
    check_program(program)
    for p in params:
        if isinstance(p, Table) or (isinstance(p, str) and p in program.inputs | program.tables):
            raise ShpyTypeError(
                f"sh.value_and_gradient takes Params, and {getattr(p, 'name', p)} is a Table or an input",
                loc=here(),
                cure=f"{program.name}.gradient(…) for the derivative by an input, element by element",
            )
    derived = gradient_of(program.recorded, params, value=True, mode=mode, most=most)

    def leaves(arguments: dict[str, Any]) -> Any:
        return tuple(flatten(derived.output, call_recorded(derived, arguments), "the gradient"))

    flat = rerecorded(derived.module.name, derived, derived.inputs, None, leaves, derived.defaults)
    return Program(flat), derived.output


def _sum(x: Any, cls: Any, precision: Precision) -> Any:
    """Return the sum of a stream or an array of elements, in the order of `Stream.sum`."""
    return (x if isinstance(x, Stream) else Stream(x, cls, "numpy", precision=precision)).sum()
