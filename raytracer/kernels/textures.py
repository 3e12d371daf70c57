"""The textures of a scene in one table, however many there are: GLSL has only some 16 tables for a kernel.

Stage: kernel. The filters are those of OpenGL 3.3 (section 3.8.11), in the language's own arithmetic.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.appearance.textures import WRAPS, Texture
from shpy import SH_IF

LINEAR = 4
"""Added to the number of the wrap in the mode of a texture."""
PART = 1 << 16
"""Texels that are copied at once."""


class Atlas:
    """Textures, which are known by their places among `textures`."""

    def __init__(self, textures: Sequence[Texture]) -> None:
        starts = np.cumsum([0, *(t.image.size // 3 for t in textures)])
        # A table copies what it is made of; parts are copied into its own memory, of which textures may take gigabytes.
        self.texels = sh.Table(np.broadcast_to(np.float32(0), (starts[-1], 4)), sh.Attrib4f, "texels")
        rows = []
        for start, t in zip(starts[:-1], textures, strict=False):
            for part, colors in _parts(t):
                self.texels.update(colors, start=int(start) + part)
            mode = WRAPS.index(t.wrap) + LINEAR * (t.filter == "linear")
            rows.append((start, t.image.shape[1], t.image.shape[0], mode))
        self.pictures = sh.Table(np.array(rows, np.int32), sh.Attrib4i, "pictures")
        self.wraps = {t.wrap for t in textures}
        self.filters = {t.filter for t in textures}

    def sample(self, number: Any, uv: Any) -> Any:
        """Return the linear colour of texture `number` at `uv`: (0, 0) is the lower left corner of the picture."""
        start, width, height, mode = self.pictures[number]
        size = sh.Attrib2f(width, height)
        place = sh.Attrib2f(self.wrapped(uv.x, mode), self.wrapped(1 - uv.y, mode)) * size
        if "linear" not in self.filters:
            return self.nearest(place, start, width, size)
        found = sh.Color3f(self.linear(place, start, width, height, mode))
        if "nearest" in self.filters:
            with SH_IF(mode < LINEAR):
                found[:] = self.nearest(place, start, width, size)
        return found

    def nearest(self, place: Any, start: Any, width: Any, size: Any) -> Any:
        """Return the texel at `place`."""
        cell = sh.Attrib2i(sh.clamp(sh.floor(place), 0, size - 1))
        return self.texels[start + cell.y * width + cell.x].rgb

    def linear(self, place: Any, start: Any, width: Any, height: Any, mode: Any) -> Any:
        """Interpolate the four texels around `place`."""
        corner = sh.floor(place - 0.5)
        part = place - 0.5 - corner
        cell = sh.Attrib2i(corner)

        def texel(across: int, down: int) -> Any:
            column = self.cell(cell.x + across, width, mode)
            row = self.cell(cell.y + down, height, mode)
            return self.texels[start + row * width + column].rgb

        top, bottom = (sh.mix(texel(0, down), texel(1, down), part.x) for down in (0, 1))
        return sh.mix(top, bottom, part.y)

    def wrapped(self, x: Any, mode: Any) -> Any:
        """Wrap a coordinate into [0, 1]; what lies on the picture, its far edges too, stays."""
        part = sh.fract(x)
        if "nearest" in self.filters:  # the linear filter blends the same two texels at either edge
            part = sh.cond((part == 0) & (x > 0), 1.0, part)
        ways = {"repeat": part, "clamp": sh.clamp(x, 0, 1), "mirror": 1 - abs(1 - 2 * sh.fract(0.5 * x))}
        return self._chosen(ways, mode)

    def cell(self, k: Any, count: Any, mode: Any) -> Any:
        """Return the row or column of a texel that may lie beside the picture."""
        across = sh.cond(k < 0, count - 1, sh.cond(k >= count, 0, k))
        edge = sh.clamp(k, 0, count - 1)
        return self._chosen({"repeat": across, "clamp": edge, "mirror": edge}, mode)

    def _chosen(self, ways: dict[Any, Any], mode: Any) -> Any:
        """Select the value for the wrap that the mode says, among those that textures have."""
        used = [wrap for wrap in WRAPS if wrap in self.wraps]
        found = ways[used[0]]
        for wrap in used[1:]:
            found = sh.cond((mode & (LINEAR - 1)) == WRAPS.index(wrap), ways[wrap], found)
        return found


def _parts(texture: Texture) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Yield the texels of a picture in blocks (n, 4), each with the index of its first texel."""
    texels = texture.image.reshape(-1, 3)
    for start in range(0, len(texels), PART):
        part = texels[start : start + PART]
        yield start, np.pad(part, ((0, 0), (0, 1)))
