"""Primary visibility from a rasteriser: the surface that the eye sees in each pixel, instead of eye rays.

Stage: render. Takes a `GBuffer` in the scene's units, gives the inputs of `kernels.picture.seen_rays`.

    seen = GBuffer(position, normal, object, uv)       # arrays (H, W, 3), (H, W, 3), (H, W), (H, W, 2)
    render(scene, primary=seen)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.arrays import numbers, one_float
from raytracer.errors import SceneError
from raytracer.integrators.integrator import Integrator, Whitted
from raytracer.scene.layout import Layout
from raytracer.scene.scene import Scene

SIZE = 512, 512
"""The size of a picture for which none is named."""
SLACK = 2.0**-13
"""The distance of a rasteriser's positions from their surfaces, at most, as a part of that from the eye."""
_UNSEEN = {"triangle", "color"}
"""The fields of a hit that programs may not read: a G-buffer does not have them."""


@dataclass(frozen=True, eq=False)
class GBuffer:
    """The surfaces that a camera sees in H x W pixels, row 0 at the top, each at the pixel's centre.

    `position` (H, W, 3) are points of the scene, in its units. `normal` (H, W, 3) are normals there, interpolated or
    not, of any length but 0 and on either side. `object` (H, W), ints, is the number of the mesh among the scene's, as
    `Image.object_id`, and -1 in a pixel without a surface, where the other arrays may hold anything. `uv` (H, W, 2) are
    texture coordinates, v upward; None where no material needs them. `slack` is how far positions may be off their
    surfaces, as a part of their distance from the eye: rays that go on from there start so far in front of them.

    Raises SceneError for other shapes and types.
    """

    position: Any
    normal: Any
    object: Any
    uv: Any = None
    slack: float = SLACK

    def __post_init__(self) -> None:
        number = np.asarray(self.object)
        if number.ndim != 2 or number.dtype.kind not in "iu":
            raise SceneError(
                f"the object of a GBuffer is (height, width) whole numbers, not {number.shape} of {number.dtype}: "
                + ("object.astype(int)" if number.ndim == 2 else "object.reshape(height, width)")
            )
        odd = number[(number < -1) | (number > np.iinfo(np.int32).max)]
        if odd.size:
            raise SceneError(
                f"the object of a GBuffer has {odd[0]}: it holds the numbers of meshes, from 0 on, and -1 in a pixel "
                "without a surface"
            )
        object.__setattr__(self, "object", number.astype(np.int32, casting="unsafe"))
        for name, size in (("position", 3), ("normal", 3), ("uv", 2)):
            if name == "uv" and self.uv is None:
                continue
            array = numbers(f"the {name} of a GBuffer", getattr(self, name))
            if array.shape != (*number.shape, size):
                raise SceneError(
                    f"the {name} of a GBuffer is {(*number.shape, size)}, as its object is {number.shape}, "
                    f"not {array.shape}"
                )
            object.__setattr__(self, name, array)
        slack = one_float(self.slack)
        if slack is None or not 0 <= slack < 1:
            raise SceneError(f"the slack of a GBuffer is a share of the distance from 0 to 1, not {self.slack!r}")

    @property
    def size(self) -> tuple[int, int]:
        """The size of its pictures, (width, height)."""
        height, width = self.object.shape
        return width, height


def size_of(
    size: tuple[int, int] | None,
    primary: Any,
    scene: Any,
    integrator: Integrator,
    samples: int | None = None,
    *,
    chooses: bool = False,
) -> tuple[int, int]:
    """Return the size of a picture; None means the size of the G-buffer, or 512 x 512 without a G-buffer.

    Raises SceneError where a G-buffer cannot take the place of eye rays. `samples` None are the integrator's;
    `chooses`: a cluster renders the picture, or `max_error` chooses how.
    """
    if primary is None:
        return SIZE if size is None else size
    if chooses:
        raise SceneError("a GBuffer is rendered by this process as it is: leave cluster and max_error out")
    if not isinstance(primary, GBuffer):
        raise SceneError(f"primary is a GBuffer(position, normal, object, uv), not {type(primary).__name__}")
    size = primary.size if size is None else size
    _check_fits(primary, scene, integrator, size, integrator.samples if samples is None else samples)
    return size


def _check_fits(primary: GBuffer, scene: Any, integrator: Integrator, size: tuple[int, int], samples: int) -> None:
    if not isinstance(integrator, Whitted):
        name = type(integrator).__name__
        raise SceneError(f"a GBuffer takes the place of the eye rays of Whitted(), not of {name}(): leave primary out")
    if samples != 1:
        raise SceneError(f"a GBuffer has one surface a pixel: samples=1, not {samples}; average pictures of several")
    if isinstance(scene, Scene) and not scene.triangles and (primary.object >= 0).any():
        raise SceneError(
            "the GBuffer shows objects, and the scene has no triangles: give it the meshes that were drawn"
        )
    if tuple(size) != primary.size:
        width, height = primary.size
        raise SceneError(
            f"primary is a GBuffer of {width} x {height} pixels, and the picture is {size[0]} x {size[1]}: "
            f"size=({width}, {height}), or rasterise at the picture's size"
        )


def seen_inputs(primary: GBuffer, scene: Scene, layout: Layout, tracer: Any) -> list[NDArray[Any]]:
    """Return position, normal, object and uv in the coordinates of the kernel; SceneError for bad numbers."""
    seen = primary.object >= 0
    _check_objects(primary.object[seen], scene, tracer)
    arrays = []
    for name in ("position", "normal", "uv"):
        array = getattr(primary, name)
        if array is None:
            if layout.uvs is not None and seen.any():
                raise SceneError("materials of the scene need uv coordinates: GBuffer(position, normal, object, uv)")
            array = np.zeros((*seen.shape, 2))
        wrong = seen & ~np.isfinite(array).all(axis=-1)
        if name == "normal":
            wrong |= seen & ~array.any(axis=-1)
        if wrong.any():
            row, column = np.argwhere(wrong)[0].tolist()
            raise SceneError(
                f"the {name} of the GBuffer in row {row}, column {column} is {array[row, column].tolist()}: "
                f"a surface's is finite{' and not 0' * (name == 'normal')}, and a pixel without one has object -1"
            )
        arrays.append(np.where(seen[..., None], array, 0.0))
    position, normal, uv = arrays
    place = np.where(seen[..., None], (position - layout.origin) * layout.scale, 0.0)
    size = np.abs(normal).max(axis=-1, keepdims=True)
    return [part.astype(layout.dtype) for part in (place, normal / np.where(size > 0, size, 1))] + [
        primary.object,
        uv.astype(layout.dtype),
    ]


def _check_objects(objects: NDArray[np.int32], scene: Scene, tracer: Any) -> None:
    """Raise SceneError for numbers of no mesh, and for meshes whose surface a G-buffer does not describe."""
    if not len(objects):
        return
    if objects.max() >= len(scene.meshes):
        raise SceneError(
            f"the GBuffer has object {objects.max()}, and the scene's meshes are 0 to {len(scene.meshes) - 1}; "
            "a pixel without a surface has -1"
        )
    if tracer.surfaces.clear:
        raise SceneError("a GBuffer shows opaque surfaces, and this scene has glass: leave primary out")
    unseen = sorted(_UNSEEN & tracer.surfaces.appearance.reads)
    for number in np.unique(objects).tolist():
        mesh = scene.meshes[number]
        name = f"mesh {number} ({mesh.name})" if mesh.name else f"mesh {number}"
        if not len(mesh):
            raise SceneError(f"the GBuffer shows {name}, which has no triangles")
        if mesh.colors is not None:
            raise SceneError(f"a GBuffer has no vertex colours, and {name} has some: give it a Texture")
        if "normal_map" in mesh.material.textures:
            raise SceneError(f"the normals of a GBuffer are final, and {name} has a normal_map: rasterise it")
        if "anisotropy" in tracer.surfaces.appearance.gives or getattr(mesh.material, "brush", (0,))[0] > 0:
            raise SceneError(f"a GBuffer has no tangents, and {name} has an anisotropy: leave primary out")
        if unseen and mesh.material.surface is not None:
            raise SceneError(f"a GBuffer has no {unseen[0]}, and the surface program of {name} may read it")


def first_tables(scene: Scene, layout: Layout) -> list[Any]:
    """Return the table of the first triangle of each mesh, and that of its instance if the layout has instances."""
    sizes = np.array([len(mesh) for mesh in scene.meshes])
    if layout.instanced is None:
        first = np.where(sizes > 0, np.cumsum(sizes) - sizes, 0)
        return [sh.Table(first.astype(np.int32), sh.Attrib1i, "first_of")]
    first, instance = layout.instanced.places(sizes)
    return [sh.Table(first, sh.Attrib1i, "first_of"), sh.Table(instance, sh.Attrib1i, "instance_of")]
