"""Parts of streams: fields of structs, which stay on the device, and the rows that an index names.

Stage: run.

    rays.o                  # a Stream of Point3f over the same memory
    rays["o"]               # the same; for a field with the name of a method, such as "sum"
"""

from __future__ import annotations

from typing import Any

from shpy.errors import ShpyAttributeError, ShpyTypeError
from shpy.ir.constants import is_int
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Group, leaves, type_of


def field_of(stream: Any, name: str) -> Any:
    """Return a field of a stream of structs or named tuples: a view of its memory, without a copy.

    A write to the stream or to the field changes both. Raises ShpyTypeError for a stream of other elements, or for a
    name that is no field.
    """
    layout = stream._layout
    if not isinstance(layout, Group) or name not in layout.names:
        has = f"the fields {', '.join(layout.names)}" if isinstance(layout, Group) else "no fields"
        cure = f'stream["{layout.names[0]}"]' if isinstance(layout, Group) and layout.names else "stream.numpy()"
        raise ShpyTypeError(f"{stream!r} has {has}, not {name!r}", loc=here(), cure=cure)
    place = layout.names.index(name)
    before = sum(len(list(leaves(part, ""))) for part in layout.parts[:place])
    part = layout.parts[place]
    memories = stream._memories[before : before + len(list(leaves(part, "")))]
    view = type(stream).over(type_of(part), stream.shape, stream.place, memories)
    stream._owned = view._owned = False  # the stream and its view share this memory
    return view


class StreamFields:
    """The fields of a Stream of structs as its attributes."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # names that Python and numpy look up on any object
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        try:
            return field_of(self, name)
        except ShpyTypeError as error:
            raise ShpyAttributeError(error.message, loc=error.loc, cure=error.cure) from None


def rows_of(key: Any, count: int) -> range | None:
    """Return the rows that an index or a slice of the first axis names, in order; None for any other key."""
    if is_int(key) and -count <= key < count:
        at = int(key) % count
        return range(at, at + 1)
    if isinstance(key, slice) and key.step in (None, 1):
        rows = range(count)[key]
        return range(rows.start, rows.start + len(rows))
    return None
