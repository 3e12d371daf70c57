"""Lights, a floor and a camera for meshes that come without them.

Stage: scene description. What is up in the meshes is y here: `upright` gives the rotation in between.

    turn = upright((0, 0, 1))
    key_and_fill("part", *bounds_of(meshes, turn), turn), fitted(meshes, turn)
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from raytracer.appearance.materials import Material, Triple
from raytracer.errors import SceneError
from raytracer.meshes.mesh import Mesh, PlacedMesh, product
from raytracer.meshes.shapes import floor
from raytracer.scene.camera import Camera, radius_of
from raytracer.scene.lights import Light, PointLight

Matrix = NDArray[np.float64]
MIRROR_FLOOR = Material(color=(0.40, 0.39, 0.38), specular=0.0, reflectivity=0.22)
TOWARD: Final[Triple] = (0.42, 0.42, 1.0)
"""The direction from the meshes to the camera."""
FOV: Final = 32.0
FILLED: Final = 0.88
"""The share of the picture's shorter side that meshes span: a ball then covers 0.61 of a square picture."""
NEAREST: Final = 0.1
"""The least distance from the camera to meshes, in radii: what lies along the line of sight has no width."""
_ENCLOSED: Final = 0.8
"""The share of 26 ways from a camera that end on meshes which enclose it: a room may have windows and a door."""
_PART: Final = 0.5
"""The place of a light inside, as a share of the free way."""
_AT_ONCE: Final = 1 << 16
"""Triangles that are compared with the ways at once."""
_LARGEST = 1e33
"""Radius of a mesh that can be framed: its floor is 400 times as large."""


def upright(up: Triple) -> Matrix:
    """Return the smallest rotation (3, 3) that takes y to `up`; SceneError where that is no direction."""
    try:
        direction = np.asarray(up, dtype=np.float64)
    except (TypeError, ValueError):
        direction = np.zeros(0)
    if direction.shape != (3,) or not np.all(np.isfinite(direction)) or not direction.any():
        raise SceneError(f"up is a direction of three finite numbers that are not all 0, not {up!r}")
    direction = direction / np.abs(direction).max()
    x, y, z = (direction / np.linalg.norm(direction)).tolist()
    if y <= -1:
        return np.diag([1.0, -1.0, -1.0])
    # Rodrigues' formula about the axis (z, 0, -x), whose length is the sine of the angle, with y as the cosine.
    part = 1 / (1 + y)
    return np.array([[1 - x * x * part, x, -x * z * part], [-x, y, -z], [-x * z * part, z, 1 - z * z * part]])


def bounds_of(meshes: Sequence[Mesh], turn: Matrix) -> tuple[Matrix, Matrix]:
    """Return the corners of the box round all triangles, in coordinates that `turn` takes to those of the meshes.

    Without triangles it is the unit cube about the origin.
    """
    straight = np.array_equal(turn, np.eye(3))
    boxes = np.array([_box_of(mesh, turn, straight) for mesh in meshes if len(mesh)])
    if not len(boxes):
        return np.full(3, -0.5), np.full(3, 0.5)
    return boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)


def _box_of(mesh: Mesh, turn: Matrix, straight: bool) -> Matrix:
    """Return the corners (2, 3) of the box round a mesh; `straight` where `turn` is the identity."""
    if straight and isinstance(mesh, PlacedMesh):
        return mesh.box
    vertices = product(mesh.used_vertices, turn)
    return np.stack([vertices.min(axis=0), vertices.max(axis=0)])


def key_and_fill(name: str, low: Matrix, high: Matrix, turn: Matrix) -> tuple[Light, Light]:
    """Return two lights for the contents of a box; SceneError where the box is too large."""
    radius = radius_of(low, high)
    if radius > _LARGEST:
        raise SceneError(f"{name}: a mesh of {2 * radius:.3g} across is too large to be framed; scale it")
    middle = (low + high) / 2
    return (
        PointLight(triple(turn @ (middle + radius * np.array((-3, 5, 4)))), (0.85, 0.82, 0.76)),
        PointLight(triple(turn @ (middle + radius * np.array((5, 3, 2.5)))), (0.30, 0.34, 0.42)),
    )


def lights_for(name: str, meshes: Sequence[Mesh], camera: Camera, turn: Matrix) -> tuple[Light, Light]:
    """Return two lights for meshes that come without: around them, or inside where they enclose the camera.

    They enclose it where most ways from it, up, down and to all sides, end on a triangle, and so does the way ahead.
    The lights inside stand above the camera and before it, at parts of the free ways there, so that no wall is between.
    """
    low, high = bounds_of(meshes, turn)
    eye = np.asarray(camera.position, dtype=np.float64)
    place = eye @ turn
    if not ((low < place) & (place < high)).all():
        return key_and_fill(name, low, high, turn)
    _, _, ahead = camera.axes
    around = np.array([way for way in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(way)])
    ways = np.concatenate([[turn[:, 1], ahead], around / np.linalg.norm(around, axis=1, keepdims=True)])
    free = free_ways(meshes, eye, ways)
    if not np.isfinite(free[:2]).all() or np.isfinite(free[2:]).mean() < _ENCLOSED:
        return key_and_fill(name, low, high, turn)
    above, before = (eye + _PART * free[k] * ways[k] for k in range(2))
    return PointLight(triple(above), (0.85, 0.82, 0.76)), PointLight(triple(before), (0.30, 0.34, 0.42))


def free_ways(meshes: Sequence[Mesh], eye: Matrix, ways: Matrix) -> Matrix:
    """Return the distance from the eye to the nearest triangle along unit vectors (N, 3), as (N,); infinite for no hit.

    Let a, b and c be the corners of a triangle relative to the eye. A ray from the eye hits it where the ray lies on
    the same side of the planes through the eye and an edge, whose normals are a x b, b x c and c x a.
    """
    distances = np.full(len(ways), np.inf)
    for mesh in meshes:
        corners = mesh.corners
        for first in range(0, len(mesh), _AT_ONCE):
            a, b, c = np.moveaxis(corners[first : first + _AT_ONCE] - eye, 1, 0)
            sides = np.stack([np.cross(p, q) @ ways.T for p, q in ((a, b), (b, c), (c, a))])
            normals = np.cross(b - a, c - a)
            with np.errstate(all="ignore"):
                t = np.einsum("ij,ij->i", normals, a)[:, None] / (normals @ ways.T)
                hit = ((sides >= 0).all(axis=0) | (sides <= 0).all(axis=0)) & (t > 0)
            distances = np.minimum(distances, np.where(hit, t, np.inf).min(axis=0))
    return distances


def ground(low: Matrix, high: Matrix, turn: Matrix) -> Mesh:
    """Return a floor under the contents of a box."""
    radius = radius_of(low, high)
    x, _, z = ((low + high) / 2).tolist()
    placed = np.eye(4)
    placed[:3, :3] = turn
    return floor(400 * radius, MIRROR_FLOOR).moved((x, float(low[1]) - 1e-4 * radius, z)).transformed(placed)


def fitted(meshes: Sequence[Mesh], turn: Matrix) -> Camera:
    """Return the nearest camera in the direction `TOWARD` whose picture shows meshes within the share `FILLED`.

    All corners lie between the four planes through the eye that bound this part of the picture. Across, the planes have
    the normals k f + r and k f - r, where f looks along the line of sight, r to the right, and k is the tangent of half
    the angle. A corner p is inside where (p - eye) . n >= 0, so the least p . n of both planes say where they meet.
    """
    low, high = bounds_of(meshes, turn)
    middle, radius = (low + high) / 2, radius_of(low, high)
    forward, sides, reach, normals = _sight()
    least = np.full(5, np.inf)
    for mesh in meshes:
        if len(mesh):
            corners = (product(mesh.used_vertices, turn) - middle) / radius
            least = np.minimum(least, product(corners, normals).min(axis=0))
    if not np.all(np.isfinite(least)):  # no triangles: the box itself
        least = -np.abs(normals).sum(axis=0) / math.sqrt(3)
    a, b, c, d, front = least
    depth = min((a + b) / (2 * reach), (c + d) / (2 * reach), front - NEAREST)
    eye = depth * forward + (a - b) / 2 * sides[0] + (c - d) / 2 * sides[1]
    target = eye - depth * forward
    return Camera(
        triple(turn @ (middle + radius * eye)), triple(turn @ (middle + radius * target)), triple(turn[:, 1]), FOV
    )


def _sight() -> tuple[Matrix, tuple[Matrix, Matrix], float, Matrix]:
    """Return the line of sight, the directions right and up, the tangent, and the normals (3, 5); see `fitted`."""
    forward = -np.asarray(TOWARD) / np.linalg.norm(TOWARD)
    right = np.cross(forward, (0, 1, 0))
    right /= np.linalg.norm(right)
    sides = (right, np.cross(right, forward))
    reach = FILLED * math.tan(math.radians(FOV) / 2)
    normals = np.stack([*(reach * forward + sign * side for side in sides for sign in (1, -1)), forward], axis=1)
    return forward, sides, reach, normals


def outermost(meshes: Sequence[Mesh]) -> Matrix:
    """Return the corners (N, 3) of meshes that decide their box and their camera, where y is up."""
    *_, normals = _sight()
    directions = np.concatenate([np.eye(3), -np.eye(3), normals], axis=1)
    points = [np.zeros((0, 3))]
    for mesh in meshes:
        if len(mesh):
            corners = mesh.used_vertices
            points.append(corners[(corners @ directions).argmin(axis=0)])
    return np.concatenate(points)


def triple(values: Matrix) -> Triple:
    """Return an array (3,) as a tuple."""
    x, y, z = values.tolist()
    return x, y, z
