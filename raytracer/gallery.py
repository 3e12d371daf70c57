"""All pictures of the built-in scenes with one command: `raytracer gallery docs/gallery`.

Stage: render. A picture is the same on every backend, so the files do not depend on the machine.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from raytracer.errors import SceneError
from raytracer.image import Image, writer
from raytracer.integrators import integrator
from raytracer.rendering import render
from raytracer.scene.camera import Camera
from raytracer.scene.scene import Scene
from raytracer.scenes import SCENES

SIZE: Final = (640, 480)
_PATHS: Final = {"cornell": 1024}
"""The samples of pictures that are path traced, as large as the shorter side along both."""
_SAMPLES: Final = 9
_BOUNCES: Final = {
    "mirror-box": 8, "glass": 8, "materials": 6, "spheres": 4, "teapot": 4, "two-teapots": 4, "chrome": 6,
}  # fmt: skip
"""The number of reflections and refractions of scenes that do not use the default, 3."""
_VIEWS: Final[Mapping[str, Mapping[str, Any]]] = {
    "boxes": {"camera": Camera((3.5, 3.7, 8.0), (-0.2, 0.75, 0), fov=41), "background": (0.03, 0.04, 0.06)},
    "mirror-box": {"camera": Camera((-2.3, 1.9, 3.4), (0.5, 0.95, -0.8), fov=54)},
}
"""Attributes of scenes that differ in the gallery."""
_EXPOSURES: Final = {"mirror-box": 0.5, "cornell": 1.0}
"""The stops by which pictures are made brighter."""


def gallery(
    folder: str,
    size: tuple[int, int] = SIZE,
    *,
    backend: str | None = None,
    samples: int | None = None,
    math: str = "strict",
    fuse: bool = False,
) -> Iterator[tuple[Path, Image]]:
    """Render every built-in scene into a PNG file in a folder, which exists; yield each path with its Image.

    `samples` takes the place of the nine rays for each pixel, and of the paths. `math` and `fuse` are those of
    `Program.compile`. Raises SceneError if the folder is missing, and the errors of `render`.
    """
    if not Path(folder).is_dir():
        raise SceneError(f"there is no folder {folder}: make it first")
    for name in SCENES:
        path = Path(folder) / f"{name}.png"
        writer(path, size)
        chosen_integrator: integrator.Integrator
        if name in _PATHS:
            shape, chosen_integrator = (
                (min(size), min(size)),
                integrator.Path(samples=samples or _PATHS[name], math=math, fuse=fuse),
            )
        else:
            bounces = _BOUNCES.get(name, 3)
            shape = size
            chosen_integrator = integrator.Whitted(bounces=bounces, samples=samples or _SAMPLES, math=math, fuse=fuse)
        scene = replace(Scene.builtin(name), **_VIEWS.get(name, {}))
        image = render(scene, shape, integrator=chosen_integrator, backend=backend)
        yield image.save(path, _EXPOSURES.get(name, 0.0)), image
