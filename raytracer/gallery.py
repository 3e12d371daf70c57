"""All pictures of the built-in scenes with one command: `raytracer gallery docs/gallery`.

Stage: render. A picture is the same on every backend, so the files do not depend on the machine.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from raytracer.errors import SceneError
from raytracer.image import Image, writer
from raytracer.integrators import integrator
from raytracer.rendering import render
from raytracer.scene.scene import Scene
from raytracer.scenes import SCENES

SIZE: Final = (640, 480)
_PATHS: Final = {"cornell": 512}
"""The samples of pictures that are path traced, as large as the shorter side along both."""
_SAMPLES: Final = 9
_BOUNCES: Final = {
    "mirror-box": 6, "glass": 8, "materials": 6, "spheres": 4, "teapot": 4, "two-teapots": 4, "chrome": 6,
}  # fmt: skip
"""The number of reflections and refractions of scenes that do not use the default, 3."""


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
    `Program.compile`. Raises SceneError where there is no such folder, and as `render` does.
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
        image = render(Scene.builtin(name), shape, integrator=chosen_integrator, backend=backend)
        yield image.save(path), image
