"""A camera of a glTF document in the place of its node (section 3.10).

Stage: scene description. A bad number is a SceneError that names it.

    camera = camera_of(entry, node.matrix, middle)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.planes import unit
from raytracer.errors import SceneError
from raytracer.meshes.folder import shown
from raytracer.meshes.gltf import needed, number_of, table
from raytracer.scene.camera import ALONG, Camera
from raytracer.scene.framing import triple

Matrix = NDArray[np.float64]
NamedCamera = tuple[str, Camera]
"""A camera and its name in the file."""


def camera_of(entry: dict[str, Any], matrix: Matrix, middle: Matrix) -> Camera | None:
    """Return a camera that looks along its own -z, aimed as far away as `middle`; any picture shows its frame whole.

    Where a perspective camera gives no aspect ratio its frame is a square. Return None for one that a scale of 0 leaves
    without a direction.
    """
    if np.linalg.norm(np.cross(*unit(matrix[:3, 1:3].T))) <= ALONG:
        return None
    place, ahead = matrix[:3, 3], -unit(matrix[:3, 2])
    distance = float(np.linalg.norm(middle - place)) or 1.0
    at, target, up = triple(place), triple(place + distance * ahead), triple(matrix[:3, 1])
    if entry.get("type") == "orthographic" or "orthographic" in entry:
        frame = table(entry, "orthographic")
        across, down = (abs(_length(frame, name)) for name in ("xmag", "ymag"))  # some exporters write negative ones
        if not (across > 0 and down > 0):
            raise SceneError(f"its xmag is {across:g} and its ymag {down:g}, which no camera has")
        return Camera(at, target, up, projection="orthographic", span=2 * min(across, down), aspect=across / down)
    lens = table(entry, "perspective")
    angle, aspect = _length(lens, "yfov"), number_of(lens, "aspectRatio", 1)
    if not (0 < angle < math.pi and aspect > 0):
        raise SceneError(f"its yfov is {angle:g} and its aspectRatio {aspect:g}, which no camera has")
    if aspect < 1:
        angle = 2 * math.atan(aspect * math.tan(angle / 2))
    return Camera(at, target, up, math.degrees(angle), aspect=aspect)


def _length(entry: dict[str, Any], name: str) -> float:
    """Return a number that an entry must have; SceneError where it is missing."""
    needed(entry, name)
    return number_of(entry, name, 0)


def chosen_camera(cameras: Sequence[NamedCamera], which: str | int | None, file: str) -> Camera | None:
    """Return the camera of a name or a number; for None the first one, or None without any.

    Raises SceneError for a name or a number that no camera of the `file` has.
    """
    if which is None:
        return cameras[0][1] if cameras else None
    if isinstance(which, int) and 0 <= which < len(cameras):
        return cameras[which][1]
    named = [camera for name, camera in cameras if name == which]
    if named:
        return named[0]
    listed = ", ".join(f"{number} {shown(name)!r}" for number, (name, _) in enumerate(cameras))
    raise SceneError(f"{file} has no camera {which!r}: {f'its cameras are {listed}' if listed else 'it has none'}")
