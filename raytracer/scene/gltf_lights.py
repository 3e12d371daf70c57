"""A light of a glTF document (KHR_lights_punctual) in the place of its node.

Stage: scene description. A bad number is a SceneError that names it.

    light, share = light_of(entry, node.matrix, middle, notices)
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.errors import SceneError
from raytracer.meshes.folder import Notices, shown
from raytracer.meshes.gltf import number_of, numbers_of, table
from raytracer.scene.framing import triple
from raytracer.scene.lights import DirectionalLight, PlacedLight, PointLight, SpotLight

Matrix = NDArray[np.float64]
_EDGE = 1e-3
"""The share of a cone's angle over which a sharp edge falls to 0."""


def light_of(
    entry: dict[str, Any], matrix: Matrix, middle: Matrix, notices: Notices
) -> tuple[PlacedLight, float] | None:
    """Return a light, and the share of its colour that comes to `middle` where its cone and its range let it."""
    color = number_of(entry, "intensity", 1) * np.asarray(numbers_of(entry, "color", (1, 1, 1)))
    kind, place = entry.get("type"), matrix[:3, 3]
    if not np.all(np.isfinite(color)) or color.min() < 0:
        raise SceneError(f"its light has the colour {shown(str(color))}")
    if kind not in ("directional", "point", "spot"):
        notices.ignore(f"lights of the type {kind}")
        return None
    if kind != "point" and not matrix[:3, 2].any():
        notices.ignore("lights that a scale of 0 leaves without a direction")
        return None
    ahead = -matrix[:3, 2]
    if kind == "directional":
        return DirectionalLight(triple(ahead), triple(color)), 1.0
    reach = number_of(entry, "range", 0) if "range" in entry else None
    distance = float(np.linalg.norm(place - middle))
    share = 1 / (distance**2 or 1)
    if kind == "point":
        return PointLight(triple(place), triple(color), "square", reach), share
    cone = table(entry, "spot")
    inner = math.degrees(number_of(cone, "innerConeAngle", 0))
    outer = math.degrees(number_of(cone, "outerConeAngle", math.pi / 4))
    outer = min(outer, 90.0) if outer < 90.001 else outer  # pi / 2 as files write it
    if outer > 0 and math.isclose(inner, outer, rel_tol=_EDGE):
        inner = (1 - _EDGE) * outer  # a sharp edge, which exporters write as two equal angles
    return SpotLight(triple(place), triple(ahead), inner, outer, triple(color), "square", reach), share
