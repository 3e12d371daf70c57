"""A meadow of eleven million triangles, path traced: its tufts, poppies and stones are instances of five meshes.

The instances share the triangles of their meshes: the process takes 220 MB. With triangles of their own they would take
more than 5 GB.

    python examples/meadow.py [numpy|opencl|glsl] [samples]
"""

import sys

import numpy as np

from raytracer import Camera, DirectionalLight, EnvironmentLight, Instance, Material, Mesh, Path, Scene, render
from raytracer.meshes.mesh import joined
from raytracer.meshes.shapes import sphere

GRASS, STRAW, POPPY, STONE, EARTH = (
    Material(color, specular=0.05)
    for color in [(0.16, 0.34, 0.06), (0.42, 0.4, 0.12), (0.75, 0.05, 0.02), (0.42, 0.4, 0.37), (0.12, 0.1, 0.05)]
)


def height(x, z):
    """Return the height of the ground, of arrays or numbers."""
    return 0.5 * np.sin(0.45 * x + 0.6) * np.cos(0.38 * z) + 0.12 * np.sin(1.3 * x + 0.7 * z)


def strip(rows):
    """Return the triangles of a strip whose vertices stand in `rows` pairs, as indices (2 (rows - 1), 3)."""
    return (2 * np.arange(rows - 1)[:, None, None] + [[0, 1, 3], [0, 3, 2]]).reshape(-1, 3)


def tuft(seed, material, blades=250, steps=5):
    """Return blades of grass, each a bent strip that ends in a point."""
    random = np.random.default_rng(seed)
    angle, lean, reach = (random.uniform(*ends, (blades, 1, 1)) for ends in ((0, 2 * np.pi), (0.05, 0.5), (0.35, 0.9)))
    root, along = random.normal(0, 0.12, (2, blades, 1, 1)), np.linspace(0, 1, steps)[:, None]
    side, out = np.array([-0.012, 0.012]) * (1 - along**2), lean * along**2
    x, y = root[0] + out * np.cos(angle) - side * np.sin(angle), reach * (along - 0.3 * out) + 0 * side
    places = np.stack([x, y, root[1] + out * np.sin(angle) + side * np.cos(angle)], axis=-1)
    faces = 2 * steps * np.arange(blades)[:, None, None] + strip(steps)
    return Mesh(places.reshape(-1, 3), faces.reshape(-1, 3), material=material)


def placing(angle, scale, x, y, z):
    """Return the matrix that turns about y, scales and moves."""
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    return np.array([[c, 0, s, x], [0, scale, 0, y], [-s, 0, c, z], [0, 0, 0, 1]])


def poppy():
    """Return a flower of four petals, flattened balls."""
    petal = sphere(0.09, POPPY, rings=10, segments=16).transformed(
        np.array([[1, 0, 0, 0.06], [0.5, 0.35, 0, 0.78], [0, 0, 1, 0], [0, 0, 0, 1]])
    )
    return joined([petal.transformed(placing(k * np.pi / 2, 1, 0, 0, 0)) for k in range(4)])


def meadow(tufts=5000, size=16.0):
    """Return a meadow of `tufts` tufts of grass, poppies and stones; it reaches from -size to size."""
    random, x = np.random.default_rng(5), np.linspace(-size, size, 97)
    sides = np.stack([np.repeat(x, 97), height(np.repeat(x, 97), np.tile(x, 97)), np.tile(x, 97)], axis=1)
    corner = (np.arange(96)[:, None] * 97 + np.arange(96)).reshape(-1, 1, 1)
    ground = Mesh(sides, (corner + [[0, 1, 98], [0, 98, 97]]).reshape(-1, 3), material=EARTH).smoothed()
    stone = sphere(0.2, STONE).transformed(np.diag([1, 0.6, 0.8, 1]))
    parts = [ground]
    kinds = {tuft(1, GRASS): 50, tuft(2, GRASS): 35, tuft(3, STRAW): 15, poppy(): 12, stone: 2}
    for mesh, share in kinds.items():
        for x, z in random.uniform(-size, size, (max(1, share * tufts // 100), 2)):
            turn, scale = random.uniform(0, 2 * np.pi), random.uniform(0.6, 1.2)
            parts.append(Instance(mesh, placing(turn, scale, x, height(x, z), z)))
    lights = [EnvironmentLight((0.42, 0.58, 0.9)), DirectionalLight((-3, -2.2, -1), (2.6, 2.3, 1.7))]
    return Scene(parts, lights, Camera((1.5, 1.75, 9.5), (0.2, 0.1, 0), fov=42))


if __name__ == "__main__":
    backend, samples = (sys.argv[1:] + [None, None])[:2]
    image = render(meadow(), (432, 270), integrator=Path(samples=int(samples or 36), bounces=3), backend=backend)
    print(image.save("meadow.png", exposure=0.2, tonemap="agx"))
