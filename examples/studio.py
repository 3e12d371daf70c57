"""Brushed metal, amber, frosted glass, car paint, satin and copper in a studio, path traced, by the curve AgX.

The disks are brushed in circles: a program gives the direction of their anisotropy from uv coordinates.

    python examples/studio.py [numpy|opencl|glsl] [samples]
"""

import sys

import numpy as np

import shpy as sh
from raytracer import Camera, EnvironmentLight, MetallicRoughness, Path, Scene, Surface, Texture, render
from raytracer.meshes.shapes import box, floor, knot, sphere, torus

LAMPS = ((6, 14, 8, 20, 12.0), (10, 88, 16, 6, 10.0), (20, 50, 3, 30, 3.0))
"""The row, column, height, width and radiance of each lamp."""


def studio_light():
    """Return the light around the scene: (64, 128, 3)."""
    light = np.full((64, 128, 3), (0.16, 0.17, 0.2), np.float32)
    for row, column, height, width, radiance in LAMPS:
        light[row : row + height, column : column + width] = radiance
    return Texture(light, srgb=False)


def spun(hit):
    """Turn the direction of an anisotropy round the middle of a picture."""
    x, y = hit.uv.x - 0.5, hit.uv.y - 0.5
    there = sh.cond(x * x + y * y < 0.25, 1.0, 0.0)
    return Surface(anisotropy=0.85 * there, anisotropy_rotation=90 + (180 / np.pi) * sh.atan2(y, x))


STEEL = MetallicRoughness((0.72, 0.7, 0.68), metallic=1, roughness=0.3, surface=spun)
AMBER = MetallicRoughness(
    (1, 1, 1), roughness=0, transmission=1, thickness=1, attenuation_color=(0.95, 0.45, 0.06), attenuation_distance=0.6
)
FROSTED = MetallicRoughness((0.92, 0.98, 1), roughness=0.35, transmission=1, thickness=1)
PAINT = MetallicRoughness((0.35, 0.01, 0.02), metallic=0.5, roughness=0.45, clearcoat=1, clearcoat_roughness=0.02)
SATIN = MetallicRoughness((0.06, 0.1, 0.4), roughness=0.5, sheen_color=(0.4, 0.5, 1), sheen_roughness=0.3)
COPPER = MetallicRoughness((0.95, 0.58, 0.42), metallic=1, roughness=0.25, multiscatter=True)


def studio():
    """Return the scene."""
    stone = MetallicRoughness((0.3, 0.3, 0.31), roughness=0.6)
    meshes = [
        floor(30, stone),
        floor(30, stone).moved((0, 0, -3.5), tilt=90),
        floor(1.7, STEEL).moved((-1.5, 0.85, -1.6), tilt=78),
        torus(0.42, 0.17, COPPER).moved((0.35, 0.6, -1.4), tilt=70),
        knot(2, 3, 0.36, 0.13, PAINT, segments=160, sides=20).moved((1.75, 0.6, -0.9)),
        sphere(0.5, AMBER).moved((-0.75, 0.5, 0.35)),
        box((0.8, 0.8, 0.8), FROSTED).moved((0.45, 0.4, 0.5), turn=32),
        sphere(0.36, SATIN).moved((1.45, 0.36, 0.8)),
    ]
    camera = Camera((0.2, 2.0, 6.2), (0.12, 0.62, 0), fov=24)
    return Scene(meshes, [EnvironmentLight(studio_light(), rotation=30)], camera)


if __name__ == "__main__":
    backend = sys.argv[1] if len(sys.argv) > 1 else None
    samples = int(sys.argv[2]) if len(sys.argv) > 2 else 64
    image = render(studio(), (432, 270), integrator=Path(samples=samples, bounces=10), backend=backend)
    print(image.save("studio.png", exposure=0.7, tonemap="agx"))
