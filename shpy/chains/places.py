"""The names of a chain's streams, and the place where it runs, from the values that `run` was given.

Stage: run.

    check_names(node, values)
    place_of(node.kernels, values, backend, device, precision)
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import chain as joined
from typing import Any

from shpy.backend.registry import default_place
from shpy.chains.member import Member, Node, stream_names
from shpy.errors import ShpyTypeError
from shpy.lang.recording.location import here
from shpy.passes.modes import Precision
from shpy.run.kernel import Kernel
from shpy.run.on_device import check_places
from shpy.streams.stream import Place, Stream, _place, streams_in


def check_names(node: Node, values: Mapping[str, Any]) -> None:
    """Raise ShpyTypeError for a stream that no kernel has, and for one that is read but neither given nor written."""
    steps = list(node.steps)
    names = stream_names(steps)
    for name in values:
        if name not in names and any(name in step.numbers for step in steps):
            raise ShpyTypeError(
                f"{name} is given, and {node} counts it: it is the number of the pass", loc=here(), cure=f"no {name}="
            )
        if name not in names:
            listed = "; ".join(dict.fromkeys(member.signature for member in node.kernels))
            raise ShpyTypeError(
                f"{name} is no stream of {node}: {listed}", loc=here(), cure=f"one of {', '.join(names)}"
            )
    there = set(values)
    for step in steps:
        member = step.kernel
        missing = [n for n in step.inputs if n not in there and n not in member.recorded.defaults]
        if missing:
            raise ShpyTypeError(
                f"{node} lacks {', '.join(missing)}, which {member.signature} reads",
                loc=here(),
                cure=f"chain.run({', '.join(f'{n}=…' for n in (*values, *missing))})",
            )
        there |= {name for name, _ in member.outputs} if step.runs else set()


def _placed(members: Iterable[Member], values: Mapping[str, Any]) -> tuple[Stream | None, Kernel | None]:
    """Return a stream and a compiled kernel, each of which has a place, or None."""
    members = tuple(members)
    tables = (table for member in members for table in member.recorded.tables.values())
    stream = next(streams_in(joined(values.values(), tables)), None)
    return stream, next((member.kernel for member in members if isinstance(member.kernel, Kernel)), None)


def has_place(node: Node, values: Mapping[str, Any]) -> bool:
    """Return whether streams or compiled kernels tell where a chain runs."""
    return any(it is not None for it in _placed(node.kernels, values))


def place_of(
    members: Iterable[Member],
    values: Mapping[str, Any],
    backend: str | None,
    device: int | None,
    precision: Precision | None,
) -> Place:
    """Return the place of the streams; without streams, that of a compiled kernel, else the one given to `run`."""
    stream, kernel = _placed(members, values)
    if stream is None and kernel is None:
        return _place(default_place() if backend is None else backend, device, precision or "f32")
    place = stream.place if stream is not None else kernel.place  # type: ignore[union-attr]
    told = {"backend": backend, "device": device, "precision": precision}
    for name, value in told.items():
        if value is not None and value != getattr(place, name):
            what = repr(stream) if stream is not None else repr(kernel)
            raise ShpyTypeError(
                f"{name}={value!r}, and the chain runs where {what} is", loc=here(), cure=f"no {name}=, or arrays"
            )
    check_places(values.values(), place, "the chain")
    return place
