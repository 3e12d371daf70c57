"""Chains that run on from frame to frame, and the pictures of their streams.

Stage: picture. Animations (`animation`) and widgets (`notebook`) draw chains by it.

    spots = Evolution(sh.repeat(react, 20), colors, {"u": u, "v": v}, backend="opencl")
    spots.step(Moment(spots.size))
    spots.picture(Moment(spots.size))       # (height, width, 3)
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from shpy.chains.chain import Chain
from shpy.errors import ShpyTypeError
from shpy.lang.recording.location import here
from shpy.programs import Program
from shpy.screen import Moment, check_pictures, first_output, values_of
from shpy.streams.stream import Stream


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

        `size` is (width, height); without it that of the first stream that has two axes, else (512, 512).
        """
        names = {*chain.inputs, *chain.outputs, *(show.inputs if show else ())}
        unknown = [name for name in streams if name not in names]
        if unknown:
            raise ShpyTypeError(f"{unknown[0]} is no stream of {chain}", loc=here(), cure=f"one of {', '.join(names)}")
        self._chain, self._show, self._backend = chain, show, backend
        self.size = size or _extent(streams)
        self._first = dict(streams)
        self._streams = dict(streams)

    def reset(self) -> None:
        """Restore the first streams of the chain."""
        self._streams = dict(self._first)

    def step(self, moment: Moment) -> None:
        """Run the chain once."""
        given = values_of({**self._chain.inputs, **self._chain.outputs}, moment, self._streams)
        self._streams |= self._chain.run(backend=self._backend, **given).streams

    def picture(self, moment: Moment) -> Any:
        """Return the output of `show` for the present streams; without it the last stream that the chain writes."""
        if self._show is None:
            return np.asarray(self._streams[list(self._chain.outputs)[-1]])
        given = values_of(self._show.inputs, moment, self._streams)
        check_pictures(self._show, moment.size, given)
        return np.asarray(first_output(self._show(**given, shape=moment.shape)))


def _extent(values: Mapping[str, Any]) -> tuple[int, int]:
    """Return (width, height) of the streams that a chain begins with: of the first one that has two axes."""
    shapes = [value.shape if isinstance(value, Stream) else np.shape(value)[:2] for value in values.values()]
    height, width = next((shape for shape in shapes if len(shape) == 2), (512, 512))
    return width, height
