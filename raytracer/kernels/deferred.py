"""The colours and normals of the samples of layered depth cubes, for deferred shading as in the paper.

Stage: kernel. Source: Bürger et al., GPU Rendering of Secondary Effects (VMV 2007), section 1.2. Each
sample is shaded once by the program that shades hits, from the front of its triangle. Its colour takes three times 10
bits, clamped to [0, 1], its normal two times 16, on the octahedron (Meyer et al. 2010). The samples of an object that
changes are shaded anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.errors import SceneError
from raytracer.kernels.interactions import blank
from raytracer.kernels.surfaces import SurfaceTables
from raytracer.kernels.triangle import RayHit
from raytracer.layered.cube import LayeredCube
from raytracer.layered.placed import PlacedCubes

KEPT = frozenset({"color", "normal", "normal_map", "cutout"})
"""The fields that textures and programs may decide: those that samples keep, and cutouts, which the walk applies."""
PASSING = ("view", "distance", "outside")
"""The fields of a hit that programs may not read, as they differ from ray to ray."""
_COLOR, _NORMAL = 1023, 65534
"""The largest numbers of a channel of colour and of a coordinate of a normal, which is even, so that axes are exact."""


class Shade(NamedTuple):
    """A sample's colour and normal, packed."""

    color: sh.Attrib1u
    normal: sh.Attrib1u


class SampledSurfaces:
    """The colours and normals of the samples of `cube`, shaded on `backend` by the programs of `surfaces`.

    Raises SceneError for textures and programs that decide more than colours and normals, or that read what differs
    from ray to ray.
    """

    def __init__(self, surfaces: SurfaceTables, cube: LayeredCube | PlacedCubes, backend: str) -> None:
        _check(surfaces)
        self._inputs = cube.numbers_of, cube.weights
        self._program = _program(surfaces)
        self._kernel = self._program.compile(backend, loop_limit=None)
        self._table = sh.Table(self._shade(), sh.Attrib2u, "shades")
        self._shaded_with = self._data()

    def renew(self, ranges: Sequence[tuple[int, int]] | None = None) -> None:
        """Shade again the samples of the triangles in these ranges (first, past), or all samples."""
        if ranges is None:
            self._table.update(self._shade())
        triangles = self._inputs[0]
        for first, past in ranges or ():
            samples = np.flatnonzero((triangles >= first) & (triangles < past))
            if len(samples):  # an object's samples lie together
                span = slice(samples[0], samples[-1] + 1)
                self._table.update(self._shade(span), start=int(samples[0]))
        self._shaded_with = self._data()

    def follow(self) -> None:
        """Shade all samples anew if a Param or a Table of their programs has changed since they were shaded."""
        if self._data() != self._shaded_with:
            self.renew()

    def _data(self) -> list[Any]:
        """Return the values of Params and the versions of Tables that samples are shaded with."""
        values = [np.asarray(param).tobytes() for param in self._program.recorded.params.values()]
        return [*values, *(table.data(np.float32).version for table in self._program.recorded.tables.values())]

    def at(self, sample: Any) -> tuple[Any, Any]:
        """Return the normal on the front of the surface, and the colour."""
        row = self._table[sample]
        return unpacked_normal(row.y), unpacked_color(row.x)

    def _shade(self, span: slice = slice(None)) -> NDArray[np.uint32]:
        if not len(self._inputs[0]):
            return np.zeros((1, 2), np.uint32)
        return np.stack([np.asarray(part) for part in self._kernel(*(column[span] for column in self._inputs))], axis=1)


def _check(surfaces: SurfaceTables) -> None:
    appearance = surfaces.appearance
    for names, does in ((appearance.gives - KEPT, "decides"), (appearance.reads & set(PASSING), "reads")):
        if names:
            raise SceneError(
                f'shading="deferred" keeps the colours and normals of samples, and a texture or program {does} '
                f'{", ".join(sorted(names))}: make the cube with shading="exact"'
            )


def _program(surfaces: SurfaceTables) -> Any:
    @sh.program
    def shade_samples(triangle: sh.Attrib1i, weights: sh.Attrib2f) -> Shade:
        hit = RayHit(1.0)
        hit.id[:] = triangle
        hit.uv[:] = weights
        corner, *_ = rows = surfaces.triangles[hit.id]
        front = sh.Vector3f(*(row.w for row in rows))
        surface = blank(surfaces.interaction)
        if surfaces.kinds.unlit:
            glow = sh.Color3f(0, 0, 0)
            surfaces.arrive(hit, -front, corner.xyz + front, surface, glow)
            surface.color[:] = sh.cond(surfaces.glow_at(hit).w < 0, glow, surface.color)
        else:
            surfaces.arrive(hit, -front, corner.xyz + front, surface, sh.Color3f(0, 0, 0))
        return Shade(packed_color(surface.color), packed_normal(surface.normal))

    return shade_samples


def packed_color(color: Any) -> Any:
    """Return a colour as 10 bits for each channel, clamped to [0, 1]."""
    red, green, blue = (sh.Attrib1u(sh.floor(sh.clamp(part, 0, 1) * _COLOR + 0.5)) for part in color)
    return red | green << 10 | blue << 20


def unpacked_color(word: Any) -> Any:
    """Return the colour of `packed_color`."""
    return sh.Color3f(*(sh.Attrib1f(word >> shift & _COLOR) / _COLOR for shift in (0, 10, 20)))


def packed_normal(normal: Any) -> Any:
    """Return a unit vector in octahedral encoding: two coordinates of 16 bits each, in one uint."""
    x, y, z = normal
    whole = abs(x) + abs(y) + abs(z)
    x, y = x / whole, y / whole
    folded = sh.cond(x < 0, abs(y) - 1, 1 - abs(y)), sh.cond(y < 0, abs(x) - 1, 1 - abs(x))
    places = (sh.cond(z < 0, other, own) for own, other in zip((x, y), folded, strict=True))
    across, down = (sh.Attrib1u(sh.floor((0.5 * place + 0.5) * _NORMAL + 0.5)) for place in places)
    return across | down << 16


def unpacked_normal(word: Any) -> Any:
    """Return the unit vector of `packed_normal`."""
    x, y = (2 * (sh.Attrib1f(word >> shift & 0xFFFF) / _NORMAL) - 1 for shift in (0, 16))
    z = 1 - abs(x) - abs(y)
    behind = sh.max(-z, 0)
    x, y = (part + sh.cond(part < 0, behind, -behind) for part in (x, y))
    return sh.normalize(sh.Normal3f(x, y, z))
