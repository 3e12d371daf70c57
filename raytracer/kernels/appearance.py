"""Textures and programs of a scene's materials: what they make of a point that was hit, and of the light on it.

Stage: kernel. A scene whose materials are numbers alone needs no such code. Materials are known by their places in
`Layout.materials`; of each distinct program there is one branch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.appearance.materials import LAYERED, PICTURED
from raytracer.appearance.metallic_roughness import AnyMaterial, MetallicRoughness
from raytracer.appearance.programs import (
    OF_LAYERS,
    OF_PHONG,
    Hit,
    Surface,
    ask_shade,
    ask_surface,
    examine_shade,
    examine_surface,
)
from raytracer.appearance.textures import UNMOVED, WRAPS, Texture
from raytracer.errors import SceneError, place_of
from raytracer.scene.layout import Layout
from shpy import SH_IF

Program = Callable[..., Any]
LINEAR = 4
"""Added to the number of the wrap in the mode of a texture."""
_KERNEL_NAMES = {"base_color": "color", "sheen_color": "sheen"}
"""The variables for what a program gives under other names."""
PART = 1 << 16
"""Texels that are copied at once."""


class Appearance:
    """The materials of a scene that are more than numbers.

    `surfaces` are the distinct programs that describe them, `examined` the same ones as they were recorded. `gives` are
    the names of what textures and programs decide, `reads` what programs ask of a hit, `shades` the distinct programs
    that take the place of Phong's model, and `several` whether which one it is differs. `glowing` says of each material
    whether a program decides its emission, `clears` whether it may be clear.
    Raises SceneError and ShpyError for mistakes in a program, and for a mesh whose uv coordinates are missed.
    """

    def __init__(self, layout: Layout) -> None:
        materials = layout.materials
        self.surfaces = _distinct([material.surface for material in materials])
        self.shades = _distinct([material.shade for material in materials])
        self.several = len({material.shade for material in materials}) > 1
        self.count = len(materials)
        self.examined = examinations = [examine_surface(program) for program in self.surfaces]
        for program in self.shades:
            examine_shade(program)
        names = PICTURED + LAYERED
        self.textured = [name for name in names if any(name in material.textures for material in materials)]
        self.gives = frozenset(self.textured).union(*(examined.gives for examined in examinations))
        gives = {program: examined.gives for program, examined in zip(self.surfaces, examinations, strict=True)}
        for material in materials:
            if material.surface is not None:
                _check_model(material, gives[material.surface])
        self.glowing = [
            material.surface is not None and "emission" in gives[material.surface] for material in materials
        ]
        self.clears = [
            material.is_clear or (material.surface is not None and "transmission" in gives[material.surface])
            for material in materials
        ]
        brushed = layout.brushes[:, 0] > 0
        of_uv = {"uv"} if self.textured or brushed.any() or "anisotropy" in self.gives else ()
        self.reads = frozenset(of_uv).union(*(examined.reads for examined in examinations))
        pairs = zip(self.surfaces, examinations, strict=True)
        reading = {p for p, examined in pairs if "uv" in examined.reads or "anisotropy" in examined.gives}
        for material, name, is_brushed in zip(materials, layout.without_uv, brushed, strict=True):
            if name and (material.textures or is_brushed or material.surface in reading):
                reader = "an anisotropy" if is_brushed else place_of(material.surface)
                reader = "a Texture" if material.textures else reader
                raise SceneError(f"{name}: {reader} needs uv coordinates, and the mesh has none: Mesh(..., uv=...)")
        surfaces, shades = _numbered(self.surfaces), _numbered(self.shades)
        self._numbers = [(surfaces[material.surface], shades[material.shade]) for material in materials]
        self._columns = tuple(map(set, zip(*self._numbers, strict=True)))
        if self.textured:
            textures = list(dict.fromkeys(texture for material in materials for texture in material.textures.values()))
            self.atlas = Atlas(textures)
            places = _numbered(textures)
            rows = [[places[material.textures.get(name)] - 1 for name in self.textured] for material in materials]
            self.pictures_of = sh.Table(np.array(rows, np.int32), sh.Attrib1i, "pictures_of")
        if self.count > 1 and (self.surfaces or self.several):
            self.programs = sh.Table(np.array(self._numbers, np.int32), sh.Attrib2i, "programs")

    def __bool__(self) -> bool:
        """Return True if there are textures or programs."""
        return bool(self.surfaces or self.shades or self.textured)

    def describe(self, material: Any, hit: Hit, variables: dict[str, Any], tilted: Callable[[Any], Any]) -> None:
        """Evaluate textures and programs at a point, and store the results into the variables of these names.

        They hold the material's numbers before; a texture of colours multiplies, so that vertex colours tint it.
        `tilted` gives the normal for a colour of a normal map.
        """
        for k, name in enumerate(self.textured):
            if name == "cutout" or self._has_no_effect(name, variables):  # the walk has applied a cutout
                continue
            picture = self.pictures_of[material, k]
            with SH_IF(picture >= 0):
                color = self.atlas.sample(picture, hit.uv)
                if name == "normal_map":
                    variables["normal"][:] = tilted(color)
                elif name == "color":
                    variables[name] *= color
                else:
                    variables[name][:] = color if name in ("emission", "tint", "sheen", "brush") else color.r
        for number, program in enumerate(self.surfaces, 1):
            with self._where(material, 0, number):
                for name, value in ask_surface(program, hit).values.items():
                    if not self._has_no_effect(name, variables):
                        place = variables[_KERNEL_NAMES.get(name, name)]
                        place[:] = sh.normalize(value) if name == "normal" else value
        for name in ("reflectivity", "transmission"):
            if name in self.gives:
                variables[name][:] = sh.clamp(variables[name], 0, 1)

    @staticmethod
    def _has_no_effect(name: str, variables: dict[str, Any]) -> bool:
        """Return whether a value belongs to a sheen or an anisotropy in a scene without one."""
        return name in ("sheen_roughness", "anisotropy_rotation") and name not in variables

    def number_at(self, name: str, material: Any, uv: Callable[[], Any], otherwise: Any) -> Any:
        """Return the number of a material's texture at `uv()`, which is recorded for it alone, or `otherwise`."""
        value = sh.Attrib1f(otherwise)
        picture = self.pictures_of[material, self.textured.index(name)]
        with SH_IF(picture >= 0):
            value[:] = self.atlas.sample(picture, uv()).r
        return value

    def shade_of(self, material: Any) -> Any:
        """Return the number of a material's `shade`; 0 for Phong's model."""
        return self._numbers[0][1] if self.count == 1 else self.programs[material].y

    def shade(self, number: Any, surface: Surface, light: Any, phong: Callable[[], Any]) -> Any:
        """Return the colour under white light from the direction `light` by the `shade` of this number."""
        if not self.several:
            return ask_shade(self.shades[0], surface, light)
        shown = sh.Color3f(0, 0, 0)
        for k, program in enumerate(self.shades, 1):
            with SH_IF(number == k):
                shown[:] = ask_shade(program, surface, light)
        if 0 in self._columns[1]:
            with SH_IF(number == 0):
                shown[:] = phong()
        return shown

    def _where(self, material: Any, column: int, number: int) -> AbstractContextManager[Any]:
        """Return a branch for the materials that have a program; none where all have it."""
        if self._columns[column] == {number}:
            return nullcontext()
        return SH_IF(self.programs[material][column] == number)


def _check_model(material: AnyMaterial, gives: frozenset[str]) -> None:
    """Raise SceneError for a program that gives what a material of the other model has."""
    layered = isinstance(material, MetallicRoughness)
    wrong = sorted(gives & set(OF_PHONG if layered else OF_LAYERS))
    if wrong:
        own, other = ("MetallicRoughness", "Material") if layered else ("Material", "MetallicRoughness")
        verb = "belongs" if len(wrong) == 1 else "belong"
        numbers = [f"{own}({name}=...)" for name in wrong if hasattr(material, name)]
        raise SceneError(
            f"{place_of(material.surface)}: {', '.join(wrong)} of a Surface {verb} to a {other}, and this is the "
            f"surface of a {own}: write {' or '.join([f'{other}(surface=...)', *numbers])}"
        )


def _distinct(programs: Sequence[Program | None]) -> list[Program]:
    return list(dict.fromkeys(program for program in programs if program is not None))


def _numbered(items: Sequence[Any]) -> dict[Any, int]:
    """Return the place of each program or texture, counted from 1; None has the number 0."""
    return {None: 0} | {one: number for number, one in enumerate(items, 1)}


class Atlas:
    """Textures in one table, which are known by their places among `textures`: GLSL has some 16 tables for a kernel.

    The filters are those of OpenGL 3.3 (section 3.8.11), in the language's own arithmetic.
    """

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
        self.moves = None
        if any(t.transform is not None for t in textures):
            moves = np.array([UNMOVED if t.transform is None else t.transform for t in textures], np.float32)
            self.moves = sh.Table(np.pad(moves.reshape(-1, 3), ((0, 0), (0, 1))), sh.Attrib4f, "moves")

    def sample(self, number: Any, uv: Any) -> Any:
        """Return the linear colour of texture `number` at `uv`: (0, 0) is the lower left corner of the picture."""
        start, width, height, mode = self.pictures[number]
        if self.moves is not None:
            across, down = self.moves[2 * number], self.moves[2 * number + 1]
            u = across.x * uv.x + across.y * uv.y + across.z
            uv = sh.Attrib2f(u, down.x * uv.x + down.y * uv.y + down.z)
        size = sh.Attrib2f(width, height)
        place = sh.Attrib2f(self.wrapped(uv.x, mode), self.wrapped(1 - uv.y, mode)) * size
        if "linear" not in self.filters:
            return self.nearest(place, start, width, size)
        color = sh.Color3f(self.linear(place, start, width, height, mode))
        if "nearest" in self.filters:
            with SH_IF(mode < LINEAR):
                color[:] = self.nearest(place, start, width, size)
        return color

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
        texel = ways[used[0]]
        for wrap in used[1:]:
            texel = sh.cond((mode & (LINEAR - 1)) == WRAPS.index(wrap), ways[wrap], texel)
        return texel


def _parts(texture: Texture) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Yield the texels of a picture in blocks (n, 4), each with the index of its first texel."""
    texels = texture.image.reshape(-1, 3)
    for start in range(0, len(texels), PART):
        part = texels[start : start + PART]
        yield start, np.pad(part, ((0, 0), (0, 1)))
