"""The eye rays of a picture, as its camera projects the scene.

Stage: kernel. `Camera.uniforms` gives the values of the params, of which each projection has its own. `lens` are two
numbers in [0, 1) that choose the point of a lens; without them the pixel does.
"""

from __future__ import annotations

from math import pi
from typing import Any

import shpy as sh
from raytracer.scene.camera import Camera


class EyeRays:
    """The eye rays of a perspective picture; a band of it begins at the row `first_row`."""

    def __init__(self) -> None:
        self.eye = sh.Param(sh.Point3f, (0, 0, 0), name="eye")
        self.corner = sh.Param(sh.Vector3f, (0, 0, 0), name="corner")
        self.across = sh.Param(sh.Vector3f, (0, 0, 0), name="across")
        self.down = sh.Param(sh.Vector3f, (0, 0, 0), name="down")
        self.first_row = sh.Param(sh.Attrib1f, 0, name="first_row")

    def __call__(self, row: Any, column: Any, lens: Any = None) -> tuple[Any, Any]:
        """Return the ray through a pixel of the band, of unit length, and its origin."""
        ray = sh.normalize(self.through(row, column))
        return ray, sh.Point3f(self.eye)

    def through(self, row: Any, column: Any) -> Any:
        """Return a vector along the eye ray through a pixel of the band, as long along the line of sight as 1."""
        return self.corner + (column + 0.5) * self.across + (row + self.first_row + 0.5) * self.down


class LensRays(EyeRays):
    """The eye rays through a thin lens, each through another point (Pharr, Jakob and Humphreys 2023, section 5.2.3)."""

    def __init__(self) -> None:
        super().__init__()
        self.focus = sh.Param(sh.Attrib1f, 1, name="focus")
        self.lens_right = sh.Param(sh.Vector3f, (0, 0, 0), name="lens_right")
        self.lens_above = sh.Param(sh.Vector3f, (0, 0, 0), name="lens_above")

    def __call__(self, row: Any, column: Any, lens: Any = None) -> tuple[Any, Any]:
        """Return the ray through a pixel of the band, of unit length, and its origin."""
        if lens is None:
            place = column, sh.Attrib1i(row + self.first_row)
            lens = [sh.unit_float(sh.hash(*place, k)) for k in range(2)]
        angle, radius = lens
        angle, radius = 2 * pi * angle, sh.sqrt(radius)
        beside = radius * (sh.cos(angle) * self.lens_right + sh.sin(angle) * self.lens_above)
        ray = sh.normalize(self.focus * self.through(row, column) - beside)
        return ray, self.eye + beside


class ParallelRays(EyeRays):
    """The eye rays of an orthographic picture: `eye` is the origin of the corner's ray, `corner` their direction."""

    def __call__(self, row: Any, column: Any, lens: Any = None) -> tuple[Any, Any]:
        """Return the ray through a pixel of the band, of unit length, and its origin."""
        ray = sh.normalize(self.corner)
        return ray, self.eye + (column + 0.5) * self.across + (row + self.first_row + 0.5) * self.down


class PanoramaRays:
    """The eye rays of a panorama; `size` is the picture's width and height."""

    def __init__(self) -> None:
        self.eye = sh.Param(sh.Point3f, (0, 0, 0), name="eye")
        self.right = sh.Param(sh.Vector3f, (0, 0, 0), name="right")
        self.above = sh.Param(sh.Vector3f, (0, 0, 0), name="above")
        self.forward = sh.Param(sh.Vector3f, (0, 0, 0), name="forward")
        self.size = sh.Param(sh.Attrib2f, (1, 1), name="size")
        self.first_row = sh.Param(sh.Attrib1f, 0, name="first_row")

    def __call__(self, row: Any, column: Any, lens: Any = None) -> tuple[Any, Any]:
        """Return the ray through a pixel of the band, of unit length, and its origin."""
        azimuth = 2 * pi * ((column + 0.5) / self.size.x - 0.5)
        height = pi * (0.5 - (row + self.first_row + 0.5) / self.size.y)
        level = sh.sin(azimuth) * self.right + sh.cos(azimuth) * self.forward
        ray = sh.normalize(sh.cos(height) * level + sh.sin(height) * self.above)
        return ray, sh.Point3f(self.eye)


def eye_rays_of(camera: Camera) -> EyeRays | PanoramaRays:
    """Return the eye rays of a camera's kind."""
    if camera.projection == "perspective":
        return LensRays() if camera.aperture else EyeRays()
    return ParallelRays() if camera.projection == "orthographic" else PanoramaRays()
