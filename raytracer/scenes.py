"""The built-in scenes: made from formulas, no files needed.

Stage: scene description. `SCENES` gives for each name the function that makes it; the first line of the function's
docstring is what `raytracer scenes` prints.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np

import shpy as sh
from raytracer import shaders
from raytracer.appearance.materials import Material, Triple
from raytracer.appearance.programs import Hit, Surface
from raytracer.appearance.textures import Texture
from raytracer.meshes import Mesh
from raytracer.meshes.shapes import box, cylinder, floor, icosahedron, knot, sphere, torus
from raytracer.meshes.teapot import teapot as newells_teapot
from raytracer.scene.camera import Camera
from raytracer.scene.lights import DirectionalLight, PointLight
from raytracer.scene.scene import Scene
from raytracer.shaders import checker


def boxes() -> Scene:
    """Three boxes, 36 triangles, two lights."""
    slab = box((6.4, 0.4, 6.4), Material((0.55, 0.54, 0.50), specular=0.0, reflectivity=0.2))
    tall = box((1.5, 2.7, 1.5), Material((0.13, 0.32, 0.60), specular=0.3, reflectivity=0.12))
    cube = box((1.4, 1.4, 1.4), Material((0.78, 0.24, 0.08), specular=0.3))
    meshes = (
        slab.moved((0, -0.2, 0), turn=12),
        tall.moved((-1.0, 1.35, -0.6), turn=38),
        cube.moved((1.1, 0.7, 0.8), turn=-20),
    )
    lights = (PointLight((-5, 8, 5), (0.85, 0.80, 0.72)), PointLight((7, 5, 2), (0.26, 0.30, 0.38)))
    camera = Camera((4.2, 5.0, 9.2), (0, 0.7, 0), fov=38)
    return Scene(meshes, lights, camera, background=(0.52, 0.62, 0.75), name="boxes")


def cubes() -> Scene:
    """Cubes distributed in a room: 2,064 triangles, two lights, everything mirrors a little."""
    room = box((12, 7, 12), Material((0.22, 0.23, 0.26), specular=0.0, reflectivity=0.1), inward=True)
    colors = ((0.72, 0.09, 0.05), (0.03, 0.25, 0.60), (0.85, 0.45, 0.03), (0.10, 0.40, 0.08), (0.60, 0.60, 0.62))
    kinds = [
        box((0.5, 0.5, 0.5), Material(color, specular=0.4, reflectivity=reflectivity))
        for color, reflectivity in zip(colors, (0.1, 0.2, 0.1, 0.1, 0.5), strict=True)
    ]
    meshes = [room.moved((0, 3.5, 0))]
    for k in range(171):
        # Additive recurrence in three dimensions: places that are spread evenly (Roberts 2018).
        x, y, z = ((0.5 + k * step) % 1 for step in (0.8191725134, 0.6710436067, 0.5497004779))
        meshes.append(kinds[k % 5].moved((10.5 * x - 5.25, 0.5 + 6 * y, 8 * z - 5.5), turn=37.0 * k))
    lights = (PointLight((-3, 6.6, 4), (1.0, 0.94, 0.84)), PointLight((4, 6.2, -2), (0.35, 0.38, 0.45)))
    camera = Camera((0.6, 4.2, 5.85), (0, 3.1, 0), fov=70)
    return Scene(meshes, lights, camera, background=(0, 0, 0), ambient=0.15, name="cubes")


def mirror_box() -> Scene:
    """Coloured shapes in a room with mirrors for walls: reflections of reflections."""
    room = box((8, 5, 8), Material((0.30, 0.34, 0.38), diffuse=0.6, specular=0.0, reflectivity=0.82), inward=True)
    ground = floor(8, Material((0.42, 0.36, 0.31), specular=0.0, reflectivity=0.08))
    ball = sphere(0.8, Material((0.78, 0.10, 0.07), specular=0.6, shininess=80), rings=24, segments=48)
    meshes = (
        room.moved((0, 2.5, 0)),
        ground.moved((0, 0.01, 0)),
        ball.moved((-1.2, 0.81, 0.4)),
        box((1.1, 1.9, 1.1), Material((0.86, 0.58, 0.10))).moved((0.9, 0.96, -0.9), turn=25),
        icosahedron(0.62, Material((0.08, 0.40, 0.58), specular=0.4)).moved((1.5, 0.55, 1.2), turn=15),
        torus(0.55, 0.2, Material((0.20, 0.50, 0.16), specular=0.4), segments=48, sides=24).moved((-0.1, 0.215, 1.9)),
    )
    lights = (PointLight((-2.2, 4.4, 2.4), (0.85, 0.80, 0.72)), PointLight((2.6, 4.0, -1.5), (0.35, 0.38, 0.45)))
    camera = Camera((-3.2, 2.7, 3.6), (0.5, 0.7, -0.5), fov=62)
    return Scene(meshes, lights, camera, background=(0, 0, 0), ambient=0.15, name="mirror-box")


def mixed() -> Scene:
    """High and low polygon objects together: 61,562 triangles, two lights, a mirroring floor."""
    red = Material((0.70, 0.07, 0.05), specular=0.5, shininess=60, reflectivity=0.06)
    silver = Material((0.55, 0.57, 0.60), diffuse=0.5, specular=0.9, shininess=200, reflectivity=0.75)
    gold = Material((0.75, 0.46, 0.09), specular=0.6, shininess=50, reflectivity=0.15)
    stone = Material((0.42, 0.41, 0.38), specular=0.0)
    teal, violet = Material((0.05, 0.36, 0.40), specular=0.3), Material((0.32, 0.20, 0.55), specular=0.3)
    green = Material((0.24, 0.46, 0.12))
    low = [
        box((0.7, 0.7, 0.7), green).moved((-2.7, 0.35, 1.9), turn=20),
        box((0.5, 0.5, 0.5), teal).moved((-2.62, 0.95, 1.95), turn=52),
        box((0.6, 1.2, 0.6), violet).moved((3.3, 0.6, -0.9), turn=-15),
        box((0.8, 0.5, 0.8), teal).moved((2.85, 0.25, 1.95), turn=35),
        box((2.2, 0.25, 2.2), stone).moved((0, 0.125, 0), turn=45),
        icosahedron(0.45, violet).moved((-0.9, 0.37, 2.5), turn=10, tilt=20),
        icosahedron(0.35, red).moved((2.85, 0.79, 1.95), turn=40, tilt=20),
        icosahedron(0.4, gold).moved((0.55, 0.33, 2.75), turn=70, tilt=20),
        floor(400, Material((0.42, 0.41, 0.40), specular=0.0, reflectivity=0.2)),
    ]
    high = [
        knot(2, 3, 0.78, 0.25, red, segments=400, sides=40).moved((0, 1.62, 0), turn=15),
        sphere(0.9, silver, rings=127, segments=64).moved((2.0, 0.9, 0.35)),
        torus(0.75, 0.26, gold, segments=128, sides=48).moved((-2.15, 0.85, -0.1), turn=35, tilt=62),
        cylinder(0.55, 2.2, teal, segments=256).moved((-1.7, 1.1, -1.9)),
    ]
    lights = (PointLight((-4, 8, 6), (0.80, 0.76, 0.68)), DirectionalLight((-5, -4, -3), (0.28, 0.32, 0.40)))
    camera = Camera((0.8, 3.9, 8.8), (0.15, 0.75, 0), fov=37)
    return Scene([*high, *low], lights, camera, background=(0.46, 0.56, 0.70), name="mixed")


def spheres() -> Scene:
    """Mirroring balls on balls, four generations: 72,066 triangles."""
    colors = ((0.30, 0.33, 0.38), (0.72, 0.30, 0.02), (0.02, 0.16, 0.48), (0.50, 0.02, 0.02))
    shapes = [
        sphere(1.0, Material(color, specular=0.7, shininess=150, reflectivity=0.2), rings=n, segments=2 * n)
        for color, n in zip(colors, (48, 24, 16, 8), strict=True)
    ]
    meshes: list[Mesh] = []

    def grow(x: float, y: float, z: float, radius: float, level: int, came: tuple[float, float, float]) -> None:
        meshes.append(shapes[level].moved((x, y, z), scale=radius))
        if level == 3:
            return
        smaller = radius * 0.42
        for dx, dy, dz in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)):
            if (dx, dy, dz) != tuple(-c for c in came):
                step = radius + smaller
                grow(x + step * dx, y + step * dy, z + step * dz, smaller, level + 1, (dx, dy, dz))

    grow(0, 0, 0, 1, 0, (0, 1, 0))
    ground = floor(4000, Material((0.15, 0.15, 0.16), specular=0.0, reflectivity=0.3)).moved((0, -1.0, 0))
    lights = (PointLight((-4, 7, 6), (1.0, 0.95, 0.86)), PointLight((6, 4, 1), (0.24, 0.28, 0.36)))
    camera = Camera((2.5, 2.1, 5.2), (0, 0.6, 0), fov=42)
    return Scene([*meshes, ground], lights, camera, background=(0.10, 0.16, 0.26), name="spheres")


def glass() -> Scene:
    """Glass, faintly and strongly tinted, over a checked floor: 21,230 triangles; look at it with --bounces 8."""
    blue, green, amber = (
        Material((0, 0, 0), specular=0.0, transmission=1.0, ior=1.5, absorption=absorption)
        for absorption in ((0.3, 0.13, 0.07), (1.6, 0.25, 1.1), (0.15, 0.6, 2.4))
    )
    ball = sphere(1.0, blue, rings=64, segments=96)
    ground = floor(24, Material(surface=checker(squares=24), specular=0.0))
    meshes = [
        ball.moved((-1.25, 1.002, 0.2)),
        box((1.1, 1.6, 1.1), green).moved((1.15, 0.802, -0.3), turn=28),
        torus(0.5, 0.19, amber, segments=96, sides=36).moved((0.35, 0.195, 1.65)),
        sphere(0.55, Material((0.75, 0.13, 0.07), specular=0.5), rings=24, segments=48).moved((-0.02, 0.55, -2.2)),
        ground,
    ]

    def sky(direction: sh.Vector3f) -> sh.Color3f:  # from the horizon to the zenith
        return sh.mix(sh.Color3f(0.70, 0.77, 0.85), sh.Color3f(0.10, 0.24, 0.55), sh.sqrt(sh.saturate(direction.y)))

    lights = (PointLight((-4, 8, 4), (0.9, 0.86, 0.8)), PointLight((6, 5, 3), (0.25, 0.28, 0.34)))
    camera = Camera((0.3, 2.7, 6.4), (0.05, 0.75, 0), fov=37)
    return Scene(meshes, lights, camera, background=sky, name="glass")


def materials() -> Scene:
    """Balls, one for each shader of `raytracer.shaders`, a texture, a mirror and glass: 71,454 triangles."""
    stripes = np.zeros((8, 8, 3)) + [0.05, 0.25, 0.35]
    stripes[::2, ::2] = stripes[1::2, 1::2] = [0.85, 0.80, 0.62]
    looks = [
        Material(surface=shaders.marble(size=0.8), specular=0.5, shininess=90),
        Material(surface=shaders.wood(), specular=0.15),
        Material(surface=shaders.spots(size=0.35)),
        Material((0.75, 0.55, 0.16), surface=shaders.bumps(), specular=0.5),
        Material(color=Texture(stripes), specular=0.3),
        Material((0.20, 0.50, 0.80), shade=shaders.toon()),
        Material((0.60, 0.62, 0.66), diffuse=0.4, specular=0.8, shininess=150, reflectivity=0.7),
        Material((0.62, 0.42, 0.30), shade=shaders.oren_nayar()),
        Material((0.30, 0.14, 0.09), shade=shaders.cook_torrance()),
        Material((0, 0, 0), specular=0.0, transmission=1.0),
    ]
    ball = sphere(0.62, rings=48, segments=76)
    meshes = [
        ball.with_material(look).moved((1.45 * (k % 5 - 2), 0.62 + 1.15 * (k < 5), -0.9 if k < 5 else 0.9), turn=20)
        for k, look in enumerate(looks)
    ]
    step = box((7.6, 1.15, 1.5), Material((0.10, 0.11, 0.13), specular=0.0, reflectivity=0.08)).moved((0, 0.573, -0.9))
    tiles = checker((0.40, 0.38, 0.34), (0.24, 0.23, 0.21), 60)
    ground = floor(60, Material(surface=tiles, specular=0.0, reflectivity=0.1))
    lights = (PointLight((-5, 8, 7), (0.9, 0.87, 0.8)), PointLight((7, 5, 4), (0.25, 0.28, 0.34)))
    camera = Camera((0, 3.4, 8.8), (0, 0.95, 0), fov=39)
    return Scene([*meshes, step, ground], lights, camera, name="materials")


def teapot() -> Scene:
    """Return Newell's teapot, glazed, on a wooden table by a window: 61,324 triangles."""

    def glazed(hit: Hit) -> Surface:  # Schlick's approximation of Fresnel's equations, as for glass of ior 1.6
        return Surface(reflectivity=0.05 + 0.95 * _grazing(hit))

    glaze = Material((0.015, 0.14, 0.17), diffuse=1.0, specular=0.0, surface=glazed)
    table = box((17, 0.6, 9.5), Material(surface=_planks, specular=0.0)).moved((0, -0.3, 1.0))
    # Behind the camera, so that the glaze mirrors something.
    pane, sky = (
        Material((0, 0, 0), diffuse=0.0, specular=0.0, emission=color) for color in ((10, 9.5, 8.7), (1.6, 1.9, 2.3))
    )
    window = [floor(2.2, pane).moved((-8 + 2.4 * i, 6.6 + 2.4 * j, 8.5), tilt=90) for i in (0, 1) for j in (0, 1)]
    sugar = box((0.36, 0.36, 0.36), Material((0.85, 0.83, 0.78), specular=0.1))
    cubes = [sugar.moved((x, 0.18, z), turn=turn) for x, z, turn in ((2.1, 2.5, 25), (2.75, 2.2, -12), (2.6, 2.95, 55))]
    meshes = [
        newells_teapot(glaze).moved(turn=20),
        table,
        *cubes,
        *window,
        box((0.1, 7, 5), sky).moved((10, 4.5, 3)),
    ]
    lights = (PointLight((-6.5, 8.5, 8), (1.25, 1.18, 1.06)), PointLight((9, 6, 4), (0.18, 0.21, 0.27)))
    camera = Camera((1.9, 3.9, 9.8), (0.25, 1.35, 0), fov=33)
    return Scene(meshes, lights, camera, background=(0.055, 0.05, 0.048), ambient=0.16, name="teapot")


def two_teapots() -> Scene:
    """Two mirroring teapots over a mirror: 28,562 triangles; each shows the other, and itself from below."""
    silver = Material((0.40, 0.42, 0.46), diffuse=0.35, specular=0.9, shininess=180, reflectivity=0.62)
    copper = Material((0.72, 0.30, 0.13), diffuse=0.55, specular=0.7, shininess=120, reflectivity=0.38)
    mirror = Material((0.10, 0.12, 0.16), specular=0.0, reflectivity=0.55)
    meshes = [
        newells_teapot(silver, divisions=15).moved((-2.2, 0, -0.5), turn=25),
        newells_teapot(copper, divisions=15).moved((2.75, 0, 0.6), turn=205, scale=0.8),
        floor(60, mirror).moved((0, -0.004, 0)),
    ]
    lights = (PointLight((-5, 9, 6), (0.95, 0.90, 0.82)), PointLight((7, 6, 4), (0.30, 0.34, 0.42)))
    camera = Camera((0.4, 4.6, 10.5), (0, 1.0, 0), fov=38)
    return Scene(meshes, lights, camera, background=(0.30, 0.42, 0.62), name="two-teapots")


def _grazing(hit: Hit) -> sh.Attrib1f:
    """Return 0 where a surface is seen from above and 1 where it is seen edge-on, as Fresnel's share grows."""
    return sh.pow(1 - sh.dot(hit.normal, hit.view), 5)


def _planks(hit: Hit) -> Surface:
    """Return varnished planks along x, 1.5 wide, each cut from another part of a trunk."""
    place = hit.position
    across = place.z / 1.5 + 0.35
    row = sh.floor(across)
    own = sh.fract(0.618 * row + 0.1)
    bend = 0.3 * sh.noise(sh.Attrib3f(0.2 * place.x + 40 * own, 0.5 * place.z, row))
    ring = sh.fract(3.5 * sh.length(sh.Attrib2f(place.z + 5 * own + bend, 1.4 + own + bend)))
    late = sh.smoothstep(0.1, 0.85, ring) * (1 - sh.smoothstep(0.85, 1.0, ring))
    near = 1 - sh.smoothstep(9.0, 18.0, hit.distance)  # farther away the pattern is finer than pixels
    fibre = near * sh.noise(sh.Attrib3f(1.5 * place.x, 25 * place.y, 25 * place.z))
    part = sh.clamp(sh.mix(0.45, 0.9 * late, near) + 0.25 * fibre, 0, 1)
    tone = sh.mix(sh.Color3f(0.33, 0.155, 0.06), sh.Color3f(0.16, 0.065, 0.024), part)
    seam = sh.smoothstep(0.485, 0.496, sh.abs(sh.fract(across) - 0.5))
    varnish = (0.03 + 0.5 * _grazing(hit)) * (1 - seam)
    return Surface(color=tone * (0.8 + 0.4 * own) * (1 - 0.8 * seam), reflectivity=varnish)


def chrome() -> Scene:
    """Return Newell's teapot of chrome, with a ball of glass and one of brass, under a sky: 69,442 triangles."""
    metal = Material((0.05, 0.05, 0.055), diffuse=0.5, specular=0.4, shininess=200, reflectivity=0.9)
    brass = Material((0.55, 0.33, 0.08), diffuse=0.9, specular=0.6, shininess=120, reflectivity=0.35)
    clear = Material((0, 0, 0), specular=0.0, transmission=1.0, ior=1.5)
    ball = sphere(0.55, rings=32, segments=66)
    tiles = checker((0.42, 0.39, 0.34), (0.30, 0.27, 0.24), 160)
    ground = floor(240, Material(surface=tiles, specular=0.0, reflectivity=0.06))
    meshes = [
        newells_teapot(metal).moved(turn=25),
        ball.with_material(brass).moved((2.2, 0.55, 2.1)),
        ball.with_material(clear).moved((-1.5, 0.552, 2.9)),
        ground,
    ]
    lights = (DirectionalLight((-_SUN[0], -_SUN[1], -_SUN[2]), (1.0, 0.93, 0.8)),)
    camera = Camera((1.2, 2.6, 8.6), (0.1, 1.35, 0), fov=38)
    return Scene(meshes, lights, camera, background=_sky, ambient=0.22, name="chrome")


_SUN: Triple = (-0.55, 0.62, 0.56)
"""The direction of the sun of `_sky`."""


def _sky(direction: sh.Vector3f) -> sh.Color3f:
    """Return the light of a sky with clouds above a hazy horizon, and with the sun."""
    height = sh.max(direction.y, 0.0)
    clear = sh.mix(sh.Color3f(0.72, 0.78, 0.84), sh.Color3f(0.10, 0.24, 0.58), sh.sqrt(height))
    place = sh.Attrib2f(direction.x, direction.z) * (1.4 / (height + 0.12))  # on a layer of clouds overhead
    thick = sh.library.fbm(place, 5)
    cover = sh.smoothstep(-0.05, 0.45, thick) * sh.smoothstep(0.0, 0.22, height)
    cloud = sh.mix(sh.Color3f(1.05, 1.02, 0.98), sh.Color3f(0.55, 0.58, 0.63), sh.smoothstep(0.15, 0.7, thick))
    near = sh.max(sh.dot(direction, sh.normalize(sh.Vector3f(*_SUN))), 0.0)
    glow = 0.35 * sh.pow(near, 16) + 8 * sh.smoothstep(0.9985, 0.9993, near) * (1 - cover)
    above = sh.mix(clear, cloud, 0.9 * cover) + glow * sh.Color3f(1.0, 0.9, 0.72)
    haze = sh.Color3f(0.40, 0.37, 0.33)
    return sh.mix(above, haze, sh.smoothstep(0.0, 0.05, -direction.y))


def cornell() -> Scene:
    """Cornell box: two blocks in a room under an area light, 38 triangles, for `--integrator path`.

    Lengths are in millimetres and the camera's place as they were measured at Cornell (Goral and others 1984; Cornell
    University Program of Computer Graphics 1998, Cornell Box Data). Walls and light have colours instead of spectra;
    the light's is that of Mitsuba's Cornell box.
    The ceiling has a hole, which the light fills; the side by which the camera looks in is open.
    """
    white, red, green = (
        Material(color, diffuse=1.0, specular=0.0)
        for color in ((0.725, 0.71, 0.68), (0.63, 0.065, 0.05), (0.14, 0.45, 0.091))
    )
    light = Material((0.78, 0.78, 0.78), diffuse=1.0, specular=0.0, emission=(18.387, 13.987, 6.754))
    corners = [(556.0, 548.8, 0.0), (556.0, 548.8, 559.2), (0.0, 548.8, 559.2), (0.0, 548.8, 0.0)]
    lamp = [(343.0, 548.8, 227.0), (343.0, 548.8, 332.0), (213.0, 548.8, 332.0), (213.0, 548.8, 227.0)]
    frame = [(k, (k + 1) % 4, 4 + (k + 1) % 4, 4 + k) for k in range(4)]
    ground = [(552.8, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 559.2), (549.6, 0.0, 559.2)]
    short = [(130.0, 65.0), (82.0, 225.0), (240.0, 272.0), (290.0, 114.0)]
    tall = [(423.0, 247.0), (265.0, 296.0), (314.0, 456.0), (472.0, 406.0)]
    meshes = (
        _quads(ground, [(0, 1, 2, 3)], white, "floor"),
        _quads(corners + lamp, frame, white, "ceiling"),
        _quads([*ground[2:], *corners[1:3]], [(0, 1, 2, 3)], white, "back wall"),
        _quads([ground[0], ground[3], corners[1], corners[0]], [(0, 1, 2, 3)], red, "left wall"),
        _quads([ground[2], ground[1], corners[3], corners[2]], [(0, 1, 2, 3)], green, "right wall"),
        _block(short, 165.0, white, "short block"),
        _block(tall, 330.0, white, "tall block"),
        _quads(lamp, [(0, 1, 2, 3)], light, "light"),
    )
    camera = Camera((278, 273, -800), (278, 273, 0), fov=math.degrees(2 * math.atan2(0.025 / 2, 0.035)))
    return Scene(meshes, (), camera, background=(0, 0, 0), ambient=0.0, name="cornell")


def _quads(corners: Sequence[Triple], quads: Sequence[tuple[int, ...]], material: Material, name: str) -> Mesh:
    """Return a mesh of quadrilaterals, two triangles each."""
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return Mesh(corners, faces, material=material, name=name)


def _block(base: Sequence[tuple[float, float]], height: float, material: Material, name: str) -> Mesh:
    """Return a block on the floor with these corners (x, z) and vertical sides: 10 triangles."""
    corners = [(x, y, z) for y in (0.0, height) for x, z in base]
    sides = [(k, (k + 1) % 4, 4 + (k + 1) % 4, 4 + k) for k in range(4)]
    return _quads(corners, [*sides, (4, 5, 6, 7)], material, name)


SCENES: Final[Mapping[str, Callable[[], Scene]]] = {
    "boxes": boxes,
    "cubes": cubes,
    "mirror-box": mirror_box,
    "mixed": mixed,
    "spheres": spheres,
    "glass": glass,
    "materials": materials,
    "teapot": teapot,
    "two-teapots": two_teapots,
    "chrome": chrome,
    "cornell": cornell,
}
