"""PlacedCubes: the layered depth cubes of a scene whose objects move, each with its transformation.

Stage: accelerate. An object that moves keeps its cube, and rays are transformed to it; the static meshes share one
cube. All cubes have the same resolution and blocks, so that their tables are concatenated and a walk finds each by its
index.

    cubes = PlacedCubes.of(meshes, moving, make)       # make(tuple of meshes) gives a LayeredCube
    cubes.place(transforms, origin, scale)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.space import to_kernel
from raytracer.layered.cube import LayeredCube
from raytracer.layered.halves import Codes
from raytracer.meshes import Mesh


@dataclass(frozen=True)
class Meshes:
    """The meshes of one cube: `LayeredCube.of` takes them in place of a Scene."""

    meshes: tuple[Mesh, ...]


@dataclass(frozen=True, eq=False)
class PlacedCubes:
    """The cube of the static meshes, then the cubes of the meshes whose numbers are `moving`.

    `parts` are the meshes of each cube before they are moved; `numbers` are the numbers of its triangles in the scene.
    `poses` (3K, 4), for K cubes, transform points (x, y, z, 1) from the coordinates of the scene's kernel to those of
    each cube.
    """

    cubes: tuple[LayeredCube, ...]
    numbers: tuple[NDArray[np.int32], ...]
    frames: tuple[tuple[NDArray[np.float64], float], ...]
    moving: tuple[int, ...]
    parts: tuple[tuple[Mesh, ...], ...]
    poses: NDArray[np.float64]

    @classmethod
    def of(
        cls, meshes: Mapping[int, Mesh], moving: Sequence[int], make: Callable[[tuple[Mesh, ...]], LayeredCube]
    ) -> PlacedCubes:
        """Make the cubes of the meshes that have triangles, by their numbers in the scene, moving ones unmoved."""
        ends = np.cumsum([0, *map(len, meshes.values())])
        ranges = {
            number: np.arange(first, past, dtype=np.int32)
            for number, first, past in zip(meshes, ends[:-1], ends[1:], strict=True)
        }
        still = [number for number in meshes if number not in moving]
        groups = [still, *([number] for number in moving)] if still else [[number] for number in moving]
        parts = [tuple(meshes[number] for number in group) for group in groups]
        frames = [to_kernel(np.concatenate([mesh.corners for mesh in part]), "f32")[1:] for part in parts]
        return cls(
            tuple(map(make, parts)),
            tuple(np.concatenate([ranges[number] for number in group]) for group in groups),
            tuple(frames),
            tuple(moving),
            tuple(parts),
            np.zeros((3 * len(groups), 4)),
        )

    def place(self, transforms: Mapping[int, NDArray[np.float64]], origin: NDArray[np.float64], scale: float) -> None:
        """Update the poses from each moving object's matrix (4, 4), by its number.

        `origin` and `scale` define the coordinates of the scene's kernel.
        """
        matrices = [np.eye(4)] * (len(self.cubes) - len(self.moving)) + [transforms[number] for number in self.moving]
        for k, (matrix, (start, factor)) in enumerate(zip(matrices, self.frames, strict=True)):
            inverse = np.linalg.inv(matrix)[:3]
            turn = inverse[:, :3] * (factor / scale)
            self.poses[3 * k : 3 * k + 3, :3] = turn
            self.poses[3 * k : 3 * k + 3, 3] = (inverse[:, :3] @ origin + inverse[:, 3] - start) * factor

    @property
    def objects(self) -> list[Mesh]:
        """The meshes that move."""
        return [mesh for (mesh,) in self.parts[len(self.parts) - len(self.moving) :]]

    @property
    def options(self) -> dict[str, Any]:
        """The options that decide the cubes, besides their triangles."""
        return self.cubes[0].options

    @cached_property
    def frame(self) -> NDArray[np.float32]:
        """The rasters, (8K, 4)."""
        return np.concatenate([cube.frame for cube in self.cubes])

    @property
    def samples(self) -> int:
        """The samples of all cubes."""
        return sum(cube.samples for cube in self.cubes)

    @property
    def offsets(self) -> NDArray[np.int32]:
        """The places at which the samples of each texel begin, and for each cube the end of its last ones."""
        starts = np.cumsum([0, *(cube.samples for cube in self.cubes)])
        parts = [cube.offsets + first for cube, first in zip(self.cubes, starts, strict=False)]
        return np.concatenate(parts).astype(np.int32)

    @property
    def blocks(self) -> NDArray[np.uint32]:
        """The blocks of the coarse levels."""
        return np.concatenate([cube.blocks for cube in self.cubes])

    @property
    def records(self) -> NDArray[np.uint32]:
        """The samples as a walk reads them, with the numbers of triangles in the scene."""
        parts = []
        for cube, numbers in zip(self.cubes, self.numbers, strict=True):
            records = cube.records
            records[:, -1] = numbers[cube.numbers_of].view(np.uint32)
            parts.append(records)
        return np.concatenate(parts)

    @property
    def numbers_of(self) -> NDArray[np.int32]:
        """The number in the scene of the triangle of each sample."""
        return np.concatenate([n[cube.numbers_of] for cube, n in zip(self.cubes, self.numbers, strict=True)])

    @property
    def codes(self) -> tuple[Codes, Codes | None]:
        """The half depths of samples, and for "plane" their slopes, as 16 bits each; see `layered.halves`."""
        depths, slopes = zip(*(cube.codes for cube in self.cubes), strict=True)
        return np.concatenate(depths), None if slopes[0] is None else np.concatenate(slopes)

    @property
    def weights(self) -> NDArray[np.float32]:
        """The weights of corners 1 and 2 of the samples' triangles, where samples are shaded."""
        return np.concatenate([cube.weights for cube in self.cubes])

    @property
    def outside(self) -> NDArray[np.int32]:
        """The numbers of the triangles that have no samples."""
        return np.concatenate([n[cube.outside] for cube, n in zip(self.cubes, self.numbers, strict=True)])
