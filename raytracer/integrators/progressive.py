"""Path tracing in passes over the whole picture: each adds samples to the mean, and any may be the last.

Stage: render. The state of a picture is its pixels and the number of its samples, so that a picture that was saved
may be continued, bit for bit as if it had never stopped.

    for layers, samples in passes(kernel, params, "opencl", scale, layers, 0, 64, progress, None, 0):
        ...
"""

from __future__ import annotations

from collections.abc import Iterator
from os import PathLike
from typing import Any

import numpy as np

from raytracer.errors import SceneError
from raytracer.image import ALPHA, Image
from raytracer.integrators.integrator import Integrator, Path
from raytracer.integrators.layers import BANDS, Progress, rows_at_once
from raytracer.integrators.origin import check_origin

SAMPLES_AT_ONCE = 16
"""Samples of a pixel in a pass, at most."""
BANDS_AT_ONCE = 64
"""Bands of one sample that a pass takes as long as, at most: an interruption loses the pass that it interrupts."""

Layers = dict[str, Any]


def passes(
    kernel: Any,
    params: Any,
    backend: str,
    scale: float,
    layers: Layers,
    first: int,
    past: int,
    progress: Progress | None,
    at_once: int | None,
    first_row: int,
) -> Iterator[tuple[Layers, int]]:
    """Add the samples `first` to `past` - 1 to a picture; yield all layers, anew, after each pass.

    A pass has `at_once` samples of each pixel, or by default as many as `SAMPLES_AT_ONCE` and `BANDS_AT_ONCE` allow.
    The layers are those of the picture's rows from `first_row` on.
    """
    height, width = layers["depth"].shape
    kind = "paths on numpy" if backend == "numpy" else "paths on a device"
    at_once = at_once or max(1, min(SAMPLES_AT_ONCE, BANDS_AT_ONCE * BANDS[kind] // (width * height)))
    rows = rows_at_once(kind, width)
    starts = range(first, past, at_once)
    for number, start in enumerate(starts):
        end = min(start + at_once, past)
        params["first_sample"].value, params["past_sample"].value = start, end
        layers = {name: layer.copy() for name, layer in layers.items()}
        for top in range(0, height, rows):
            params["top_row"].value = first_row + top
            band = {name: layer[top : top + rows] for name, layer in layers.items()}
            means = [np.ascontiguousarray(band[name]) for name in ("pixels", ALPHA) if name in band]
            outputs = kernel(*means)
            band["pixels"][:] = outputs.color
            if ALPHA in band:
                band[ALPHA][:] = outputs.alpha
            band["rays"] += np.asarray(outputs.rays)
            if start == 0:
                band["depth"][:] = np.asarray(outputs.depth).astype(np.float64) / scale
                band["normal"][:] = outputs.normal
                band["object_id"][:] = outputs.object
            if progress is not None:
                progress(number * height + min(top + rows, height), len(starts) * height)
        yield layers, end


def check_resume(integrator: Integrator, resume: Any) -> None:
    """Raise SceneError for a picture to resume with an integrator that adds no samples."""
    if resume is not None and not isinstance(integrator, Path):
        raise SceneError('resume is for integrator="path": other pictures have no samples to add to')


def resumed(
    resume: Image | str | PathLike[str], size: tuple[int, int], origin: str, samples: int
) -> tuple[Layers, int]:
    """Copy the layers of a picture to continue; return them and its samples. SceneError for another picture."""
    if not isinstance(resume, Image | str | PathLike):
        raise SceneError(f"a picture to resume is an Image, or its .exr or .npy file, not {resume!r}")
    image = resume if isinstance(resume, Image) else Image.load(resume)
    height, width = image.depth.shape
    name = "the picture to resume" if isinstance(resume, Image) else str(resume)
    if (width, height) != size:
        raise SceneError(f"{name} has {width} x {height} pixels, not {size[0]} x {size[1]}")
    check_origin(name, image.origin, origin)
    if image.samples > samples:
        raise SceneError(f"{name} has {image.samples:,} samples already, more than {samples:,}")
    return {name: layer.copy() for name, layer in image.layers.items()}, image.samples
