"""The part of the language that is written in the language: hash, noise, texture filtering.

Stage: record. Each is a subroutine, so it stays a function of its own in the emitted text and gives the same bits on
every target.

    sh.hash(3, 5)         # a pseudo-random u
    sh.noise(p)           # a float that changes slowly with the point p

Sources: PCG: O'Neill 2014, in the form of Jarzynski and Olano 2020; gradient noise: Perlin 2002 (its fade curve), with
gradients taken from the hash.
"""

from __future__ import annotations

import builtins
from collections.abc import Callable, Sequence
from typing import Any, Final

from shpy.errors import ShpyTypeError
from shpy.ir.types import Base
from shpy.lang.functions.subroutine import Subroutine
from shpy.lang.recording.location import here
from shpy.lang.values import arithmetic
from shpy.lang.values.builtins import clamp, cond, dot, floor, fract, min, mix, unit_float
from shpy.lang.values.types import Attrib1f, Attrib1i, Attrib1u, Attrib2f, Attrib2u, Attrib3f
from shpy.lang.values.value import CLASSES, Value

_STEP = 747796405


def _scramble(state: Attrib1u) -> Any:
    word = ((state >> ((state >> 28) + 4)) ^ state) * 277803737
    return (word >> 22) ^ word


scramble = Subroutine(_scramble, "scramble")


def _pcg(x: Attrib1u) -> Any:
    return scramble(x * _STEP + 2891336453)


pcg = Subroutine(_pcg, "pcg")


def _pcg_pair(x: Attrib1u) -> Any:
    """Return pcg(x) and pcg(x + 1). One multiplication serves both, as their states differ by a constant."""
    state = x * _STEP + 2891336453
    return scramble(state), scramble(state + _STEP)


def hash(x: Any, y: Any = None, z: Any = None) -> Any:
    """Return a hash of one to three words u with PCG, as u. An i is converted and wraps.

    The last word is hashed first, and each hash is added to the word before it.
    """
    words = [_unsigned(w) for w in (x, *(w for w in (y, z) if w is not None))]
    result = pcg(words[-1])
    for word in reversed(words[:-1]):
        result = pcg(word + result)
    return result


def _unsigned(x: Any) -> Any:
    operand = arithmetic.operand(x, "sh.hash")
    whole = operand.base in (Base.U, Base.I) if isinstance(operand, Value) else operand.weak == "int"
    if operand.size != 1 or not whole:
        vector = f"sh.hash({', '.join('v.xyz'[:2] + c for c in 'xyzw'[: builtins.min(operand.size, 3)])})"
        raise ShpyTypeError(
            "sh.hash takes one to three u, or i, which wraps",
            loc=here(),
            cure=vector if operand.size != 1 else "sh.hash(sh.bits_from_float(x)) for a float, sh.hash(sh.Attrib1i(x))",
        )
    if not isinstance(operand, Value) and -(2**31) <= operand.components[0] < 0:
        return Attrib1u(operand.components[0] + 2**32)
    return Attrib1u(x)


def _gradient1(h: Attrib1u) -> Any:
    return unit_float(h) * 2 - 1


def _gradient2(h: Attrib1u) -> Any:
    return unit_float(Attrib2u(h << 16, h & 0xFFFF0000)) * 2 - 1


def _gradient3(h: Attrib1u) -> Any:
    return Attrib3f(h & 0x3FF, (h >> 10) & 0x3FF, (h >> 20) & 0x3FF) * 2.0**-9 - 1


def _fade(t: Any) -> Any:
    return t * t * t * (t * (t * 6 - 15) + 10)


def _noise1(p: Attrib1f) -> Any:
    cell = Attrib1u(Attrib1i(floor(p)))
    t = p - floor(p)
    left, right = _pcg_pair(cell)
    a = gradient1(left) * t
    b = gradient1(right) * (t - 1)
    return mix(a, b, _fade(t)) * 2


def _noise2(p: Attrib2f) -> Any:
    cell = floor(p)
    x = Attrib1u(Attrib1i(cell.x))
    y = Attrib1u(Attrib1i(cell.y))
    t = p - cell
    low, high = _pcg_pair(y)
    h00, h10 = _pcg_pair(x + low)
    h01, h11 = _pcg_pair(x + high)
    n00 = dot(gradient2(h00), t)
    n10 = dot(gradient2(h10), t - (1, 0))
    n01 = dot(gradient2(h01), t - (0, 1))
    n11 = dot(gradient2(h11), t - (1, 1))
    fade = _fade(t)
    return mix(mix(n00, n10, fade.x), mix(n01, n11, fade.x), fade.y)


def _noise3(p: Attrib3f) -> Any:
    cell = floor(p)
    x = Attrib1u(Attrib1i(cell.x))
    y = Attrib1u(Attrib1i(cell.y))
    z = Attrib1u(Attrib1i(cell.z))
    t = p - cell
    fade = _fade(t)
    layers = []
    for k, depth in enumerate(_pcg_pair(z)):
        rows = []
        for j, row in enumerate(_pcg_pair(y + depth)):
            left, right = _pcg_pair(x + row)
            a = dot(gradient3(left), t - (0, j, k))
            b = dot(gradient3(right), t - (1, j, k))
            rows.append(mix(a, b, fade.x))
        layers.append(mix(rows[0], rows[1], fade.y))
    return mix(layers[0], layers[1], fade.z)


gradient1 = Subroutine(_gradient1, "gradient1")
gradient2 = Subroutine(_gradient2, "gradient2")
gradient3 = Subroutine(_gradient3, "gradient3")
_NOISE = {1: Subroutine(_noise1, "noise1"), 2: Subroutine(_noise2, "noise2"), 3: Subroutine(_noise3, "noise3")}
_POINTS = {1: Attrib1f, 2: Attrib2f, 3: Attrib3f}


def noise(p: Any) -> Any:
    """Return signed gradient noise of a point of 1 to 3 dimensions: continuous, 0 on whole numbers, about -1 to 1."""
    operand = arithmetic.operand(p, "sh.noise")
    if operand.size not in _NOISE:
        raise ShpyTypeError("sh.noise takes one to three floats", loc=here(), cure="sh.noise(p.xyz)")
    if operand.base is Base.B if isinstance(operand, Value) else operand.weak == "bool":
        raise ShpyTypeError(
            "sh.noise does not take b", loc=here(), cure="sh.cond(c, 1.0, 0.0) makes a number of a bool"
        )
    return _NOISE[operand.size](_POINTS[operand.size](p))


def _trip_count(start: Attrib1i, stop: Attrib1i, step: Attrib1i) -> Any:
    up = step > 0
    distance = cond(up, Attrib1u(stop) - Attrib1u(start), Attrib1u(start) - Attrib1u(stop))
    stride = cond(up, Attrib1u(step), 0 - Attrib1u(step))
    some = (up & (start < stop)) | ((step < 0) & (start > stop))
    return cond(some, (distance - 1) // stride + 1, Attrib1u(0))


trip_count = Subroutine(_trip_count, "trip_count")
"""The number of iterations of SH_FOR: the length of range(start, stop, step); 0 for a step of 0."""


Wrap = tuple[Callable[[Any], Any], Callable[[Any, Any], Any]]
"""The continuation of an axis outside of [0, 1]: it maps a coordinate, and an index on the axis.

Far outside, the fraction of a repeated texture and the edge of a clamped one are all that is left of a coordinate.
"""


def _mirrored(i: Any, extent: Any) -> Any:
    """Return the mirrored index: 0, 1, …, n - 1, n - 1, …, 1, 0, 0, 1 and so on."""
    forth = i % (2 * extent)
    return min(forth, 2 * extent - 1 - forth)


WRAPS: Final[dict[str, Wrap]] = {
    "clamp": (lambda x: clamp(x, -1, 2), lambda i, extent: i),  # the table gives the nearest
    "repeat": (fract, lambda i, extent: i % extent),
    "mirror": (lambda x: 2 * fract(0.5 * x), _mirrored),
}


def _either(repeat: Any) -> Wrap:
    """Return the wrap of a texture input: "repeat" where the bool `repeat`, known at run time, holds, else "clamp"."""
    return (
        lambda x: cond(repeat, fract(x), clamp(x, -1, 2)),
        lambda i, extent: cond(repeat, i % extent, i),
    )


def _cubic(t: Any) -> list[Any]:
    """Return the Catmull-Rom weights of four texels at t in [0, 1] from the second (Keys 1981, a = -1/2)."""
    return [
        t * (t * (1 - 0.5 * t) - 0.5),
        t * t * (1.5 * t - 2.5) + 1,
        t * (t * (2 - 1.5 * t) + 0.5),
        t * t * (0.5 * t - 0.5),
    ]


def filtered(
    uv: Any, extents: Sequence[Any], wraps: Sequence[Wrap], linear: Any, cubic: bool, fetch: Callable[..., Any]
) -> Any:
    """Return the filtered texel at texture coordinates: the nearest one, or linear or cubic interpolation.

    `fetch` returns the texel of an index on each axis, the last axis first. `wraps` has the wrap of each axis. `linear`
    is a bool, or a value of the language for a texture that is known only at run time.
    """
    axes = len(extents)
    point, index = CLASSES["Attrib", axes, Base.F], CLASSES["Attrib", axes, Base.I]
    if all(wrap is wraps[0] for wrap in wraps):
        inside = wraps[0][0](uv)
    else:
        inside = point(*(wraps[k][0](uv[k]) for k in range(axes)))
    place = inside * point(*extents)

    def texel(cell: Any) -> Any:
        return fetch(*(wraps[k][1](cell[k], extents[k]) for k in reversed(range(axes))))

    if linear is False:
        return texel(index(floor(place)))
    shift = 0.5 if linear is True else cond(linear, 0.5, 0.0)
    corner = floor(place - shift)
    t = place - shift - corner
    if linear is not True:
        t = cond(linear, t, point(0))
    cell = index(corner)

    def along(axis: int, *offset: int) -> Any:
        """Interpolate along the axes 0 to `axis`, at the offsets `offset` on the axes after it."""
        if axis < 0:
            return texel(cell + index(*offset) if builtins.any(offset) else cell)
        if not cubic:
            return mix(along(axis - 1, 0, *offset), along(axis - 1, 1, *offset), t[axis])
        weights = _cubic(t[axis])
        total = weights[0] * along(axis - 1, -1, *offset)
        for k, weight in enumerate(weights[1:]):
            total = total + weight * along(axis - 1, k, *offset)
        return total

    return along(axes - 1)


def sample(texture: Any, uv: Any) -> Any:
    """Return the texture's colour at uv, filtered and wrapped as it says."""

    def lookup(uv: Any, filter: str, names: Sequence[str]) -> Any:
        linear: Any
        wraps: Sequence[Wrap]
        if texture.known:
            linear, wraps = filter != "nearest", [WRAPS[name] for name in names]
        else:
            mode = texture.mode
            linear, repeat = (mode & 1) != 0, (mode & 2) != 0
            wraps = [_either(repeat)] * texture.AXES
        extents = texture.shape[::-1]
        return filtered(uv, extents, wraps, linear, filter == "cubic", lambda *at: texture.table[at])

    name = f"sample_{texture.name or 'texture'}"
    routine = texture.__dict__.setdefault("_routine", Subroutine(lookup, name))
    color = CLASSES["Color", texture.type.size, Base.F]
    wraps = texture.wraps if texture.known else ()
    return color(routine(CLASSES["Attrib", texture.AXES, Base.F](uv), texture.filter, wraps))
