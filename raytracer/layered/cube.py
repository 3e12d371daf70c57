"""LayeredCube: a mesh or scene as three layered depth images, each with a coarse level of depth ranges.

Stage: accelerate. Source: Bürger et al., GPU Rendering of Secondary Effects (VMV 2007). A texel keeps all
its samples in one list, so memory grows with the samples and not with the number of layers.

    cube = LayeredCube.of(mesh, resolution=512, hit="triangle", backend="opencl")
    cube.layers, cube.samples, cube.nbytes, cube.build_seconds
    Intersector(mesh, accel=cube)                       # rays from the host
    render(scene, accel="ldc", secondary=cube)          # shadow, mirrored and refracted rays of a picture
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.grid import far_larger
from raytracer.accel.space import to_kernel, triangle_rows
from raytracer.arrays import is_whole
from raytracer.backends import chosen_backend
from raytracer.errors import SceneError
from raytracer.layered import raster
from raytracer.layered.building import BUILDERS, Samples, build_samples
from raytracer.layered.halves import ERROR, STEEPEST, Codes, HalfTables, slope_codes
from raytracer.meshes import Mesh

HITS = ("sample", "plane", "triangle")
SHADINGS = ("exact", "deferred")
DEPTHS = ("single", "half")
MAX_RESOLUTION = 8192
"""Texels along a side, so that an index counts the texels of three images."""
_RESOLUTION, _BLOCK = 1024, 16
_SMALLER = 4.0
"""The least factor by which the box shrinks without the triangles that a cube leaves out."""
_THINNEST = 2.0**-8
"""The least side of the box as a part of the largest."""
_ROUNDING = 2.0**-18
"""The depth that roundings may add, as a part of the box: more than 16 of f32."""


@runtime_checkable
class HasMeshes(Protocol):
    """The part of a Scene that a cube reads: its meshes. A protocol, since this package may not import `scene`."""

    @property
    def meshes(self) -> Any:
        """The meshes, a tuple of Mesh."""


@dataclass(frozen=True, eq=False)
class LayeredCube:
    """Three layered depth images of triangles, made by `LayeredCube.of`: an approximate accelerator for rays.

    Each image has `resolution` x `resolution` texels over the box of the mesh, and a range of depths for each block of
    `block` x `block` texels. `hit` decides when a ray hits a sample:

    - "sample": the ray's depth within the texel comes as near to the sample's as `tolerance`, a length in the
      scene's units;
    - "plane": the ray meets the plane of the sample's triangle within the texel;
    - "triangle": the ray meets the sample's triangle, by the exact test of the other accelerators. Every hit is
      a true one; only triangles without a sample on the way are missed.

    With `conservative` a triangle has a sample in each texel that it touches. Then "triangle" misses nothing of a
    closed mesh, and the other tests find surfaces that reach beyond their edges by up to a texel. Without it a triangle
    has a sample where it covers the texel's centre.

    Triangles without area have no samples; the exact test of other accelerators may hit one of them by rounding.

    With `shading="deferred"` a hit in a picture takes the colour and the normal of its sample, as in the paper. They
    are interpolated and textured once per sample, and take 8 bytes each.

    With `depths="half"` depths are binary16, as in the paper, and slopes have 8 bits (see `layered.halves`), which
    takes about half the memory; with "single" both are binary32.

    `images` are the samples (see `Samples`), `triangles` (3N, 4) the triangles they belong to, `frame` (8, 4) the
    raster (see `layered.raster`); `build_seconds` is the time to build them, compilation included.

    The few triangles far larger than the rest, such as a wide floor, have no samples and do not count for the box, so
    that the texels are as small as the rest needs. `outside` (K,) are their numbers; every ray tests them exactly.
    """

    images: Samples
    triangles: NDArray[np.float64]
    outside: NDArray[np.int32]
    frame: NDArray[np.float32]
    hit: str
    conservative: bool
    tolerance: float | None
    shading: str
    depths: str
    build_seconds: float

    @classmethod
    def of(
        cls,
        mesh_or_scene: Mesh | HasMeshes,
        resolution: int = _RESOLUTION,
        block: int = _BLOCK,
        backend: str | None = None,
        hit: str = "plane",
        *,
        tolerance: float | None = None,
        conservative: bool | None = None,
        builder: str = "sort",
        shading: str = "exact",
        depths: str = "single",
    ) -> LayeredCube:
        """Return the cube of a mesh, or of all meshes of a scene, built on a backend.

        `resolution`, `block`, `hit`, `tolerance` and `conservative` are described with the class. `tolerance` None
        is half the sum of a texel's sides; `conservative` None is True for "triangle", False for the others.
        `builder` is how samples are put into order, with the same result: "sort", by collective operations, or "peel",
        by drawing layer after layer with OpenGL, for backend "glsl". `shading` is "exact", from the triangle that was
        hit, or "deferred", from the sample. `depths` is "single" or "half", which hit="triangle" does not take.

        Raises SceneError for objects that are neither mesh nor scene, for numbers out of range, for an unknown `hit`,
        `builder`, `shading` or `depths`, for half depths with hit="triangle", and for more samples than memory holds;
        sh.BackendUnavailable for a missing backend.
        """
        backend = chosen_backend(backend)
        _check(mesh_or_scene, resolution, block, hit, tolerance)
        resolution, block = int(resolution), int(block)  # numpy's ints become Python's; so does the tolerance
        tolerance = None if tolerance is None else float(tolerance)
        _check_builder(builder, backend)
        if shading not in SHADINGS:
            raise SceneError(f"shading is one of {', '.join(map(repr, SHADINGS))}, not {shading!r}")
        _check_depths(depths, hit)
        started = time.perf_counter()
        meshes: Any = (mesh_or_scene,) if isinstance(mesh_or_scene, Mesh) else mesh_or_scene.meshes
        corners, _, scale = to_kernel(np.concatenate([np.zeros((0, 3, 3)), *(mesh.corners for mesh in meshes)]), "f32")
        conservative = hit == "triangle" if conservative is None else bool(conservative)
        inside, outside = _apart(corners)
        some = corners[inside]
        width = None if tolerance is None else tolerance * scale
        half, shaded = depths == "half", shading == "deferred"
        frame = _frame(some, resolution, block, width, hit, half)
        images = build_samples(triangle_rows(some), frame, conservative, backend, builder, shaded, half)
        if len(outside):
            images = replace(images, triangles=inside[images.triangles])
        _limit(frame, images)
        seconds = time.perf_counter() - started
        rows, options = triangle_rows(corners), (hit, conservative, tolerance, shading, depths)
        return cls(images, rows, outside, frame, *options, seconds)

    @property
    def resolution(self) -> int:
        """Texels along a side of an image."""
        return int(self.frame[raster.COUNTS, 0])

    @property
    def block(self) -> int:
        """Texels along a side of a block of the coarse level."""
        return int(self.frame[raster.COUNTS, 1])

    @property
    def layers(self) -> tuple[int, int, int]:
        """The most samples of a texel, in the images along x, y and z."""
        counts = np.diff(self.images.offsets).reshape(3, -1).max(axis=1)
        return int(counts[0]), int(counts[1]), int(counts[2])

    @property
    def samples(self) -> int:
        """The samples of all images."""
        return len(self.images.depths)

    @property
    def nbytes(self) -> int:
        """The bytes of the tables through which rays walk, without the triangles, which every accelerator has."""
        shades = 8 * self.samples if self.shading == "deferred" else 0
        half = self.depths == "half"
        samples = HalfTables.of(self).nbytes if half else self.images.offsets.nbytes + self.records.nbytes
        return self.blocks.nbytes + samples + shades

    @property
    def records(self) -> NDArray[np.uint32]:
        """The samples as a walk reads them, (n, 2): bits of the depth, triangle; slopes between them for "plane"."""
        parts = [self.images.depths[:, None].view(np.uint32), self.images.triangles[:, None].view(np.uint32)]
        if self.hit == "plane":
            parts.insert(1, self.images.slopes.view(np.uint32))
        return np.concatenate(parts, axis=1)

    @property
    def numbers_of(self) -> NDArray[np.int32]:
        """The number of the triangle of each sample, (n,)."""
        return self.images.triangles

    @property
    def codes(self) -> tuple[Codes, Codes | None]:
        """The half depths of samples, and for "plane" their slopes, as 16 bits each; see `layered.halves`."""
        images = self.images
        assert images.halves is not None
        slopes = slope_codes(self.frame, images.offsets, images.slopes) if self.hit == "plane" else None
        return images.halves, slopes

    @property
    def weights(self) -> NDArray[np.float32]:
        """The weights of corners 1 and 2 of the samples' triangles (n, 2), where samples are shaded."""
        assert self.images.weights is not None
        return self.images.weights

    @property
    def blocks(self) -> NDArray[np.uint32]:
        """The blocks of the coarse level as a walk reads them, (3 B B, 4): depth range as bits, slices."""
        return np.concatenate([self.images.ranges.view(np.uint32), self.images.slices], axis=1)

    @property
    def offsets(self) -> NDArray[np.int32]:
        """The places at which the samples of each texel begin, and the end of the last ones."""
        return self.images.offsets

    @property
    def options(self) -> dict[str, Any]:
        """The options that decide a cube, besides its triangles."""
        return {
            "resolution": self.resolution, "block": self.block, "hit": self.hit,
            "tolerance": self.tolerance, "conservative": self.conservative, "shading": self.shading,
            "depths": self.depths,
        }  # fmt: skip

    def check_triangles(self, triangles: NDArray[Any]) -> None:
        """Raise SceneError if the cube was built from other triangles."""
        if not np.array_equal(self.triangles, triangles):
            raise SceneError(
                "the layered depth cube is that of another mesh or scene: make it with LayeredCube.of(...) of this one"
            )

    def __repr__(self) -> str:
        half = ", half depths" if self.depths == "half" else ""
        return (
            f"<LayeredCube {self.resolution}^2 of {len(self.triangles) // 3:,} triangles, hit={self.hit!r}{half}: "
            f"{self.samples:,} samples, layers {self.layers}, {self.nbytes / 2**20:.1f} MiB>"
        )


def is_layered(accel: str) -> bool:
    """Return whether the name of an accelerator is that of a cube; SceneError as `options_of`."""
    return options_of(accel) is not None


def cube_of(accel: str, mesh_or_scene: Mesh | HasMeshes, backend: str | None) -> LayeredCube:
    """Return the cube that an accelerator's name stands for."""
    options = options_of(accel)
    assert options is not None
    return LayeredCube.of(mesh_or_scene, backend=backend, **options)


def options_of(accel: str) -> dict[str, Any] | None:
    """Return the options of the cube that "ldc", "ldc:resolution", or this with ":hit" or ":hit:shading" stands for.

    A last ":half" is for depths in binary16. None for the name of another accelerator. Raises SceneError for a name
    that begins like these and goes on otherwise.
    """
    name, *words = str(accel).split(":")
    if name != "ldc":
        return None
    half = len(words) > 1 and words[-1] == "half"
    resolution, *choices = words[: len(words) - half] or [str(_RESOLUTION)]
    if len(choices) > 2 or not (resolution.isascii() and resolution.isdigit()):
        raise SceneError(
            f'a layered depth cube is "ldc", "ldc:1024", "ldc:1024:half" or "ldc:1024:triangle", not {accel!r}'
        )
    for word, allowed in zip(choices, (HITS, SHADINGS), strict=False):
        if word not in allowed:
            raise SceneError(
                f"{word!r} in {accel!r} is none of {', '.join(map(repr, allowed))}; "
                '"half" stands last, as in "ldc:1024:half"'
            )
    hit, shading = (*choices, *("plane", "exact")[len(choices) :])
    depths = "half" if half else "single"
    _check_depths(depths, hit, resolution)
    return {"resolution": int(resolution), "hit": hit, "shading": shading, "depths": depths}


def _check(mesh_or_scene: Any, resolution: Any, block: Any, hit: str, tolerance: Any) -> None:
    if not isinstance(mesh_or_scene, Mesh | HasMeshes):
        raise SceneError(f"a LayeredCube is that of a Mesh or a Scene, not of {type(mesh_or_scene).__name__}")
    for what, number in (("resolution", resolution), ("block", block)):
        if not is_whole(number, 1, MAX_RESOLUTION):
            raise SceneError(f"{what} is a whole number from 1 to {MAX_RESOLUTION}, not {number!r}")
    if hit not in HITS:
        raise SceneError(f"hit is one of {', '.join(map(repr, HITS))}, not {hit!r}")
    if tolerance is None:
        return
    if hit != "sample":
        raise SceneError(f'tolerance is for hit="sample": hit={hit!r} needs none')
    if isinstance(tolerance, bool) or not isinstance(tolerance, int | float | np.number) or not 0 <= tolerance < np.inf:
        raise SceneError(f"tolerance is a length of 0 or more, not {tolerance!r}")


def _check_depths(depths: Any, hit: str, resolution: str = "") -> None:
    if depths not in DEPTHS:
        raise SceneError(f"depths is one of {', '.join(map(repr, DEPTHS))}, not {depths!r}")
    if depths == "half" and hit == "triangle":
        size = resolution or str(_RESOLUTION)
        raise SceneError(
            f'half depths are rounded, and hit="triangle" is exact: write "ldc:{size}:triangle" for exact hits, '
            f'or "ldc:{size}:half" for less memory and the hits of hit="plane"'
        )


def _check_builder(builder: str, backend: str) -> None:
    if builder not in BUILDERS:
        raise SceneError(f"builder is one of {', '.join(map(repr, BUILDERS))}, not {builder!r}")
    if builder == "peel" and backend != "glsl":
        raise SceneError(f'builder="peel" draws with OpenGL: backend="glsl", not {backend!r}')


def _apart(corners: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the numbers of the triangles that have samples, and of those far larger than these."""
    large = far_larger(corners)
    sides = [float(np.ptp(some, axis=(0, 1)).max()) if len(some) else np.inf for some in (corners, corners[~large])]
    if _SMALLER * sides[1] > sides[0]:
        large[:] = False
    return np.flatnonzero(~large).astype(np.int32), np.flatnonzero(large).astype(np.int32)


def _frame(
    corners: NDArray[np.float64], resolution: int, block: int, tolerance: float | None, hit: str, half_depths: bool
) -> NDArray[np.float32]:
    """Return the raster over the box of `corners`, which are those of a kernel; see `layered.raster`."""
    frame = np.zeros((8, 4))
    low, high = (end(corners, axis=(0, 1), initial=0) for end in (np.min, np.max)) if len(corners) else np.zeros((2, 3))
    largest = float((high - low).max()) or 1.0
    sides = np.maximum(high - low, _THINNEST * largest)
    grown = 2.0**-20 * max(float(np.abs([low, high]).max()), largest)
    size = ((sides + 2 * grown) / resolution).astype(np.float32)
    frame[raster.LOW, :3] = ((low + high - sides) / 2 - grown).astype(np.float32)
    frame[raster.INVERSE, :3] = 1 / size
    frame[raster.SIZE, :3] = size
    frame[raster.HIGH, :3] = frame[raster.LOW, :3] + resolution * size.astype(np.float64)
    half = (np.roll(size, -1) + np.roll(size, -2)) / 2
    frame[raster.SLACK, :3] = half * (1 + 2 * raster.MARGIN) + _ROUNDING * max(
        float(np.abs([low, high]).max()), largest
    )
    if half_depths:
        sizes = (frame[raster.HIGH] - frame[raster.LOW])[:3] / 2 + 2 * half
        frame[raster.SLACK, :3] += half / STEEPEST + ERROR * sizes
    if hit == "sample":
        frame[raster.SLACK, :3] = half if tolerance is None else tolerance
    frame[raster.COUNTS] = resolution, block, -(-resolution // block), raster.SLICES / resolution
    return frame.astype(np.float32)


def _limit(frame: NDArray[np.float32], images: Samples) -> None:
    """Put the range of depths of each image into its frame."""
    ranges = images.ranges.reshape(3, -1, 2)
    frame[raster.NEAREST, :3] = ranges[..., 0].min(axis=1)
    frame[raster.FARTHEST, :3] = ranges[..., 1].max(axis=1)
