"""Metals, plastics, car paint and glass under a sky with three lamps, path traced.

A row has one roughness for all of its balls: 0.05, 0.3 and 0.6 from front to back. The lamps are rectangles in a
picture of the sky, which is the light of the scene.

    python examples/metals.py [numpy|opencl|glsl] [samples]
"""

import sys

import numpy as np

from raytracer import Camera, EnvironmentLight, Material, MetallicRoughness, Path, Scene, Texture, render
from raytracer.meshes.shapes import checkerboard, sphere

LOOKS = [
    {"base_color": (1.0, 0.77, 0.34), "metallic": 1},
    {"base_color": (0.95, 0.64, 0.54), "metallic": 1},
    {"base_color": (0.75, 0.05, 0.04)},
    {"base_color": (0.02, 0.06, 0.25), "metallic": 0.6, "clearcoat": 1, "clearcoat_roughness": 0.04},
]
LAMPS = ((12, 20, 8, 14, 14.0), (8, 78, 10, 8, 9.0), (22, 50, 3, 40, 2.5))
"""The row, column, height, width and radiance of each lamp."""


def sky():
    """Return the light around the scene: (64, 128, 3)."""
    rows = np.linspace(0, 1, 64)[:, None, None]
    light = np.broadcast_to((0.45, 0.5, 0.6) + (0.3, 0.2, 0.0) * rows, (64, 128, 3)).astype(np.float32)
    light[33:] = (0.25, 0.22, 0.2)
    for row, column, height, width, radiance in LAMPS:
        light[row : row + height, column : column + width] = radiance
    return Texture(light, srgb=False)


def metals():
    """Return the scene."""
    ground = MetallicRoughness((1, 1, 1), roughness=0.9)
    meshes = [checkerboard(12.0, 24, (0.6, 0.6, 0.6), (0.25, 0.25, 0.25), ground).moved((0, -0.5, 0))]
    for row, roughness in enumerate((0.05, 0.3, 0.6)):
        looks = [MetallicRoughness(**look, roughness=roughness) for look in LOOKS]
        looks.append(Material(transmission=1.0, specular=0) if row == 0 else
                     MetallicRoughness((0.8, 1, 0.9), roughness=roughness, transmission=0.9))  # fmt: skip
        for column, look in enumerate(looks):
            meshes.append(sphere(0.48, look).moved((1.1 * column - 2.2, 0, 1.1 - 1.1 * row)))
    camera = Camera((0, 4.0, 5.6), (0, -0.25, 0.05), fov=36)
    return Scene(meshes, [EnvironmentLight(sky())], camera)


if __name__ == "__main__":
    backend = sys.argv[1] if len(sys.argv) > 1 else None
    samples = int(sys.argv[2]) if len(sys.argv) > 2 else 64
    print(render(metals(), (432, 288), integrator=Path(samples=samples), backend=backend).save("metals.png"))
