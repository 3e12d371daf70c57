"""Pictures without noise, by Intel's Open Image Denoise: `render(..., denoise=True)` and `--denoise`.

Stage: render. Its network gets the pixels and two guides that have no noise: the colours of surfaces and their normals,
as `Whitted` shows them in even light. What it gives is smooth, and may be wrong where the noise hides it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Final

import numpy as np

import shpy as sh
from raytracer.errors import SceneError
from raytracer.image import Image
from raytracer.integrators.integrator import Integrator, Path, Whitted
from raytracer.integrators.renderer import Renderer
from raytracer.scene.scene import Scene

GUIDE: Final = Whitted(samples=4)
"""The integrator of the guides: mirrors and glass have the colours of what is seen by way of them."""


def check_denoising(integrator: Integrator) -> None:
    """Raise SceneError for another integrator than Path, and where the package is missing."""
    if not isinstance(integrator, Path):
        raise SceneError('denoise is for integrator="path": other pictures have no noise')
    _network()


def finisher_of(denoise: bool, integrator: Integrator, scene: Scene, backend: str | None) -> Callable[[Image], Image]:
    """Return the function of a finished picture: `denoised`, or no change. Raises as `check_denoising`."""
    if not denoise:
        return lambda image: image
    check_denoising(integrator)
    return lambda image: denoised(image, scene, backend)


def _network() -> Any:
    """Return the module of the denoiser. Raises SceneError where it is missing."""
    try:
        import pyoidn
    except ImportError as error:
        raise SceneError(f"denoise needs Open Image Denoise: {sh.packages.install('pyoidn')}") from error
    return pyoidn


def denoised(image: Image, scene: Scene, backend: str | None = None) -> Image:
    """Return a path traced picture of a scene with other pixels: an estimate of what they are without noise.

    Its `origin` is empty, as no samples can be added to it. A transparent picture stays black where no surface is,
    although the network smooths light over edges. Raises SceneError where the package is missing.
    """
    network = _network()
    height, width = image.depth.shape
    guides = _guides(scene, (width, height), backend)
    pixels = network.denoise(np.ascontiguousarray(image.pixels, np.float32), *guides, hdr=True, clean_aux=True)
    pixels = np.asarray(pixels, np.float32)
    if image.alpha is not None:
        pixels = np.where(image.alpha[..., None] > 0, pixels, np.float32(0))
    return dataclasses.replace(image, pixels=pixels, origin="")


def _guides(scene: Scene, size: tuple[int, int], backend: str | None) -> tuple[Any, Any]:
    """Return the colours of the surfaces, in [0, 1], and their normals, (H, W, 3) each."""
    if not scene.triangles:
        flat = np.zeros((size[1], size[0], 3), np.float32)
        return flat, flat
    even = dataclasses.replace(scene, lights=(), ambient=1.0, background=(1.0, 1.0, 1.0))
    seen = Renderer(even, integrator=GUIDE, backend=backend).render(size)
    return np.clip(seen.pixels, 0, 1), np.ascontiguousarray(seen.normal, np.float32)
