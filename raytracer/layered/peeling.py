"""The order of a layered depth cube's samples by depth peeling on OpenGL.

Stage: accelerate. Source: Everitt, Interactive order-independent transparency (2001), as in Bürger, Hertel, Krüger and
Westermann, GPU Rendering of Secondary Effects (VMV 2007), section 1.2. Each pass draws the spans of all triangles; a
fragment that is not behind the last layer is discarded, the nearest of the others stays.

Four things differ from the paper. It draws triangles, here kernels have found their spans. It fills three images in one
pass by a geometry shader, here one image follows the other. It needs as many passes as there are layers, here there are
two for each layer: depth buffers have 24 bits, which would round, so a float target keeps the least depth, by blending,
and a second pass the least number of the triangles there. It counts the layers beforehand, here an empty layer ends.
"""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.bounds import FAR
from raytracer.errors import SceneError

_VERTEX = """#version 330
uniform int resolution;
in ivec3 span;
in ivec2 owner;
in vec3 corner;
in vec2 slope;
flat out int triangle;
flat out vec3 origin;
flat out vec2 change;
void main() {
    ivec2 place = ivec2(span.y + (gl_VertexID & 1) * span.z, span.x + (gl_VertexID >> 1));
    triangle = owner.y;
    origin = corner;
    change = slope;
    gl_Position = vec4(2.0 * vec2(place) / float(resolution) - 1.0, 0.0, 1.0);
}
"""
_FRAGMENT = """#version 330
uniform sampler2D last_depth;
uniform sampler2D last_triangle;
uniform sampler2D depth_here;
uniform bool numbering;
flat in int triangle;
flat in vec3 origin;
flat in vec2 change;
out float found;
void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy);
    // As raster.ProjectedTriangle.depth has it, rounding by rounding.
    precise float ahead = (float(texel.x) + 0.5 - origin.x) * change.x;
    precise float above = (float(texel.y) + 0.5 - origin.y) * change.y;
    precise float depth = origin.z + ahead;
    depth = depth + above;
    float last = texelFetch(last_depth, texel, 0).r;
    float number = float(triangle);
    if (depth < last || (depth == last && number <= texelFetch(last_triangle, texel, 0).r)) discard;
    if (numbering && depth != texelFetch(depth_here, texel, 0).r) discard;
    found = numbering ? number : depth;
}
"""
_PRECISE = "#extension GL_ARB_gpu_shader5 : require\n"
_MOST = 1 << 24
"""Triangles whose numbers are exact floats."""


class Spans(NamedTuple):
    """Spans to be drawn, n: `place` (n, 3) row, first column, number of columns; `owner` (n, 2) image and triangle.

    `corner` (n, 3) is a corner of the triangle, (column, row, depth) in its image; `slope` (n, 2) is the change of its
    depth per column and row.
    """

    place: NDArray[np.int32]
    owner: NDArray[np.int32]
    corner: NDArray[np.float32]
    slope: NDArray[np.float32]


def peeled(spans: Spans, resolution: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the offsets of the texels of three images, and the triangles of their samples in order.

    Raises SceneError for more triangles than a float counts, or more texels than the device draws.
    """
    import moderngl

    if spans.owner[:, 1].max(initial=0) >= _MOST:
        raise SceneError(f'builder="peel" takes {_MOST:,} triangles at most: builder="sort" takes more')
    options: dict[str, Any] = {"backend": "egl"} if sys.platform == "linux" else {}
    gl = moderngl.create_context(standalone=True, require=330, **options)
    try:
        if resolution > gl.info["GL_MAX_VIEWPORT_DIMS"][0]:
            raise SceneError(
                f"the device draws {gl.info['GL_MAX_VIEWPORT_DIMS'][0]} texels along a side, not {resolution}"
            )
        device = _Device(gl, resolution)
        layers = [device.layers(Spans(*(part[spans.owner[:, 0] == image] for part in spans))) for image in range(3)]
    finally:
        gl.release()
    return _by_texel(layers, resolution)


class _Device:
    """The targets and the program of the passes over one image."""

    def __init__(self, gl: Any, resolution: int) -> None:
        self.gl, self.resolution = gl, resolution
        fragment = _FRAGMENT.replace("#version 330\n", f"#version 330\n{_PRECISE}")
        self.program = gl.program(vertex_shader=_VERTEX, fragment_shader=fragment)
        self.program["resolution"].value = resolution
        self.textures = [gl.texture((resolution, resolution), 1, dtype="f4") for _ in range(4)]
        self.targets = [gl.framebuffer([texture]) for texture in self.textures]
        for unit, name in enumerate(("last_depth", "last_triangle", "depth_here")):
            self.program[name].value = unit

    def layers(self, spans: Spans) -> list[NDArray[np.float32]]:
        """Return the triangles of each layer, (resolution, resolution), FAR where there is none."""
        if not len(spans.place):
            return []
        names = ("3i/i", "span"), ("2i/i", "owner"), ("3f/i", "corner"), ("2f/i", "slope")
        used = [(self.gl.buffer(np.ascontiguousarray(part)), *name) for part, name in zip(spans, names, strict=True)]
        attributes = [entry for entry in used if entry[2] in self.program]
        shape = self.gl.vertex_array(self.program, attributes)
        last, now = self.targets[:2], self.targets[2:]
        for target in last:
            target.clear(-FAR)
        layers: list[NDArray[np.float32]] = []
        while True:
            for numbering, target in enumerate(now):
                # A texture that is drawn into must not be bound; the first pass reads no depth of its own layer.
                for unit, read in enumerate([*last, now[0] if numbering else last[0]]):
                    read.color_attachments[0].use(unit)
                self.draw(shape, target, len(spans.place), bool(numbering))
            triangles = np.frombuffer(now[1].read(components=1, dtype="f4"), np.float32)
            if (triangles >= FAR).all():
                return layers
            layers.append(triangles)
            last, now = now, last

    def draw(self, shape: Any, target: Any, count: int, numbering: bool) -> None:
        """Draw all spans; each texel keeps the least number drawn into it."""
        import moderngl

        target.use()
        target.clear(FAR)
        self.gl.enable(moderngl.BLEND)
        self.gl.blend_equation = moderngl.MIN
        self.program["numbering"].value = numbering
        shape.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=count)


def _by_texel(layers: list[list[NDArray[np.float32]]], resolution: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Collect the triangles of the layers texel by texel; return the offsets of texels, and the triangles."""
    counts = np.zeros((3, resolution**2), np.int64)
    for count, image in zip(counts, layers, strict=True):
        for layer in image:
            count += layer < FAR
    offsets = np.concatenate([[0], np.cumsum(counts)])
    triangles = np.empty(offsets[-1], np.int32)
    starts = offsets[:-1].reshape(3, -1)
    for start, image in zip(starts, layers, strict=True):
        for depth, layer in enumerate(image):
            there = layer < FAR
            triangles[start[there] + depth] = layer[there]
    return offsets.astype(np.int32), triangles
