"""The layered depth cubes of a Renderer's secondary rays: of the scene, or of each of its objects that moves.

Stage: render. A rigid object keeps its cube, to which rays are taken; that of a deformed one is built anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.integrators.integrator import Integrator
from raytracer.integrators.motion import Motion
from raytracer.layered.cube import HasMeshes, LayeredCube, cube_of, is_layered
from raytracer.layered.placed import Meshes, PlacedCubes
from raytracer.meshes import Mesh
from raytracer.scene.layout import Layout

_FLAT = 2.0**-20
"""The determinant below which a matrix, its largest entry 1, flattens an object: there is no way back to its cube."""


def has_cubes(integrator: Integrator) -> bool:
    """Return whether secondary rays go through layered depth cubes."""
    accel = integrator.accel
    return getattr(integrator, "secondary", None) is not None or (accel is not None and is_layered(accel))


def scene_cube(integrator: Integrator, scene: HasMeshes, backend: str) -> LayeredCube:
    """Return the cube of a scene in which nothing moves: the integrator's own, or one that is made as it says."""
    own_cube: LayeredCube | None = getattr(integrator, "secondary", None)
    return _build_cube(integrator, scene, backend) if own_cube is None else own_cube


def object_cubes(
    integrator: Integrator, motion: Motion, moving: Sequence[int], layout: Layout, backend: str, before: Any
) -> PlacedCubes:
    """Make a cube for each object that moves, and one for the others; those of `before` that are of the same stay."""
    poses = {number: _pose(motion, number) for number in moving}
    meshes = {
        number: poses[number][0] if number in poses else mesh for number, mesh in enumerate(motion.meshes) if len(mesh)
    }
    cubes_by_part = dict(zip(before.parts, before.cubes, strict=True)) if isinstance(before, PlacedCubes) else {}
    cubes = PlacedCubes.of(
        meshes, moving, lambda part: cubes_by_part.get(part) or _build_cube(integrator, Meshes(part), backend)
    )
    cubes.place({number: matrix for number, (_, matrix) in poses.items()}, layout.origin, layout.scale)
    return cubes


def follow(motion: Motion, layout: Layout) -> bool:
    """Place a layout's cubes where the objects are; return False if one of these needs another cube."""
    cubes = layout.secondary
    if not isinstance(cubes, PlacedCubes):
        return True
    poses = {number: _pose(motion, number) for number in cubes.moving}
    if any(mesh is not before for (mesh, _), before in zip(poses.values(), cubes.objects, strict=True)):
        return False
    cubes.place({number: matrix for number, (_, matrix) in poses.items()}, layout.origin, layout.scale)
    return True


def _build_cube(integrator: Integrator, part: HasMeshes, backend: str) -> LayeredCube:
    own_cube: LayeredCube | None = getattr(integrator, "secondary", None)
    if own_cube is not None:
        return LayeredCube.of(part, backend=backend, **own_cube.options)
    assert integrator.accel is not None  # else there are no cubes
    return cube_of(integrator.accel, part, backend)


def _pose(motion: Motion, number: int) -> tuple[Mesh, NDArray[np.float64]]:
    """Return the mesh of which an object's cube is made, and its pose (4, 4).

    A transform that flattens the mesh has no inverse: then the mesh is transformed first, and the pose is the identity.
    """
    matrix = motion.transform(number)
    turn = matrix[:3, :3]
    if abs(np.linalg.det(turn / (np.abs(turn).max() or 1))) < _FLAT:
        return motion.meshes[number], np.eye(4)
    return motion.untransformed(number), matrix
