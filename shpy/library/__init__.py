"""The shader library: functions that are written in the language, over the operations of `shpy` itself.

`sh.library.fbm(p)`, or `from shpy.library import fbm`. Each works inside programs on every backend, and strict mode
gives the same bits on all of them. Functions without loops also work outside programs, on constants. docs/library.md
shows them all.
"""

from shpy.library.colors import (
    hsl_from_rgb,
    hsv_from_rgb,
    lab_from_xyz,
    linear_from_srgb,
    linear_from_xyz,
    luminance,
    rgb_from_hsl,
    rgb_from_hsv,
    srgb_from_linear,
    xyz_from_lab,
    xyz_from_linear,
)
from shpy.library.mathematics import hypot, isfinite, lerp, log10, outer
from shpy.library.patterns import cellnoise, fbm, turbulence, worley
from shpy.library.textures import Mipmap, Texture3D, TextureCube, cubemap
from shpy.library.transforms import look_at, perspective, rotate, scale, translate

__all__ = sorted(name for name, thing in globals().items() if str(getattr(thing, "__module__", "")).startswith("shpy."))
