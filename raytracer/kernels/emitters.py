"""The light that a path tracer aims at: placed lights, triangles that shine, and what is around the scene.

Stage: kernel. One of them is chosen for each surface, by a rough guess of the light that it sends there. A point on a
triangle is chosen evenly, a direction to the environment by how far its picture is brighter there than its mean, or by
the cosine.
"""

from __future__ import annotations

from collections.abc import Callable
from math import pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.accel.bounds import FAR
from raytracer.accel.space import Rows
from raytracer.kernels.directions import around
from raytracer.kernels.interactions import Interaction, blank
from raytracer.kernels.kinds import glow_rows
from raytracer.kernels.point import barylerp
from raytracer.kernels.points import part_of
from raytracer.kernels.scene_tables import LightList
from raytracer.kernels.sky import EnvironmentSky, turn_of
from raytracer.kernels.surfaces import SurfaceTables
from raytracer.kernels.triangle import CandidateHit, RayHit
from raytracer.scene.layout import Layout
from raytracer.scene.lights import EnvironmentLight
from shpy import SH_IF

NEARER = 1 - 2.0**-13
"""The end of a shadow ray to a point on a triangle, as a part of the distance: rounding may move the triangle."""
FINEST = 256
"""Rows of the table of an environment's brightness, at most; it has twice as many columns."""
EVERYWHERE = 1 / 64
"""The weight that each cell has at least, in units of the mean, so that each direction has a density."""
Floats = NDArray[np.float64]
ONE = 1 << 24
"""A threshold that every number is below."""


class Aim:
    """A ray toward a light: its direction, its length, and the light that it would bring.

    `incoming` is the light's radiance divided by the density with which the direction was chosen; `density` that with
    which `Emitters` would choose it, per steradian, 0 where no other ray could find the light. `around` says whether
    the environment's radiance is still to be multiplied.
    """

    def __init__(self) -> None:
        ray = sh.Vector3f(0, 0, 1)
        limit = sh.Attrib1f(0)
        incoming = sh.Color3f(0, 0, 0)
        density = sh.Attrib1f(0)
        around = sh.Attrib1b(False)
        self.ray, self.limit, self.incoming, self.density, self.around = ray, limit, incoming, density, around


class Choices(NamedTuple):
    """The weights of lights, their numbers and areas; how many are triangles; the factor of a triangle's density."""

    weights: NDArray[np.float64]
    numbers: NDArray[np.int64]
    per: NDArray[np.float64]
    shining: int
    per_glow: float


class Emitters:
    """The lights of a scene; `features` says which there are."""

    def __init__(self, layout: Layout, surfaces: SurfaceTables, environment: EnvironmentLight | None) -> None:
        self.surfaces = surfaces
        self.placed = LightList(layout, surfaces)
        self.around = None if environment is None else Environment(environment)
        choices = self._choices(layout)
        self.shining, self.count = choices.shining, len(choices.weights)
        self.features: dict[str, bool | int] = {"emissive triangles": self.shining, "environment": bool(self.around)}
        if not self.count:
            return
        self.chances = Chances(*choices[:3], "emitters")
        self.share_around = sh.Param(sh.Attrib1f, float(self.chances.probabilities[-1]), name="share_around")
        if self.shining:
            self.per_glow = sh.Param(sh.Attrib1f, choices.per_glow, name="per_glow")
        self.first = sh.Param(sh.Attrib1i, self.placed.count, name="first_shining")
        self.last = sh.Param(sh.Attrib1i, self.placed.count + self.shining, name="past_shining")

    def _choices(self, layout: Layout) -> Choices:
        """Return what can be chosen: the placed lights, the triangles that shine, what is around."""
        low, high = layout.box
        size = float(np.linalg.norm(high - low))
        fading = layout.lights[1::2, 3] > 0
        shining, areas, glows = shining_triangles(layout, glow_rows(layout, self.surfaces.appearance))
        weights = np.concatenate([
            pi * np.abs(layout.lights[1::2, :3]).mean(axis=1) / np.where(fading, (size / layout.scale) ** 2, 1),
            areas * glows / size**2 if len(areas) else [],
            [] if self.around is None else [pi * self.around.mean],
        ])  # fmt: skip
        if not weights.any():
            weights += 1.0  # all lights are black: choose each with the same probability
        numbers = np.concatenate([np.arange(self.placed.count), shining, [0] * bool(self.around)])
        per = np.concatenate([np.ones(self.placed.count), areas, [1.0] * bool(self.around)])
        per_glow = 1 / (size**2 * float(weights.sum())) if len(shining) else 0.0
        return Choices(weights, numbers, per, len(shining), per_glow)

    def renew(self, layout: Layout) -> bool:
        """Take other places of the triangles, emissions and lights, as many of these and of the same kinds.

        Return False, having changed nothing, if another number of triangles shines.
        """
        if not self.count:
            return True
        choices = self._choices(layout)
        if choices.shining != self.shining:
            return False
        self.chances.renew(*choices[:3])
        self.share_around.value = float(self.chances.probabilities[-1])
        if self.shining:
            self.per_glow.value = choices.per_glow
        return True

    def aim(self, surface: Interaction, words: Callable[[int], tuple[Any, Any]]) -> Aim:
        """Choose a light for a surface, and a direction to it; `words(k)` are two random ones, for k of 0 and 2."""
        aim = Aim()
        place, number, density = self.chances.choose(*words(0))
        place_words = words(2)
        u, v = map(sh.unit_float, place_words)
        if self.placed.count:
            with SH_IF(place < self.first):
                self._aim_placed(aim, surface, number, density)
        if self.shining:
            with SH_IF((place >= self.first) & (place < self.last)):
                self._aim_triangle(aim, surface, number, density, u, v)
        if self.around is not None:
            with SH_IF(place >= self.last):
                self._aim_around(aim, self.around, surface, place_words)
        return aim

    def _aim_placed(self, aim: Aim, surface: Interaction, number: Any, chance: Any) -> None:
        eye = sh.Point3f(0, 0, 0)
        color = sh.Color3f(0, 0, 0)
        self.placed.aim(number, surface, aim.ray, eye, aim.limit, color)
        aim.incoming[:] = (pi / chance) * color

    def _aim_triangle(self, aim: Aim, surface: Interaction, number: Any, density: Any, u: Any, v: Any) -> None:
        hit = RayHit(FAR)
        over = u + v > 1
        hit.id[:] = number
        hit.uv[:] = sh.TexCoord2f(sh.cond(over, 1 - u, u), sh.cond(over, 1 - v, v))
        corners = self.surfaces.triangles[number]
        toward = barylerp(hit, *(corner.xyz for corner in corners)) - surface.inter
        square = sh.dot(toward, toward)
        with SH_IF(square > 0):
            hit.l[:] = sh.sqrt(square)
            aim.ray[:] = toward / hit.l
            cosine = abs(sh.dot(sh.Normal3f(*(corner.w for corner in corners)), aim.ray))
            glow = self.surfaces.glow_at(hit)
            emission = sh.Color3f(glow.rgb)
            if "emission" in self.surfaces.appearance.gives:
                self.surfaces.arrive(hit, aim.ray, surface.inter, blank(self.surfaces.interaction), emission)
            if self.surfaces.accept is not None:
                emission *= sh.cond(self.surfaces.accept(CandidateHit(number, hit.uv)), 1.0, 0.0)
            with SH_IF(cosine > 0):
                aim.incoming[:] = (cosine / (square * density)) * emission
                aim.density[:] = self.per_glow * glow.w * square / cosine
                aim.limit[:] = NEARER * hit.l

    def _aim_around(self, aim: Aim, around: Environment, surface: Interaction, words: tuple[Any, Any]) -> None:
        ray, density = around.sample(surface, words)
        aim.ray[:] = ray
        aim.density[:] = self.share_around * density
        with SH_IF(density > 0):
            aim.incoming[:] = sh.Color3f(1, 1, 1) / aim.density
            aim.limit[:] = FAR
        aim.around[:] = True

    def density_of(self, hit: RayHit, ray: Any, face: Any, way: Any) -> Any:
        """Return the density, per steradian, with which `aim` chooses the direction to the triangle that was hit.

        `way` is its distance from where the ray was scattered.
        """
        if not self.shining:  # pictures or programs give no emission that is known before
            return sh.Attrib1f(0)
        return self.per_glow * self.surfaces.glow_at(hit).w * way * way / abs(sh.dot(face, ray))


class Environment(EnvironmentSky):
    """The light around a scene, and how it is sampled; `mean` is its mean radiance, over the channels too."""

    def __init__(self, light: EnvironmentLight) -> None:
        super().__init__(light)
        self.cells: BrightCells | None = None
        self.mean = light.strength * (1.0 if light.color is None else float(np.mean(light.color)))
        if light.picture is None:
            return
        brightness = brightness_table(light.picture.image)
        self.mean = light.strength * float(brightness.mean())
        self.cells = BrightCells(aimed_weights(brightness))

    def sample(self, surface: Interaction, words: tuple[Any, Any]) -> tuple[Any, Any]:
        """Sample a direction, and its density, by two random words."""
        if self.cells is None:
            u, v = map(sh.unit_float, words)
            cosine = sh.sqrt(1 - u)
            return around(surface.normal, cosine, v), cosine * (1 / pi)
        down, across, density = self.cells.choose(*words)
        height = 1 - down * (2 / self.cells.rows)
        angle = across * (2 * pi / self.cells.columns)
        radius = sh.sqrt(sh.max(1 - height * height, 0.0))
        ray = sh.normalize(sh.Vector3f(-radius * sh.sin(angle), height, radius * sh.cos(angle)))
        return self.turned(ray), density

    def density_at(self, ray: Any, surface: Interaction) -> Any:
        """Return the density with which `sample` chooses a direction from a surface."""
        if self.cells is None:
            return sh.max(sh.dot(surface.normal, ray), 0.0) * (1 / pi)
        ray = self.turned(ray, back=True)
        rows, columns = self.cells.rows, self.cells.columns
        row = sh.clamp(sh.Attrib1i((1 - ray.y) * (rows / 2)), 0, rows - 1)
        column = sh.clamp(sh.Attrib1i(turn_of(ray) * columns), 0, columns - 1)
        return self.cells.densities[row, column]


class BrightCells:
    """The cells of the sphere, all of the same area, with probabilities in proportion to `weights` (rows, columns).

    Words choose a cell, and a place in it, by the inverse of the cumulative distributions of rows and of columns in a
    row. The map is monotone, so that points that are spread evenly stay so: with a table of aliases the median error of
    a pixel under a sky with a sun is 1.2 times as large.
    """

    def __init__(self, weights: Floats) -> None:
        self.rows, self.columns = weights.shape
        lines = weights.sum(axis=1)
        starts = np.stack([_starts(line) for line in weights])
        self._lines = sh.Table(_starts(lines), sh.Attrib1u, "bright_rows")
        self._starts = sh.Table(starts, sh.Attrib1u, "bright_columns")
        shares = _widths(_starts(lines))[:, None] * _widths(starts)
        self.densities = sh.Table(np.float32(shares * (weights.size / (4 * pi))), sh.Attrib1f, "bright_densities")

    def choose(self, first: Any, second: Any) -> tuple[Any, Any, Any]:
        """Return a place, in rows and in columns, and the density of its direction, by two random words."""
        row = _cell_of(first, self.rows, lambda k: self._lines[k])
        column = _cell_of(second, self.columns, lambda k: self._starts[row, k])
        down = _place_in(first, row, lambda k: self._lines[k])
        across = _place_in(second, column, lambda k: self._starts[row, k])
        return down, across, self.densities[row, column]


def _starts(weights: Floats) -> NDArray[np.uint32]:
    """Return the words at which the intervals of n weights begin, and 0, the end of the last one: (n + 1,)."""
    sums = np.concatenate([[0.0], np.cumsum(weights)[:-1]])
    starts = np.minimum(np.rint(sums * (2.0**32 / weights.sum())), 2.0**32 - 1)
    return np.append(starts, 0).astype(np.uint32)


def _widths(starts: NDArray[np.uint32]) -> Floats:
    """Return the probabilities of intervals."""
    ends = starts.astype(np.float64)
    ends[..., -1] = 2.0**32
    return np.diff(ends) / 2.0**32


def _cell_of(word: Any, count: int, start_of: Callable[[Any], Any]) -> Any:
    """Return the last of `count` intervals that begins at a word or before it, by bisection."""
    cell, step = sh.Attrib1i(0), 1 << max(count - 1, 1).bit_length()
    while step := step // 2:
        middle = cell + step
        cell = sh.cond((middle < count) & (start_of(sh.min(middle, count - 1)) <= word), middle, cell)
    return cell


def _place_in(word: Any, cell: Any, start_of: Callable[[Any], Any]) -> Any:
    """Return the place of a word in units of intervals, the number of its own plus a part of it."""
    start = start_of(cell)
    width = sh.max(start_of(cell + 1) - start, sh.Attrib1u(1))
    return sh.Attrib1f(cell) + sh.min(sh.Attrib1f(word - start) / sh.Attrib1f(width), 1.0)


def aimed_weights(brightness: Floats) -> Floats:
    """Return the weights by which rays are aimed at cells of this brightness: what is above the mean.

    Scattered rays find even light with as little noise, and leave to others what is bright (Karlík and others 2019, MIS
    Compensation). In variances of weights in proportion to the brightness: .51 for gold and plastic under a sky with a
    sun (`benchmarks --only equal-error`), and for five balls under a sky with a sun .66, bright panels .71, noise .86,
    an overcast sky .99 and even gradients 1.05 to 1.15.
    """
    mean = brightness.mean() or 1.0
    return np.maximum(brightness - mean, 0) + EVERYWHERE * mean


def brightness_table(image: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the mean brightness of parts of the sphere of equal area: rows by height, columns by angle.

    The light of a texel is spread as far as filtering spreads it, so that no cell is missed, where texels are large.
    """
    height, width = image.shape[:2]
    rows, columns = min(height, FINEST), min(width, 2 * FINEST)
    offsets = np.linspace(-0.8, 0.8, 5) if height <= 2 * FINEST else np.zeros(1)
    y, x = np.mgrid[:height, :width] + 0.5
    edges = np.cos(np.linspace(0, pi, height + 1))
    light = image.mean(axis=2, dtype=np.float64) * (edges[:-1] - edges[1:])[:, None] / (2 * width)
    sums = np.zeros(rows * columns)
    for down in offsets:
        for across in offsets:
            level = np.cos(np.clip((y + down) / height, 0, 1) * pi)
            row = np.minimum(((1 - level) * (rows / 2)).astype(int), rows - 1)
            column = ((x + across) % width * (columns / width)).astype(int) % columns
            sums += np.bincount((row * columns + column).ravel(), (light / len(offsets) ** 2).ravel(), len(sums))
    return (sums * len(sums)).reshape(rows, columns)


def shining_triangles(layout: Layout, glow: Rows) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the numbers of the triangles that shine, their areas, and their expected brightness.

    `glow` are the rows of `glow_rows`.
    """
    glows = glow[layout.material_of[: layout.settled], 3]  # instances do not shine
    shining = np.flatnonzero(glows > 0)
    corners = layout.triangles[:, :3].reshape(-1, 3, 3)[shining]
    a, b, c = corners.astype(np.float64).swapaxes(0, 1)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    there = areas > 0
    return shining[there], areas[there], glows[shining[there]]


class Chances:
    """A table of n choices with these weights, which are not negative and not all 0.

    `probabilities` (n,) are those of the choices. Each has a number and a density of its own, which `choose` gives.
    """

    def __init__(self, weights: Floats, numbers: Any, per: Any = 1.0, name: str = "chances") -> None:
        self.count = len(weights)
        self.table = sh.Table(self._rows(weights, numbers, per), sh.Attrib4u, name)
        self.number = sh.Param(sh.Attrib1u, self.count, name=f"{name}_count")

    def renew(self, weights: Floats, numbers: Any, per: Any = 1.0) -> None:
        """Take other weights, of as many choices."""
        self.table.update(self._rows(weights, numbers, per))

    def _rows(self, weights: Floats, numbers: Any, per: Any) -> NDArray[np.uint32]:
        thresholds, aliases = alias_table(weights)
        self.probabilities = probabilities_of(thresholds, aliases)
        self.densities = (self.probabilities / per).astype(np.float32)
        self.numbers = np.asarray(numbers)
        rows = np.stack([thresholds, aliases, self.densities.view(np.uint32), self.numbers.astype(np.uint32)], axis=1)
        return rows.astype(np.uint32)

    def choose(self, which: Any, instead: Any) -> tuple[Any, Any, Any]:
        """Return the place, number and density of the choice that two random words make."""
        if self.count == 1:
            only = self.table[0]
            return sh.Attrib1i(0), sh.Attrib1i(only.w), sh.float_from_bits(only.z)
        first = part_of(which, self.number)
        row = self.table[sh.Attrib1i(first)]
        place = sh.Attrib1i(sh.min(sh.cond((instead >> 8) < row.x, first, row.y), self.number - 1))
        chosen = self.table[place]
        return place, sh.Attrib1i(chosen.w), sh.float_from_bits(chosen.z)


def alias_table(weights: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the thresholds, in parts of `ONE`, below which a choice stands, and the choice that replaces it."""
    count = len(weights)
    shares = weights * (count / weights.sum())
    aliases = np.arange(count)
    rest = shares.tolist()
    small = [k for k, share in enumerate(rest) if share < 1]
    large = [k for k, share in enumerate(rest) if share >= 1]
    kept = [1.0] * count
    while small and large:
        low, high = small.pop(), large[-1]
        kept[low] = rest[low]
        aliases[low] = high
        rest[high] -= 1 - rest[low]
        if rest[high] < 1:
            small.append(large.pop())
    thresholds = np.rint(np.array(kept) * ONE).astype(np.int64)
    return np.maximum(thresholds, weights > 0), aliases


def probabilities_of(thresholds: NDArray[np.int64], aliases: NDArray[np.int64]) -> Floats:
    """Return the probability of each choice, (n,)."""
    count = len(thresholds)
    words = np.diff(-(-(np.arange(count + 1) << 32) // count))  # those for which `part_of` gives each place
    kept = words * (thresholds / ONE)
    return (kept + np.bincount(aliases, words - kept, count)) / 2.0**32
