"""Programs of users for surfaces: their inputs, their results, and the fields that they use.

Stage: kernel. A material's `surface` runs once for each hit, its `shade` once for each light that is seen, as surface
shaders and their illuminance loops do (Hanrahan and Lawson 1990). Each distinct one is recorded once, in a branch of
its own. Before that `examine_surface` and `examine_shade` record it into a program that is thrown away: mistakes are
found before a scene is compiled, and the tracer learns what it has to hold ready.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from inspect import signature, unwrap
from typing import Any, NamedTuple, get_type_hints

import shpy as sh
from raytracer.errors import SceneError, place_of, users_line

Sources = Mapping[str, Callable[[], Any]]
"""Functions that record a value, by the value's name."""


class _Lookup:
    """Values by name, each recorded wherever it is asked for; `read` names those that were."""

    def __init__(self, sources: Sources) -> None:
        self._sources = sources
        self.read: set[str] = set()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name not in self._sources:
            names = ", ".join(self._sources or self.__dict__.get("values", ()))
            raise AttributeError(f"this {type(self).__name__} has no {name}: it has {names}")
        self.read.add(name)
        # A copy, since the user's program may change it. It is not kept, since the next read may be in another branch,
        # where the kept value would not have been computed.
        return fields_of(type(self))[name](self._sources[name]())


class Hit(_Lookup):
    """The point that a ray has met, as a material's `surface` sees it; only the attributes that it reads are computed.

    `position` is the point in the scene's coordinates and `distance` how far the ray has come, in the scene's units;
    `normal` the interpolated unit normal and `face` that of the triangle, both on the viewer's side; `view` the unit
    vector to where the ray came from. `uv` are the mesh's coordinates, and `color` its vertex colours, white where it
    has none, both interpolated. `object` is the mesh's place in the scene, `triangle` the triangle's number over all
    meshes of the scene; `outside` says whether the ray came from the side to which the corners run counter-clockwise.
    """

    position: sh.Point3f
    normal: sh.Normal3f
    face: sh.Normal3f
    view: sh.Vector3f
    uv: sh.TexCoord2f
    color: sh.Color3f
    object: sh.Attrib1i
    triangle: sh.Attrib1i
    distance: sh.Attrib1f
    outside: sh.Attrib1b


class Surface(_Lookup):
    """The result of a material's `surface` at a point; fields that it leaves out are those of the material.

    `color` is linear RGB, `diffuse`, `specular` and `shininess` Phong's coefficients, `reflectivity` the share of the
    mirror image, `transmission` the share that is clear, `ior` its refractive index, `emission` the linear radiance
    that the surface sends out, and `normal` a normal on the viewer's side, for instance one that a bump map has turned.
    A `MetallicRoughness` has `base_color` (or `color`), `metallic`, `roughness`, `specular`, `clearcoat`,
    `clearcoat_roughness`, `sheen_color`, `sheen_roughness`, `anisotropy`, `anisotropy_rotation`, `emission` and
    `normal`. Numbers and triples are taken as well as values of the language.

    A `Material`'s `shade` is handed one in which Phong's numbers, `color`, `reflectivity` and `normal` are known, and
    `position`, `face` and `view` as in a Hit. Shadows of glass are as clear as the material's own `transmission`,
    a number or a Texture.
    Raises SceneError, with the line, for values of other types.
    """

    color: sh.Color3f
    diffuse: sh.Attrib1f
    specular: sh.Attrib1f
    shininess: sh.Attrib1f
    reflectivity: sh.Attrib1f
    transmission: sh.Attrib1f
    ior: sh.Attrib1f
    normal: sh.Normal3f
    emission: sh.Color3f
    base_color: sh.Color3f
    metallic: sh.Attrib1f
    roughness: sh.Attrib1f
    clearcoat: sh.Attrib1f
    clearcoat_roughness: sh.Attrib1f
    sheen_color: sh.Color3f
    sheen_roughness: sh.Attrib1f
    anisotropy: sh.Attrib1f
    anisotropy_rotation: sh.Attrib1f
    position: sh.Point3f
    face: sh.Normal3f
    view: sh.Vector3f

    def __init__(
        self,
        *,
        color: Any = None,
        diffuse: Any = None,
        specular: Any = None,
        shininess: Any = None,
        reflectivity: Any = None,
        transmission: Any = None,
        ior: Any = None,
        normal: Any = None,
        emission: Any = None,
        base_color: Any = None,
        metallic: Any = None,
        roughness: Any = None,
        clearcoat: Any = None,
        clearcoat_roughness: Any = None,
        sheen_color: Any = None,
        sheen_roughness: Any = None,
        anisotropy: Any = None,
        anisotropy_rotation: Any = None,
    ) -> None:
        values = {
            "color": color, "diffuse": diffuse, "specular": specular, "shininess": shininess,
            "reflectivity": reflectivity, "transmission": transmission, "ior": ior, "normal": normal,
            "emission": emission, "base_color": base_color, "metallic": metallic, "roughness": roughness,
            "clearcoat": clearcoat, "clearcoat_roughness": clearcoat_roughness,
            "sheen_color": sheen_color, "sheen_roughness": sheen_roughness,
            "anisotropy": anisotropy, "anisotropy_rotation": anisotropy_rotation,
        }  # fmt: skip
        super().__init__({})
        self.values: dict[str, Any] = {
            name: converted(fields_of(Surface)[name], value, f"Surface({name}=...)", users_line())
            for name, value in values.items()
            if value is not None
        }
        self.__dict__.update(self.values)

    @classmethod
    def of_sources(cls, sources: Sources) -> Surface:
        """Return a surface all of whose fields are known."""
        surface = cls()
        surface._sources = sources
        return surface


OF_PHONG = ("diffuse", "shininess", "reflectivity", "transmission", "ior")
"""The outputs of a `surface` that only a `Material` has."""
OF_LAYERS = (
    *("base_color", "metallic", "roughness", "clearcoat", "clearcoat_roughness"),
    *("sheen_color", "sheen_roughness", "anisotropy", "anisotropy_rotation"),
)
"""The outputs of a `surface` that only a `MetallicRoughness` has."""
GIVEN: tuple[str, ...] = (
    "color",
    "diffuse",
    "specular",
    "shininess",
    "reflectivity",
    "transmission",
    "ior",
    "normal",
    "emission",
)
GIVEN += OF_LAYERS
"""The outputs that a `surface` may have."""
UNSHADED = ("transmission", "ior", "emission", *OF_LAYERS)
"""The outputs of a `surface` that `shade` does not get: it gives the colour of the opaque share under a light."""
_CUTOUT = "a cutout says where there is no surface"


@dataclass(frozen=True, slots=True)
class UserProgram:
    """A program of the user's, recorded by itself: `program` is the sh.Program.

    `reads`: fields of its hit that a `surface` reads. `gives`: fields of the Surface that it returns.
    """

    reads: frozenset[str]
    gives: frozenset[str]
    program: Any


def fields_of(cls: type[_Lookup]) -> Mapping[str, Any]:
    """Return the fields of a Hit or Surface and their types, in order."""
    return get_type_hints(cls)


def converted(cls: Any, value: Any, what: str, where: str) -> Any:
    """Convert a value to the language; raise a SceneError that begins with `where` if it cannot be converted."""
    try:
        return cls(value)
    except (sh.ShpyError, TypeError, ValueError) as error:
        message = getattr(error, "message", error)
        raise SceneError(f"{where}: {what} is an sh.{cls.__name__} ({message})") from None


def ask_surface(program: Callable[..., Any], hit: Hit) -> Surface:
    """Record a material's `surface` for a hit; SceneError where it gives no Surface."""
    if isinstance(program, sh.Program):
        names = list(program.outputs)
        outputs = _run(program, _readers(hit), "a Hit")
        if names == ["0"]:
            return Surface(color=outputs)
        wrong = [name for name in names if name not in GIVEN]
        if wrong:
            raise SceneError(
                f"{place_of(program)}: the outputs of a surface are named {', '.join(GIVEN)}, not {', '.join(wrong)}"
            )
        values = outputs if isinstance(outputs, Mapping) else {name: getattr(outputs, name) for name in names}
        return Surface(**values)
    if "SH_RETURN" in getattr(getattr(unwrap(program), "__code__", None), "co_names", ()):
        raise SceneError(
            f"{place_of(program)}: a function gives its Surface at its end, without SH_RETURN: store what differs into "
            "a variable, color[:] = ..., or make it an sh.Program from fields of a Hit to those of a Surface"
        )
    surface = _called(program, "a surface takes one input, a Hit", hit)
    if not isinstance(surface, Surface):
        raise SceneError(
            f"{place_of(program)}: a surface gives a raytracer.Surface, not {_kind(surface)}: return Surface(color=...)"
        )
    return surface


def ask_shade(program: Callable[..., Any], surface: Surface, light: Any) -> Any:
    """Record a material's `shade` for a unit vector to a light; SceneError where it gives no colour."""
    if isinstance(program, sh.Program):
        result = _run(program, {**_readers(surface), "light": lambda: light}, "a Surface with its light")
    else:
        what = "a shade takes two inputs, a Surface and the unit vector to a light"
        result = _called(program, what, surface, sh.Vector3f(light))
    if result is None:
        raise SceneError(f"{place_of(program)}: a shade gives an sh.Color3f, not None: return it")
    return converted(sh.Color3f, result, "what a shade gives", place_of(program))


def ask_sky(program: Callable[..., Any], direction: Any, whose: str) -> Any:
    """Record a program of the light from a direction for a unit vector; SceneError where it gives no colour.

    `whose` names the program's owner in errors, such as "an EnvironmentLight".
    """
    takes, where = f"the program of {whose} takes one input, a direction", place_of(program)
    if isinstance(program, sh.Program):
        needed = [name for name in program.inputs if name not in program.recorded.defaults]
        if len(needed) > 1 or not program.inputs:
            raise SceneError(f"{where}: {takes}, not {', '.join(needed) or 'none'}")
        result = program(direction)
    else:
        result = _called(program, takes, direction)
    return converted(sh.Color3f, result, f"what the program of {whose} gives", where)


def _readers(record: _Lookup) -> Sources:
    """Return the functions that read the fields of a Hit or Surface, by name."""
    return {name: partial(getattr, record, name) for name in record._sources}


def _called(program: Callable[..., Any], what: str, *values: Any) -> Any:
    """Call a user's function; SceneError, which says `what` it takes, if it does not take these values."""
    try:
        signature(program).bind(*values)
    except TypeError as error:
        raise SceneError(f"{place_of(program)}: {what} ({error})") from None
    except ValueError:  # a function of C, which has no signature
        pass
    return program(*values)


def _run(program: Any, sources: Sources, what: str) -> Any:
    inputs = [name for name in program.inputs if name in sources or name not in program.recorded.defaults]
    wrong = [name for name in inputs if name not in sources]
    if wrong:
        raise SceneError(
            f"{place_of(program)}: {', '.join(wrong)} is nothing that {what} has, which has {', '.join(sources)}: "
            "rename the input, or bind it to a number"
        )
    try:
        return program(**{name: sources[name]() for name in inputs})
    except sh.ShpyTypeError as error:
        raise SceneError(f"{place_of(program)}: {error.message}, as {what} has it") from None


_HitFields = NamedTuple("_HitFields", list(fields_of(Hit).items()))  # type: ignore[misc]


def examine_surface(program: Callable[..., Any]) -> UserProgram:
    """Record a material's `surface` by itself; raises SceneError or ShpyError for mistakes in it."""
    hits: list[Hit] = []

    @sh.program
    def surface(fields: _HitFields) -> Any:
        hits.append(Hit({name: partial(getattr, fields, name) for name in fields_of(Hit)}))
        return ask_surface(program, hits[-1]).values or sh.Attrib1f(0)

    _check_ends(program, surface, _CUTOUT)
    return UserProgram(frozenset(hits[-1].read), frozenset(surface.outputs) & set(GIVEN), surface)


def examine_sky(program: Callable[..., Any], whose: str) -> UserProgram:
    """Record a program as `ask_sky` does, by itself; raises SceneError or ShpyError for mistakes in it."""

    @sh.program
    def environment(direction: sh.Vector3f) -> sh.Color3f:
        color: sh.Color3f = ask_sky(program, direction, whose)
        return color

    _check_ends(program, environment, "give black where there is no light")
    return UserProgram(frozenset(), frozenset(), environment)


def examine_shade(program: Callable[..., Any]) -> None:
    """Record a material's `shade` by itself; raises SceneError or ShpyError for mistakes in it."""
    surface = Surface.of_sources({name: zero for name, zero in _zeros(Surface).items() if name not in UNSHADED})

    @sh.program
    def shade() -> sh.Attrib1f:
        ask_shade(program, surface, sh.Vector3f(0, 0, 1))
        return sh.Attrib1f(0)

    _check_ends(program, shade, _CUTOUT)


def _check_ends(program: Callable[..., Any], recorded: Any, cure: str) -> None:
    """Raise SceneError for a program that discards: it would end the rays of its pixel, with all light so far."""
    if recorded.recorded.discards:
        raise SceneError(f"{place_of(program)}: SH_DISCARD would end the whole pixel: {cure}")


def _zeros(cls: type[_Lookup]) -> Sources:
    def zero(kind: Any) -> Callable[[], Any]:
        return lambda: kind(False) if kind is sh.Attrib1b else kind(0)

    return {name: zero(kind) for name, kind in fields_of(cls).items()}


def _kind(value: Any) -> str:
    return "None" if value is None else f"a {type(value).__name__}"
