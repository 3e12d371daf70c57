"""The tables of cubes whose depths are binary16: about half the bytes of those with binary32.

Stage: accelerate. Source: Bürger et al., GPU Rendering of Secondary Effects (VMV 2007), section 3: "we store 16 Bit
floating point depth values". A depth is the distance from the middle of the cube's box, in halves of its side along the
image's axis, so it is at most 2**-13 of that side away from the exact one. A slope has 8 bits, for it is at most 1 in
texels. The places where the samples of texels begin have 16 bits, counted from the first texel of their group.

Devices hold no arrays of 16 bits, so two numbers share a word, the first one in its lower half. Kernels decode them by
operations on integers, which every device does exactly (`kernels.layered_samples`).

>>> pairs(np.array([1, 2, 3], np.uint16)).tolist()
[131073, 3]
>>> grouped(np.array([3, 5, 5, 9], np.int32)).starts[:2].tolist()
[131072, 393218]
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.layered import raster

SMALLEST = 2.0**-14
"""The least number that is stored: binary16's least normal one. Devices may round smaller ones to 0."""
ERROR = 2.0**-11
"""The largest error of a number of binary16, as a part of it."""
STEEPEST = 127
"""The code of a slope of 1 texel of depth for a texel; that of 0 is as large, so that codes are not negative."""
_GROUP = 6
"""The exponent of 2 of the texels in a group."""
_BITS = 16

Words = NDArray[np.uint32]
Codes = NDArray[np.uint16]


class NumberGroups(NamedTuple):
    """Ascending numbers: the first of each group of `2**shift`, and the differences of the others from it, in pairs."""

    bases: NDArray[np.int32]
    starts: Words
    shift: int


@dataclass(frozen=True, eq=False)
class HalfTables:
    """The samples as walks read them: `depths` and `slopes` in pairs, `triangles` (n,), and where texels' begin.

    `slopes` are those of hit="plane" alone, two of 8 bits for each sample.
    """

    depths: Words
    slopes: Words | None
    triangles: NDArray[np.int32]
    offsets: NumberGroups

    @classmethod
    def of(cls, cube: Any) -> HalfTables:
        """Return the tables of a LayeredCube or PlacedCubes with half depths."""
        depths, slopes = cube.codes
        return cls(pairs(depths), None if slopes is None else pairs(slopes), cube.numbers_of, grouped(cube.offsets))

    @property
    def nbytes(self) -> int:
        """The bytes of the tables."""
        slopes = 0 if self.slopes is None else self.slopes.nbytes
        return self.depths.nbytes + slopes + self.triangles.nbytes + sum(part.nbytes for part in self.offsets[:2])


def middle_and_unit(frame: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the middle and half the sides of the box of a raster, (3,) each, with the roundings of a kernel."""
    low, high = frame[raster.LOW, :3], frame[raster.HIGH, :3]
    half = np.float32(0.5)
    return (low + high) * half, (high - low) * half


def depth_codes(frame: NDArray[np.float32], offsets: NDArray[np.int32], depths: NDArray[np.float32]) -> Codes:
    """Return the bits of the depths of samples as binary16; `offsets` are those of texels."""
    image = images_of(offsets)
    middle, unit = middle_and_unit(frame)
    place = (depths - middle[image]) / unit[image]
    clamped = np.copysign(np.maximum(np.abs(place), np.float32(SMALLEST)), place)
    return np.asarray(clamped.astype(np.float16).view(np.uint16))


def decoded(frame: NDArray[np.float32], offsets: NDArray[np.int32], codes: Codes) -> NDArray[np.float32]:
    """Return the depths that kernels read from `depth_codes`."""
    image = images_of(offsets)
    middle, unit = middle_and_unit(frame)
    return np.asarray(codes.view(np.float16).astype(np.float32) * unit[image] + middle[image])


def slope_codes(frame: NDArray[np.float32], offsets: NDArray[np.int32], slopes: NDArray[np.float32]) -> Codes:
    """Return the two slopes (n, 2) of each sample, in texels of depth for a texel, as 8 bits each."""
    size = frame[raster.SIZE, :3]
    sides = np.stack([np.roll(size, -1), np.roll(size, -2)], axis=1)[images_of(offsets)]
    ahead, above = (np.rint(np.clip(slopes / sides, -1, 1) * STEEPEST) + STEEPEST).astype(np.uint16).T
    return np.asarray(ahead | above << 8)


def images_of(offsets: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the image of each sample."""
    ends = offsets[:: (len(offsets) - 1) // 3]
    return np.repeat(np.arange(3), np.diff(ends))


def pairs(codes: Codes) -> Words:
    """Return words of two codes each; there is one word at least."""
    even = np.pad(codes, (0, len(codes) % 2 or (0 if len(codes) else 2))).astype(np.uint32)
    return np.asarray(even[::2] | even[1::2] << _BITS)


def grouped(numbers: NDArray[np.int32]) -> NumberGroups:
    """Return ascending numbers in the largest groups, of up to 64, whose differences have 16 bits."""
    for shift in range(_GROUP, -1, -1):
        groups = np.pad(numbers, (0, -len(numbers) % (1 << shift)), mode="edge").reshape(-1, 1 << shift)
        within = groups - groups[:, :1]
        if within.max() < 1 << _BITS:
            break
    return NumberGroups(groups[:, 0].copy(), pairs(within.reshape(-1).astype(np.uint16)), shift)
