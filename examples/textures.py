"""Textures of the shader library: a floor with mipmaps, a sky on a cube, a ball of solid stone and one that mirrors.

The left half of the floor takes the image itself, the right half the level that fits the size of a pixel there.

    python examples/textures.py [numpy|opencl|glsl]
"""

import sys

import numpy as np
from pictures import save

import shpy as sh
from shpy import SH_ELIF, SH_IF
from shpy.library import Mipmap, Texture3D, TextureCube, lerp, look_at, srgb_from_linear

EYE = (0, 1.3, 4.5)
SUN = (-0.5, 0.6, 0.62)


def sky_of(directions):
    """Return the light from each direction: blue above, pale beside the horizon, and a sun."""
    units = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    air = [0.75, 0.85, 0.95] + np.clip(units[..., 1:2], 0, 1) ** 0.6 * [-0.62, -0.55, -0.25]
    return air + np.clip(units @ SUN, 0, 1)[..., None] ** 300 * [2.5, 2.0, 1.2]


random = np.random.default_rng(5)
tiles = np.kron(random.uniform(0.75, 1, (4, 4)) * (np.indices((4, 4)).sum(axis=0) % 2 * 0.8 + 0.2), np.ones((16, 16)))
floor = Mipmap(tiles[..., None] * [0.9, 0.7, 0.5], wrap="repeat")
sky = TextureCube(sky_of(TextureCube.directions(128)))
stone = Texture3D(random.random((12, 12, 12)), filter="cubic", wrap="repeat")


def ball(origin, direction, center):
    """Return the distance to a ball of radius 1, or a negative number."""
    along = sh.dot(center - origin, direction)
    rest = 1 - sh.dot(center - origin, center - origin) + along * along
    return sh.cond(rest > 0, along - sh.sqrt(sh.max(rest, 0)), -1.0)


def seen(origin, direction, uv, level):
    """Return the floor, which fades into the sky far away, or the sky."""
    far = sh.smoothstep(5, 60, sh.length(1.5 * uv - origin.xz))
    return sh.cond(direction.y < 0, lerp(floor(uv, level), sh.Color3f(0.75, 0.85, 0.95), far), sky(direction))


def below(origin, direction):
    """Return the point at which a ray meets the floor, in tiles."""
    return (origin - direction * (origin.y / sh.min(direction.y, -1e-4))).xz / 1.5


@sh.program
def scene() -> sh.Color3f:
    row, column = sh.grid_index(2)
    height, width = sh.grid_shape(2)
    at = sh.vec2(column + 0.5 - 0.5 * width, 0.5 * height - 0.5 - row) / height
    eye = sh.Point3f(*EYE)
    ray = sh.normalize(sh.inverse(look_at(eye, (0, 0.6, 0))) @ sh.Vector3f(at, -1.2))
    uv = below(eye, ray)
    level = floor.level(sh.dFdx(uv), sh.dFdy(uv))
    color = seen(eye, ray, uv, sh.cond(at.x > 0, level, 0.0))
    left, right = sh.Point3f(-1.15, 1, 0), sh.Point3f(1.15, 1, 0)
    to_left, to_right = ball(eye, ray, left), ball(eye, ray, right)
    with SH_IF(to_left > 0):
        normal = eye + to_left * ray - left
        veins = sh.smoothstep(0.35, 0.65, stone(0.35 * normal + 0.1 * sh.library.turbulence(2 * normal, 4)))
        light = 0.25 + 0.9 * sh.max(sh.dot(normal, SUN), 0)
        color[:] = light * lerp(sh.Color3f(0.5, 0.12, 0.1), sh.Color3f(0.95, 0.85, 0.75), veins)
    with SH_ELIF(lambda: to_right > 0):
        hit = eye + to_right * ray
        mirrored = sh.reflect(ray, hit - right)
        color[:] = 0.9 * seen(hit, mirrored, below(hit, mirrored), 1.0)
    return srgb_from_linear(sh.saturate(color))


if __name__ == "__main__":
    save("textures", scene.compile(*sys.argv[1:])(shape=(450, 800)))
