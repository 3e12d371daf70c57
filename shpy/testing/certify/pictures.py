"""The examples' kernels and three rendered pictures, as golden hashes.

Stage: test. The examples are not installed with the package: their kernels are kept beside this file as IR text. The
ray tracer is loaded when a picture is rendered, for shpy knows nothing of it.
"""

from __future__ import annotations

import functools
import importlib
from typing import Any, Final

import numpy as np

from shpy.programs import Program, parse
from shpy.testing.arrays import Array, differing
from shpy.testing.certify.comparing import compare
from shpy.testing.certify.findings import SHOWN, Check, DeviceChoice, Finding
from shpy.testing.certify.golden import KERNELS, digest, golden
from shpy.testing.certify.inputs import fractions
from shpy.testing.observers import Setting

EXAMPLES: Final = ("mandelbrot", "planet", "marble", "dents", "blur", "life", "nbody")
SCENES: Final = ("boxes", "mirror-box", "mixed")
_SIZE: Final = (64, 48)
_LAYERS: Final = ("pixels", "depth", "normal", "object_id", "rays")


def example_checks() -> list[Check]:
    """Return a check for each kernel of an example."""
    return [Check(name, functools.partial(_example, name)) for name in EXAMPLES]


def _example(name: str, target: DeviceChoice) -> Finding:
    return compare(example(name), target, golden()["examples"].get(name))[0]


def example(name: str) -> Setting:
    """Return an example's kernel with its inputs."""
    program = Program.from_ir(parse((KERNELS / f"{name}.ir").read_text()))
    disc = _grid(64) * np.float32(2.25) - np.float32(1.125)
    match name:
        case "mandelbrot":
            return Setting(program, (_grid(64) * np.float32(2.5) - np.array([1.875, 1.25], np.float32),))
        case "planet":
            return Setting(program, shape=(64, 64))
        case "marble" | "dents":
            return Setting(program, (disc,))
        case "blur":
            program.params["step"].value = (1, 0)
            return Setting(program, named={"picture": fractions(48 * 64 * 3, 5).reshape(48, 64, 3)}, shape=(48, 64))
        case "life":
            board = (fractions(64 * 64, 6) < 0.375).astype(np.int32).reshape(64, 64)
            rules = np.array([[0, 0, 0, 1, 0, 0, 0, 0, 0], [0, 0, 1, 1, 0, 0, 0, 0, 0]], np.int32)
            return Setting(program, named={"cells": board, "rules": rules}, shape=(64, 64))
    bodies = fractions(4 * 256, 7).reshape(256, 4)
    (table,) = (name for name in program.inputs if name != "x")
    return Setting(program, (bodies[:, :3],), {table: bodies})


def _grid(size: int) -> Array:
    """Points of the unit square, (size * size, 2)."""
    ticks = (np.arange(size, dtype=np.float32) + np.float32(0.5)) / np.float32(size)
    return np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)


def picture_checks() -> list[Check]:
    """Return a check for each picture."""
    return [Check(name, functools.partial(_picture, name)) for name in SCENES]


def _picture(name: str, target: DeviceChoice) -> Finding:
    if target.options:  # the renderer takes the first device and measures the width
        return Finding("absent", "pictures are rendered without --device and --lanes")
    try:
        layers = picture(name, target.backend)
    except ImportError as error:
        return Finding("absent", f"the ray tracer is not installed here ({error.name or error})")
    checksum, expected = digest(layers.values()), golden()["pictures"].get(name)
    if checksum == expected:
        return Finding("same", hash=checksum)
    message = f"the hash is {checksum}, and the package ships {expected or 'none'}"
    if target.backend == "numpy":
        return Finding("differs", message, checksum)
    here = picture(name, "numpy")
    if digest(here.values()) != expected:
        message = f"numpy on this machine differs too, so the scene's data may be others: {message}"
    return Finding("differs", "\n".join([message, *_pixels(layers, here)]), checksum)


def _pixels(layers: dict[str, Array], expected: dict[str, Array]) -> list[str]:
    lines = []
    for layer in _LAYERS:
        a, b = layers[layer], expected[layer]
        places = np.argwhere(differing(a, b).reshape(*a.shape[:2], -1).any(axis=2))
        for y, x in places[:SHOWN].tolist():
            lines.append(f"{layer} of row {y}, column {x}: {a[y, x].tolist()}, not {b[y, x].tolist()}")
    return lines[:SHOWN]


def picture(scene: str, backend: str) -> dict[str, Array]:
    """Return the layers of a rendered picture; ImportError where there is no ray tracer."""
    raytracer: Any = importlib.import_module("raytracer")
    image = raytracer.render(raytracer.Scene.builtin(scene), size=_SIZE, backend=backend, bounces=2)
    return {layer: np.asarray(getattr(image, layer)) for layer in _LAYERS}
