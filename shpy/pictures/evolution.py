"""Chains that run on from frame to frame, and the pictures of their streams.

Stage: picture. Animations (`animation`), widgets (`notebook`) and the live page (`view`) draw chains by it.

    spots = Evolution(sh.repeat(react, 20), colors, {"u": u, "v": v}, backend="opencl")
    spots.step(Moment(spots.size))
    spots.picture(Moment(spots.size))       # (height, width, 3)
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from shpy.chains.chain import Chain
from shpy.chains.member import element_layout, is_gathered, stream_names
from shpy.display.screen import Moment, check_pictures, filled, first_output, values_of
from shpy.errors import ShpyTypeError
from shpy.lang.data.tables import Table
from shpy.lang.data.textures import Texture2D
from shpy.lang.recording.location import here
from shpy.programs import Program
from shpy.run.host import common_shape, inputs as host_inputs
from shpy.streams.elements import Shape
from shpy.streams.stream import Stream, streams_in


class Evolution:
    """A chain whose streams go on from step to step, and the program that makes colours of them."""

    def __init__(
        self,
        chain: Chain,
        show: Program | None,
        streams: Mapping[str, Any],
        *,
        size: tuple[int, int] | None = None,
        backend: str | None = None,
    ) -> None:
        """Begin with `streams`, by name; raises ShpyTypeError for a name that neither the chain nor `show` has.

        `size` is (width, height); without it that of the first stream that has two axes, else (512, 512). Without a
        `backend`, a chain over arrays goes on with OpenCL once that pays (`chains.takeover`), and a Stream pins it.
        """
        names = {*stream_names(chain.steps), *(show.inputs if show else ())}
        unknown = [name for name in streams if name not in names]
        if unknown:
            raise ShpyTypeError(f"{unknown[0]} is no stream of {chain}", loc=here(), cure=f"one of {', '.join(names)}")
        self._chain, self._show, self._backend = chain, show, backend
        self.size = size or extent(chain, streams)
        self._first = dict(streams)
        self._streams = dict(streams)

    def reset(self) -> None:
        """Restore the first streams of the chain."""
        self._streams = dict(self._first)

    def step(self, moment: Moment) -> None:
        """Run the chain once."""
        written = stepped(self._chain, moment, self._streams, self._backend)
        is_free = self._backend is None and next(streams_in(iter(self._first.values())), None) is None
        for name, stream in written.items():
            self._streams[name] = stream.numpy() if is_free and stream.backend == "numpy" else stream

    def picture(self, moment: Moment) -> Any:
        """Return the output of `show` for the present streams; without it the last stream that the chain writes."""
        if self._show is None:
            return np.asarray(self._streams[last_stream(self._chain)])
        inputs = values_of(self._show.inputs, moment, self._streams)
        check_pictures(self._show, moment.size, inputs)
        return np.asarray(first_output(self._show(**inputs, shape=moment.shape)))


def last_stream(chain: Chain) -> str:
    """Return the name of the stream that a chain writes last, which is shown where no program makes colours."""
    return chain.kernels[-1].outputs[-1][0]


def given_to(chain: Chain, moment: Moment, streams: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a chain's run at a moment: the streams that it has, and the inputs of a filled name.

    A stream that the chain writes before it reads it is given, too: its shape tells that of the kernel.
    """
    inputs = {name: streams[name] for name in stream_names(chain.steps) if name in streams}
    written = {*inputs, *chain.outputs} - chain.inputs.keys()
    types = {name: getattr(t, "cls", t) for step in chain.steps for name, t in step.inputs.items()}
    return inputs | filled(types, moment, names={*inputs, *written})


def stepped(chain: Chain, moment: Moment, streams: Mapping[str, Any], backend: str | None) -> dict[str, Any]:
    """Run a chain once; return the streams that it wrote.

    A kernel whose streams do not tell how many elements there are runs over the pixels of the picture.
    """
    inputs, shape = arguments_of(chain, moment, streams)
    return chain.run(backend=backend, shape=shape, **inputs).streams


def arguments_of(
    chain: Chain, moment: Moment, streams: Mapping[str, Any]
) -> tuple[dict[str, Any], tuple[int, int] | None]:
    """Return the streams of a run of a chain, by name, and its `shape=`."""
    inputs = given_to(chain, moment, streams)
    return inputs, moment.shape if _lacks_shape(chain, shapes_of(chain, inputs)) else None


def _lacks_shape(chain: Chain, shapes: dict[str, Shape]) -> bool:
    """Return whether a kernel writes a new stream, and reads by element single numbers alone, or nothing."""
    for step in chain.steps:
        written = [name for name, _ in step.kernel.outputs]
        named = [*(name for name, type_ in step.inputs.items() if not is_gathered(type_)), *written]
        many = next((shapes[name] for name in named if math.prod(shapes.get(name, ())) != 1), None)
        if many is not None:
            shapes |= dict.fromkeys(written, many)
        elif not all(name in shapes for name in written):
            return True
    return False


def shapes_of(chain: Chain, streams: Mapping[str, Any]) -> dict[str, Shape]:
    """Return the shape of the elements of each stream that a chain has; raise ShpyTypeError for an unknown stream."""
    named = (pair for step in chain.steps for pair in (*step.inputs.items(), *step.kernel.outputs))
    layouts = {name: element_layout(type_) for name, type_ in named}
    shapes = {}
    for name, value in streams.items():
        if isinstance(value, Stream):
            shapes[name] = value.shape
        elif name in layouts and not isinstance(value, Table | Texture2D):
            shapes[name] = common_shape(host_inputs({name: layouts[name]}, {name: value}, "f32"), None)
    return shapes


def extent(chain: Chain, streams: Mapping[str, Any], otherwise: tuple[int, int] = (512, 512)) -> tuple[int, int]:
    """Return (width, height) of the first stream of a chain that has two axes of elements."""
    shapes = shapes_of(chain, streams).values()
    height, width = next((shape for shape in shapes if len(shape) == 2), otherwise[::-1])
    return width, height
