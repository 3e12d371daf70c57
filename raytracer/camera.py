"""The camera: where it stands, what it looks at, and the eye rays that follow for a picture of a given size.

Stage: scene description. `view` gives the few vectors from which the kernel makes the ray of each pixel.

>>> Camera(position=(0, 0, 5), target=(0, 0, 0), fov=90).view(2, 2).across.round(9).tolist()
[1.0, -0.0, 0.0]
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.errors import SceneError
from raytracer.materials import Triple

Vector = NDArray[np.float64]


class View(NamedTuple):
    """The eye ray through pixel (row, column) runs along `corner + (column + 1/2) across + (row + 1/2) down`."""

    eye: Vector
    corner: Vector
    across: Vector
    down: Vector


def radius_of(low: Vector, high: Vector) -> float:
    """Half the diagonal of a box; of a single point, some length that does not vanish beside its coordinates."""
    radius = float(np.linalg.norm(np.subtract(high, low))) / 2
    return radius or 1e-6 * max(float(np.abs(low).max()), 1.0)


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole at `position` looking at `target`.

    `up` need only not be along the line of sight; `fov` is the angle, in degrees, across the shorter side of the
    picture. Raises SceneError where no picture can follow from it.
    """

    position: Triple
    target: Triple = (0.0, 0.0, 0.0)
    up: Triple = (0.0, 1.0, 0.0)
    fov: float = 40.0

    def __post_init__(self) -> None:
        if not all(len(v) == 3 and np.all(np.isfinite(v)) for v in (self.position, self.target, self.up)):
            raise SceneError("a camera's position, target and up are three finite numbers each")
        if not 0 < self.fov < 180:
            raise SceneError(f"a camera's fov lies between 0 and 180 degrees, not {self.fov}")
        sight = np.subtract(self.target, self.position)
        if not np.any(sight):
            raise SceneError("a camera cannot look at its own position")
        if np.linalg.norm(np.cross(sight, self.up)) <= 1e-9 * np.linalg.norm(sight) * np.linalg.norm(self.up):
            raise SceneError("a camera's up must not be along its line of sight")

    def view(self, width: int, height: int) -> View:
        """The vectors that give the eye rays of a picture of `width` by `height` pixels; row 0 is the top one."""
        forward = np.subtract(self.target, self.position).astype(np.float64)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, self.up)
        right /= np.linalg.norm(right)
        above = np.cross(right, forward)
        pixel = 2 * math.tan(math.radians(self.fov) / 2) / min(width, height)
        across, down = right * pixel, -above * pixel
        corner = forward - across * (width / 2) - down * (height / 2)
        return View(np.asarray(self.position, dtype=np.float64), corner, across, down)

    @classmethod
    def framing(cls, low: Vector, high: Vector, *, toward: Triple = (0.42, 0.42, 1.0), fov: float = 32.0) -> Camera:
        """A camera in the direction `toward` of the box from `low` to `high`, just far enough to see all of it."""
        middle = (np.asarray(low) + np.asarray(high)) / 2
        radius = radius_of(low, high)
        direction = np.asarray(toward, dtype=np.float64) / np.linalg.norm(toward)
        position = middle + direction * radius / math.sin(math.radians(fov) / 2)
        x, y, z = position.tolist()
        a, b, c = middle.tolist()
        return cls((x, y, z), (a, b, c), fov=fov)
