"""Questions about the picture of a view: the surface of a pixel.

Stage: the command line, in the worker.

    surface(drawer, camera, (512, 512), [200, 300])      # object, position, normal, distance
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.integrators.renderer import Renderer
from raytracer.scene.camera import Camera

Vector = NDArray[np.float64]


def eye_ray(camera: Camera, size: tuple[int, int], at: tuple[int, int]) -> tuple[Vector, Vector]:
    """Return the origin and the unit direction of the eye ray through the middle of a pixel (row, column)."""
    width, height = size
    row, column = at[0] + 0.5, at[1] + 0.5
    uniforms = camera.uniforms(width, height, np.zeros(3), 1.0)
    eye = np.asarray(uniforms["eye"], np.float64)
    if camera.projection == "panorama":
        azimuth, altitude = 2 * math.pi * (column / width - 0.5), math.pi * (0.5 - row / height)
        level = math.sin(azimuth) * uniforms["right"] + math.cos(azimuth) * uniforms["forward"]
        return eye, math.cos(altitude) * level + math.sin(altitude) * uniforms["above"]
    aside = column * uniforms["across"] + row * uniforms["down"]
    if camera.projection == "orthographic":
        return eye + aside, uniforms["corner"]
    ray = uniforms["corner"] + aside
    return eye, ray / np.linalg.norm(ray)


def surface(renderer: Renderer, camera: Camera, size: tuple[int, int], at: tuple[int, int]) -> dict[str, Any]:
    """Return the object, position, normal and distance of what a pixel (row, column) shows; object None for nothing.

    With path tracing the distance is that of the first sample, which lies elsewhere in the pixel.
    """
    layers = renderer.rows(size, at[0], 1, camera=camera, samples=1)
    number, distance = int(layers["object_id"][0, at[1]]), float(layers["depth"][0, at[1]])
    if number < 0:
        return {"at": list(at), "number": None}
    origin, ray = eye_ray(camera, size, at)
    return {
        "at": list(at),
        "number": number,
        "object": renderer.scene.meshes[number].name,
        "position": origin + distance * ray,
        "normal": layers["normal"][0, at[1]],
        "distance": distance,
    }
