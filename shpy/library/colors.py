"""Conversions between colour spaces.

Stage: record. Components follow the letters of the space: `hsv_from_rgb(c)` has the hue in x, the saturation in y and
the value in z, each from 0 to 1. The hues 0 and 1 are the same.

Sources: sRGB: IEC 61966-2-1; luminance: ITU-R BT.709; HSV and HSL: Smith 1978, Joblove and Greenberg 1978; XYZ and
CIE 1976 L*a*b*: CIE 15:2004, with the white D65.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

from shpy.lang.values.builtins import abs, clamp, cond, dot, max, min, pow, sign
from shpy.lang.values.value import CLASSES, Value
from shpy.library.operands import vector

_XYZ: Final = (
    (0.4123907992659593, 0.357584339383878, 0.1804807884018343),
    (0.2126390058715102, 0.715168678767756, 0.0721923153607337),
    (0.0193308187155918, 0.119194779794626, 0.9505321522496607),
)
"""X, Y and Z of the primaries of BT.709 with the white D65, x = 0.3127, y = 0.3290."""
_RGB: Final = (
    (3.240969941904522, -1.537383177570094, -0.4986107602930033),
    (-0.9692436362808798, 1.8759675015077204, 0.0415550574071756),
    (0.0556300796969936, -0.2039769588889766, 1.0569715142428784),
)
"""The inverse of _XYZ."""
_WHITE: Final = tuple(sum(row) for row in _XYZ)
_DELTA: Final = 6 / 29


def _each(c: Any, f: Callable[[Any], Any], what: str) -> Any:
    """Apply f to the components of a colour, but keep a fourth component, alpha."""
    v = vector(c, (1, 2, 3, 4), what)
    return CLASSES[v.kind, 4, v.base](f(v[0, 1, 2]), v[3]) if v.size == 4 else f(v)


def _color(components: Iterable[Any], like: Value) -> Any:
    return CLASSES["Color", 3, like.base](*components)


def linear_from_srgb(c: Any) -> Any:
    """Decode sRGB to linear light, component-wise; a fourth component, alpha, stays. 0 and 1 are exact.

    Negative numbers mirror the positive ones (as in scRGB).
    """

    def decode(v: Any) -> Any:
        size = abs(v)
        curve = pow((size + 0.055) / 1.055, 2.4)
        return cond(size <= 0.04045, v / 12.92, sign(v) * curve)

    return _each(c, decode, "sh.library.linear_from_srgb")


def srgb_from_linear(c: Any) -> Any:
    """Encode linear light as sRGB, component-wise; a fourth component, alpha, stays. 0 and 1 are exact.

    Negative numbers mirror the positive ones (as in scRGB).
    """

    def encode(v: Any) -> Any:
        size = abs(v)
        curve = pow(size, 1 / 2.4)
        return cond(size <= 0.0031308, v * 12.92, sign(v) * (curve + 0.055 * (curve - 1)))

    return _each(c, encode, "sh.library.srgb_from_linear")


def luminance(c: Any) -> Any:
    """Return the luminance of a linear colour: 0.2126 r + 0.7152 g + 0.0722 b (BT.709)."""
    v = vector(c, (3, 4), "sh.library.luminance")
    return dot(v[0, 1, 2], (0.2126, 0.7152, 0.0722))


def _hue(v: Any, high: Any, chroma: Any) -> Any:
    """Return the hue in [0, 1); 0 for greys."""
    r, g, b = v[0], v[1], v[2]
    divisor = cond(chroma > 0, chroma, 1)
    sixth = cond(high == r, (g - b) / divisor, cond(high == g, (b - r) / divisor + 2, (r - g) / divisor + 4))
    return cond(sixth < 0, sixth + 6, sixth) / 6


def hsv_from_rgb(c: Any) -> Any:
    """Return hue, saturation and value of a colour; hue and saturation of greys are 0."""
    v = vector(c, (3,), "sh.library.hsv_from_rgb")
    high, low = max(v[0], v[1], v[2]), min(v[0], v[1], v[2])
    chroma = high - low
    return _color((_hue(v, high, chroma), cond(high > 0, chroma / cond(high > 0, high, 1), 0), high), v)


def rgb_from_hsv(c: Any) -> Any:
    """Return the RGB colour of (hue, saturation, value), each from 0 to 1; a hue outside [0, 1) wraps."""
    v = vector(c, (3,), "sh.library.rgb_from_hsv")
    k = (v[0] * 6 + (5, 3, 1)) % 6
    return _color(v[2] - v[2] * v[1] * clamp(min(k, 4 - k), 0, 1), v)


def hsl_from_rgb(c: Any) -> Any:
    """Return hue, saturation and lightness of a colour; hue and saturation of greys are 0."""
    v = vector(c, (3,), "sh.library.hsl_from_rgb")
    high, low = max(v[0], v[1], v[2]), min(v[0], v[1], v[2])
    chroma = high - low
    room = 1 - abs(high + low - 1)
    return _color((_hue(v, high, chroma), cond(room > 0, chroma / cond(room > 0, room, 1), 0), (high + low) / 2), v)


def rgb_from_hsl(c: Any) -> Any:
    """Return the colour of hue, saturation and lightness; the hue repeats from 1 on."""
    v = vector(c, (3,), "sh.library.rgb_from_hsl")
    k = (v[0] * 12 + (0, 8, 4)) % 12
    reach = v[1] * min(v[2], 1 - v[2])
    return _color(v[2] - reach * clamp(min(k - 3, 9 - k), -1, 1), v)


def xyz_from_linear(c: Any) -> Any:
    """Return X, Y and Z of a linear colour with the primaries of BT.709; white has Y = 1."""
    v = vector(c, (3,), "sh.library.xyz_from_linear")
    return _color((dot(v, row) for row in _XYZ), v)


def linear_from_xyz(c: Any) -> Any:
    """Return the linear colour, in the primaries of BT.709, of X, Y and Z."""
    v = vector(c, (3,), "sh.library.linear_from_xyz")
    return _color((dot(v, row) for row in _RGB), v)


def lab_from_xyz(c: Any) -> Any:
    """Return L* (0 to 100), a* and b* of X, Y and Z, with the white D65."""
    v = vector(c, (3,), "sh.library.lab_from_xyz") / _WHITE
    root = pow(max(v, _DELTA**3), 1 / 3)
    f = cond(v > _DELTA**3, root, v / (3 * _DELTA**2) + 4 / 29)
    return _color((116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])), f)


def xyz_from_lab(c: Any) -> Any:
    """Return X, Y and Z of L*, a* and b*, with the white D65."""
    v = vector(c, (3,), "sh.library.xyz_from_lab")
    y = (v[0] + 16) / 116
    f = CLASSES["Attrib", 3, v.base](y + v[1] / 500, y, y - v[2] / 200)
    return _color(cond(f > _DELTA, f * f * f, 3 * _DELTA**2 * (f - 4 / 29)) * _WHITE, v)
