"""A ray tracer written once in shpy, running on every target.

from raytracer import Scene, render
render(Scene.builtin("mixed"), size=(512, 512), backend="opencl", bounces=3).save("mixed.png")
"""

import shpy_start  # noqa: F401  # first: it makes Ctrl-C quiet while `python -m raytracer` imports the rest

# isort: split

from raytracer.appearance.materials import Material
from raytracer.appearance.textures import Texture
from raytracer.errors import SceneError
from raytracer.image import Image
from raytracer.integrators.renderer import Renderer, render
from raytracer.intersector import AllHits, Closest, Hits, Intersector
from raytracer.kernels.shaders import Hit, Surface
from raytracer.layered.cube import LayeredCube
from raytracer.meshes import Instance, Mesh
from raytracer.scene.camera import Camera
from raytracer.scene.lights import DirectionalLight, EnvironmentLight, PointLight
from raytracer.scene.scene import Scene
from raytracer.studies.tradeoff import tradeoff

__all__ = [
    "AllHits",
    "Camera",
    "Closest",
    "DirectionalLight",
    "EnvironmentLight",
    "Hit",
    "Hits",
    "Image",
    "Instance",
    "Intersector",
    "LayeredCube",
    "Material",
    "Mesh",
    "PointLight",
    "Renderer",
    "Scene",
    "SceneError",
    "Surface",
    "Texture",
    "render",
    "tradeoff",
]
