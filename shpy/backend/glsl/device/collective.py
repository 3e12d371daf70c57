"""Scatters on a GL device: each element is a point, which is drawn at its place.

Stage: run. Points are drawn in the order of their elements, so the last one for a place stays; counts are sums of
ones, which blending adds. The other way, to sort the indices and to search in them, took longer on llvmpipe. Other
collective operations are programs, since they only read by index.

    operations = collectives(space)
    operations.put(values, index, target)
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from shpy.backend.base import Collectives
from shpy.backend.glsl.device.context import Context
from shpy.backend.glsl.device.memory import GlslMemory, GlslSpace
from shpy.backend.glsl.text.prologue import KINDS
from shpy.ir.types import Base, vec

_AT_ONCE: Final = 1 << 20
"""Points of a draw; Ctrl-C ends the wait between draws."""
_EXACT: Final = 1 << 24
"""Ones that a float of 32 bits adds without rounding."""

_PLACE: Final = """\
#version 330 core
// A point in the middle of the texel of an element's index; it lies outside of the image for an index out of range.
uniform INDEXsampler2D indices;
uniform int first, index_width, places;
uniform ivec2 size;
flat out int element;

void main() {
    element = first + gl_VertexID;
    int place = int(texelFetch(indices, ivec2(element % index_width, element / index_width), 0).x);
    vec2 texel = vec2(place % size.x, place / size.x);
    bool within = place >= 0 && place < places;
    gl_Position = vec4(within ? (2.0 * texel + 1.0) / vec2(size) - 1.0 : vec2(2.0), 0.0, 1.0);
}
"""
_VALUE: Final = """\
#version 330 core
uniform KINDsampler2D values;
uniform int value_width;
flat in int element;
layout(location = 0) out KINDvec4 value;

void main() {
    value = texelFetch(values, ivec2(element % value_width, element / value_width), 0);
}
"""
_ONE: Final = """\
#version 330 core
flat in int element;
layout(location = 0) out vec4 one;

void main() {
    one = vec4(1.0);
}
"""
_ADD: Final = """\
#version 330 core
uniform isampler2D before;
uniform sampler2D found;
uniform int has_before;
layout(location = 0) out ivec4 sum;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    sum = ivec4(texelFetch(found, at, 0)) + has_before * texelFetch(before, at, 0);
}
"""


def collectives(space: GlslSpace, context: Context) -> Collectives:
    """Return the operations that this device does itself."""
    own = _Points(space, context)
    return Collectives(put=own.put, tally=own.tally)  # no lists: the depth test discards before a kernel runs


class _Points:
    def __init__(self, space: GlslSpace, context: Context) -> None:
        self._space = space
        self._context = context

    def put(self, values: Any, index: Any, target: Any) -> None:
        """Write values to the elements of `target` at an index; of several values for an element the last one stays."""
        text = _VALUE.replace("KIND", KINDS[values.type.base])
        self._draw(text, index, target, slice(0, index.count), values)

    def tally(self, numbers: Any, bins: int) -> GlslMemory:
        """Count how often each number below `bins` occurs."""
        space, total = self._space, None
        for first in range(0, numbers.count, _EXACT):
            ones = space.allocate(bins, vec(Base.F), np.dtype(np.float32))
            space.call(ones.target.framebuffer.clear)
            self._draw(_ONE, numbers, ones, slice(first, min(first + _EXACT, numbers.count)), adds=True)
            before, total = total, space.allocate(bins, vec(Base.I), np.dtype(np.int32))
            self._add(before, ones, total)
        assert total is not None
        return total

    def _add(self, before: GlslMemory | None, ones: GlslMemory, total: GlslMemory) -> None:
        sources = {"before": before or self._space.allocate(1, total.type, total.dtype), "found": ones}
        has_before = {"has_before": int(before is not None)}
        self._space.call(lambda: self._space.draw(_ADD, sources, has_before, total, (total.width, total.height)))

    def _draw(self, text: str, index: Any, target: Any, part: slice, values: Any = None, *, adds: bool = False) -> None:
        """Draw a part of the elements as points into a memory."""
        space, context, size = self._space, self._context, (target.width, target.height)
        vertex = _PLACE.replace("INDEX", KINDS[index.type.base])
        numbers = {"index_width": index.width, "places": target.count, "size": size}
        sources = {"indices": index}
        if values is not None:
            numbers["value_width"] = values.width
            sources["values"] = values

        def draw() -> None:
            gl = context.gl
            if adds:
                gl.enable(context.moderngl.BLEND)
                gl.blend_func = context.moderngl.ONE, context.moderngl.ONE
            try:
                for first in range(part.start, part.stop, _AT_ONCE):
                    count = min(_AT_ONCE, part.stop - first)
                    space.draw(text, sources, {**numbers, "first": first}, target, size, (vertex, count))
                    context.go_on()
            finally:
                if adds:
                    gl.disable(context.moderngl.BLEND)

        space.call(draw)
