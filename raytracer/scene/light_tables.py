"""The lights of a scene as the tables that kernels read.

Stage: layout. Takes lights at places, in the scene's coordinates, gives rows in the kernel's.

>>> from raytracer import PointLight
>>> light_rows([PointLight((0, 2, 0), (1, 1, 1))], np.zeros(3), 1.0, np.dtype(np.float32))[0].tolist()
[0.0, 2.0, 0.0, 1.0]
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.space import Rows, placed
from raytracer.scene.lights import DirectionalLight, PlacedLight, SpotLight


def light_rows(lights: Sequence[PlacedLight], origin: NDArray[np.float64], scale: float, dtype: np.dtype[Any]) -> Rows:
    """Return (2L, 4): position from `origin` times `scale` and 1, or unit direction to the light and 0; then colour.

    The colour is followed by 1 where the light falls off by the square of the distance, by 0 where it does not. Raises
    SceneError for a position that `dtype` does not hold.
    """
    rows = np.zeros((2 * len(lights), 4))
    for k, light in enumerate(lights):
        if isinstance(light, DirectionalLight):
            rows[2 * k, :3] = -_unit(light.direction)
        else:
            rows[2 * k] = *placed("the light", light.position, origin, scale, dtype), 1
            rows[2 * k + 1, 3] = light.falloff == "square"
        rows[2 * k + 1, :3] = light.color
    return rows


def _unit(direction: Sequence[float]) -> NDArray[np.float64]:
    """Return a vector of length 1; it is divided by its largest component first, so that squares fit into f64."""
    near = np.asarray(direction) / np.abs(direction).max()
    unit: NDArray[np.float64] = near / np.linalg.norm(near)
    return unit


def cone_rows(lights: Sequence[PlacedLight], scale: float) -> Rows | None:
    """Return (2L, 4), see `Layout.cones`, with ranges multiplied by `scale`; None without cones and ranges."""
    rows = np.zeros((2 * len(lights), 4))
    rows[1::2, 1] = 1  # without a cone the light is the same in all directions
    for k, light in enumerate(lights):
        if isinstance(light, SpotLight):
            rows[2 * k, :3], rows[2 * k + 1, :2] = _unit(light.direction), light.ramp
        if not isinstance(light, DirectionalLight) and light.range is not None:
            rows[2 * k, 3] = 1 / (light.range * scale)
    return rows if rows[::2].any() else None


def kinds_of(lights: Rows) -> tuple[int, bool, bool, bool]:
    """Return the features of a kernel: how many lights, and if any has a place, a direction, a falloff."""
    points, fades = lights[::2, 3] > 0, lights[1::2, 3] > 0
    return len(points), bool(points.any()), bool((~points).any()), bool(fades.any())
