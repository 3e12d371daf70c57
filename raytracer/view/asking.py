"""Questions about the picture of a view: the surface of a pixel, and the camera as text.

Stage: the command line, in the worker.

    surface(drawer, camera, (512, 512), [200, 300])      # object, position, normal, distance
    camera_texts(camera, options, integrator)            # {"code": "Camera(…)", "command": "raytracer render …"}
"""

from __future__ import annotations

import argparse
import math
import shlex
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.integrators.integrator import Integrator, Path
from raytracer.integrators.renderer import Renderer
from raytracer.scene.camera import Camera

Vector = NDArray[np.float64]


def eye_ray(camera: Camera, size: tuple[int, int], at: tuple[int, int]) -> tuple[Vector, Vector]:
    """Return the origin and the unit direction of the eye ray through the middle of a pixel (row, column)."""
    width, height = size
    row, column = at[0] + 0.5, at[1] + 0.5
    given = camera.uniforms(width, height, np.zeros(3), 1.0)
    eye = np.asarray(given["eye"], np.float64)
    if camera.projection == "panorama":
        azimuth, altitude = 2 * math.pi * (column / width - 0.5), math.pi * (0.5 - row / height)
        level = math.sin(azimuth) * given["right"] + math.cos(azimuth) * given["forward"]
        return eye, math.cos(altitude) * level + math.sin(altitude) * given["above"]
    aside = column * given["across"] + row * given["down"]
    if camera.projection == "orthographic":
        return eye + aside, given["corner"]
    ray = given["corner"] + aside
    return eye, ray / np.linalg.norm(ray)


def surface(renderer: Renderer, camera: Camera, size: tuple[int, int], at: tuple[int, int]) -> dict[str, Any]:
    """Return the object, position, normal and distance of what a pixel (row, column) shows; object None for nothing.

    With path tracing the distance is that of the first sample, which lies elsewhere in the pixel.
    """
    found = renderer.rows(size, at[0], 1, camera=camera, samples=1)
    number, distance = int(found["object_id"][0, at[1]]), float(found["depth"][0, at[1]])
    if number < 0:
        return {"at": list(at), "number": None}
    origin, ray = eye_ray(camera, size, at)
    return {
        "at": list(at),
        "number": number,
        "object": renderer.scene.meshes[number].name,
        "position": origin + distance * ray,
        "normal": found["normal"][0, at[1]],
        "distance": distance,
    }


def camera_texts(
    camera: Camera, options: argparse.Namespace, integrator: Integrator, stops: float, *, moving: bool
) -> dict[str, str]:
    """Return the camera as Python code, and as the command line that renders or animates what the page shows.

    A calibrated camera is the scene's own: no options of the command line have its intrinsics.
    """
    command = [*_first(options, moving=moving), *_seen(camera, options, integrator, stops)]
    if camera.intrinsics is not None:
        return {"code": "scene.camera  # calibrated: the scene has its intrinsics", "command": shlex.join(command)}
    words: dict[str, Any] = {"position": camera.position, "target": camera.target, "up": camera.up}
    words |= {"projection": camera.projection} if camera.projection != "perspective" else {}
    words |= {"span": camera.span} if camera.projection == "orthographic" else {}
    words |= {"fov": camera.fov} if camera.projection == "perspective" else {}
    words |= {"aspect": camera.aspect} if camera.aspect != 1 else {}
    words |= {"aperture": camera.aperture, "focus": camera.focus} if camera.aperture else {}
    code = f"Camera({', '.join(f'{name}={_code(value)}' for name, value in words.items())})"
    return {"code": code, "command": shlex.join(command)}


def _code(value: Any) -> str:
    return f"({', '.join(f'{x!r}' for x in value)})" if isinstance(value, tuple) else repr(value)


def _first(options: argparse.Namespace, *, moving: bool) -> list[str]:
    """Return the first words of the command line."""
    if not moving:
        return ["raytracer", "render", options.scene]
    return ["raytracer", "animate", options.scene, *(["--clip", options.clip] if options.clip else [])]


def _seen(camera: Camera, options: argparse.Namespace, integrator: Integrator, stops: float) -> list[str]:
    """Return the options of the command line that show the present view, without those at their default."""
    found = []
    if camera.intrinsics is None:
        found += ["--camera", _numbers(camera.position)]
        found += ["--target", _numbers(camera.target), "--up", _numbers(camera.up)]
        if camera.projection == "perspective":
            found += ["--fov", f"{camera.fov:.9g}"]
    if isinstance(integrator, Path):
        found += ["--integrator", "path"]
    if stops:
        found += ["--exposure", f"{stops:g}"]
    if options.no_floor:
        found.append("--no-floor")
    if options.strict:
        found.append("--strict")
    if options.background is not None:
        found += ["--background", _numbers(options.background)]
    if options.environment is not None:
        found += ["--environment", str(options.environment)]
    return found


def _numbers(values: Any) -> str:
    return ",".join(f"{x:.9g}" for x in values)
