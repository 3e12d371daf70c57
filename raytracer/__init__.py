"""A ray tracer written once in shpy, running on every target.

An integrator renders a scene on a backend:

    from raytracer import Path, Scene, render
    render(Scene.builtin("mixed"), size=(512, 512), backend="opencl").save("mixed.png")
    render(Scene.builtin("cornell"), integrator=Path(samples=256)).save("cornell.png")
"""

import shpy_start  # noqa: F401  # first: it makes Ctrl-C quiet while `python -m raytracer` imports the rest

# isort: split

import importlib
from typing import TYPE_CHECKING, Any

from raytracer.appearance.materials import Material
from raytracer.appearance.metallic_roughness import MetallicRoughness
from raytracer.appearance.programs import Hit, Surface
from raytracer.appearance.textures import Texture
from raytracer.appearance.unlit import Unlit
from raytracer.errors import ClusterError, SceneError
from raytracer.image import Image
from raytracer.integrators.integrator import Path, Staged, Whitted
from raytracer.integrators.primary import GBuffer
from raytracer.integrators.renderer import Renderer
from raytracer.layered.cube import LayeredCube
from raytracer.meshes import Instance, Mesh
from raytracer.rendering import render
from raytracer.scene.camera import Camera
from raytracer.scene.lights import DirectionalLight, EnvironmentLight, PointLight, SpotLight
from raytracer.scene.scene import BUILTIN, Scene
from raytracer.scenes import SCENES

if TYPE_CHECKING:
    from raytracer.intersector import Intersector
    from raytracer.kernels.component import TracedHit
    from raytracer.rays import AllHits, Closest, Hits
    from raytracer.studies.tradeoff import tradeoff

__all__ = [
    "AllHits",
    "Camera",
    "Closest",
    "ClusterError",
    "DirectionalLight",
    "EnvironmentLight",
    "GBuffer",
    "Hit",
    "Hits",
    "Image",
    "Instance",
    "Intersector",
    "LayeredCube",
    "Material",
    "Mesh",
    "MetallicRoughness",
    "Path",
    "PointLight",
    "Renderer",
    "Scene",
    "SceneError",
    "SpotLight",
    "Staged",
    "Surface",
    "Texture",
    "TracedHit",
    "Unlit",
    "Whitted",
    "render",
    "tradeoff",
]

BUILTIN.update(SCENES)

# The names that `__getattr__` loads on first use, each with its module: a picture needs none of them.
_LATER = {
    **dict.fromkeys(("AllHits", "Closest", "Hits"), "rays"),
    "Intersector": "intersector",
    "TracedHit": "kernels.component",
    "tradeoff": "studies.tradeoff",
}

if not TYPE_CHECKING:  # with it, a checker would take any name

    def __getattr__(name: str) -> Any:
        """Load `raytracer.Intersector` and the like on first use."""
        if name not in _LATER:
            raise AttributeError(f"module 'raytracer' has no attribute {name!r}")
        value = globals()[name] = getattr(importlib.import_module(f"raytracer.{_LATER[name]}"), name)
        return value


def __dir__() -> list[str]:
    """List what is loaded on first use, too."""
    return sorted({*globals(), *_LATER})
