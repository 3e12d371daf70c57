"""Velvet, felt and satin on torus knots, path traced under a soft sky, for the eye by the curve AgX.

A sheen is the light of a cloth's fibres: it shines where the surface turns away from the eye. `transparent=True` would
leave out what is behind the scene; here a wall closes it.

    python examples/fabrics.py [numpy|opencl|glsl] [samples]
"""

import sys

import numpy as np

from raytracer import Camera, EnvironmentLight, MetallicRoughness, Path, Scene, SpotLight, Texture, Unlit, render
from raytracer.meshes.shapes import floor, knot

CLOTHS = [
    MetallicRoughness((0.35, 0.01, 0.03), roughness=0.9, sheen_color=(1.0, 0.55, 0.6), sheen_roughness=0.35),
    MetallicRoughness((0.03, 0.16, 0.05), roughness=1.0, sheen_color=(0.5, 0.8, 0.4), sheen_roughness=0.8),
    MetallicRoughness((0.05, 0.08, 0.4), roughness=0.35, sheen_color=(0.4, 0.5, 1.0), sheen_roughness=0.2),
]


def sky():
    """Return the light around the scene, brightest above: (32, 64, 3)."""
    height = np.linspace(1, -1, 32)[:, None, None]
    light = np.where(height > 0, (0.25, 0.28, 0.34) + height * (0.5, 0.5, 0.5), (0.16, 0.14, 0.12))
    return Texture(np.broadcast_to(light, (32, 64, 3)).astype(np.float32), srgb=False)


def fabrics():
    """Return the scene."""
    ground = floor(14, MetallicRoughness((0.32, 0.3, 0.28), roughness=0.7)).moved((0, -0.62, 0))
    meshes = [ground]
    for k, cloth in enumerate(CLOTHS):
        meshes.append(knot(2, 3, 0.42, 0.17, cloth, segments=192, sides=24).moved((1.5 * k - 1.5, 0, 0)))
        meshes.append(floor(0.9, Unlit(cloth.base_color)).moved((1.5 * k - 1.5, -0.61, 1.1)))
    meshes.append(ground.moved((0, 0, -3.2), tilt=90))
    spot = SpotLight((3, 4, -3), (-3, -4, 3), 10, 30, (40, 38, 34))
    return Scene(meshes, [EnvironmentLight(sky(), rotation=90), spot], Camera((0, 2.1, 4.6), (0, -0.1, 0.1), fov=34))


if __name__ == "__main__":
    backend = sys.argv[1] if len(sys.argv) > 1 else None
    samples = int(sys.argv[2]) if len(sys.argv) > 2 else 64
    image = render(fabrics(), (432, 240), integrator=Path(samples=samples), backend=backend)
    print(image.save("fabrics.png", exposure=0.5, tonemap="agx"))
