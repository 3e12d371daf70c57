"""The interaction of a ray with a surface: the state that a tracer keeps of the point that was hit last.

Stage: kernel. A scene has the struct with the fields that its surfaces need.
"""

from __future__ import annotations

from typing import Any, get_type_hints

import shpy as sh


@sh.struct
class PlainInteraction:
    """The interaction at the point that was hit last, from its hit until its last shadow ray.

    `inter` is moved off the surface, to the side that it is seen from. `face` is the normal of the triangle itself, on
    the viewer's side, as is `normal`; `coefficients` are diffuse, specular and shininess.
    """

    inter: sh.Point3f
    view: sh.Vector3f
    face: sh.Normal3f
    normal: sh.Normal3f
    color: sh.Color3f
    coefficients: sh.Attrib3f


@sh.struct
class ProgrammedInteraction(PlainInteraction):
    """An interaction of a scene with shades: the number of the surface's own, and the fields that shades alone read."""

    reflectivity: sh.Attrib1f
    shade: sh.Attrib1i


@sh.struct
class ClearInteraction(ProgrammedInteraction):
    """An interaction in a scene with glass.

    `beyond` is the point moved off the surface to the other side, `outside` says whether the ray came from outside.
    """

    beyond: sh.Point3f
    transmission: sh.Attrib1f
    ior: sh.Attrib1f
    outside: sh.Attrib1b


@sh.struct
class LayeredInteraction(ProgrammedInteraction):
    """An interaction in a scene with a `MetallicRoughness`; `coefficients` are metallic, specular and roughness of it.

    The first fields are those of glass, for the share that is clear.

    `is_layered` says whether the surface is one. `tint` is the specular colour and `index` the refractive index of its
    base; `coat` holds the share of the coat, its roughness, and the share of the base that is a thin clear wall.

    `Microfacets.prepare` computes the other fields. `seen` is the view above the surface. `f0` and `f90` are the shares
    that the base mirrors at normal and at grazing incidence, `upper` and `upper_edge` those of its clear layer alone.
    `matt` is the matt colour, divided by the mean of what reaches it, times what leaves it to the view. `thin` is the
    share that goes through the wall, and `straight` the probability of it where it is smooth; `through` the share that
    the coat lets pass. `mirror` and `spread` are the shares of light from everywhere that a Whitted tracer mirrors and
    scatters. `chances` are the probabilities of a rough thin wall (z), of the coat in the rest (x), and of the base's
    mirror in the rest (y).
    """

    beyond: sh.Point3f
    transmission: sh.Attrib1f
    ior: sh.Attrib1f
    outside: sh.Attrib1b
    is_layered: sh.Attrib1b
    tint: sh.Color3f
    index: sh.Attrib1f
    coat: sh.Attrib3f
    seen: sh.Vector3f
    f0: sh.Color3f
    f90: sh.Attrib1f
    upper: sh.Color3f
    upper_edge: sh.Attrib1f
    matt: sh.Color3f
    thin: sh.Color3f
    straight: sh.Attrib1f
    through: sh.Attrib1f
    mirror: sh.Color3f
    spread: sh.Color3f
    chances: sh.Attrib3f


@sh.struct
class SheenInteraction(LayeredInteraction):
    """A `LayeredInteraction` in a scene with a sheen, of the colour `sheen`.

    `fuzz` holds its roughness, the share of the light that it lets pass to the view, and the probability of its lobe in
    what the coat leaves.
    """

    sheen: sh.Color3f
    fuzz: sh.Attrib3f


@sh.struct
class DetailedInteraction(SheenInteraction):
    """An interaction in a scene with an anisotropy, with bodies, or whose microfacets lose no light: all fields.

    `anisotropy` is its strength, `rotation` its angle to where u grows, in degrees, and `brush` the colour of its
    picture. Of it `tangent`, a unit vector, is the direction along which the surface is rougher, and `bounds` are the
    roughnesses between which that of an isotropic surface of its albedo lies; the larger one is that along the tangent.
    `gain` is the factor of what the base mirrors. `is_body` says whether what is clear belongs to a body, which is
    rough and has the colour of the base.
    """

    anisotropy: sh.Attrib1f
    rotation: sh.Attrib1f
    brush: sh.Color3f
    tangent: sh.Vector3f
    bounds: sh.Attrib2f
    gain: sh.Color3f
    is_body: sh.Attrib1b


Interaction = Any
"""One of these structs, as the scene needs."""


def blank(interaction: Any = PlainInteraction) -> Interaction:
    """Return an interaction before the first hit."""
    fields = {name: kind for name, kind in get_type_hints(interaction).items() if not name.startswith("_")}
    return interaction(*(kind(*[0] * kind.size) for kind in fields.values()))
