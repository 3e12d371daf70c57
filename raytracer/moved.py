"""The objects of a scene that an Intersector moves one by one: their accelerators, and the tables that walks read.

Stage: query. As in a `Renderer`, an object that has moved once has a hierarchy or a cube of its own, and a move changes
only the parts of tables that it has.

    moved = MovedObjects(scene, "bvh", "f32", "opencl")
    moved.move("wheel", transform)                       # True: `walk` is another one
    moved.move("wheel", transform)                       # False: the tables of `walk` have changed
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raytracer.accel.choice import MOVABLE
from raytracer.accel.space import WORKING
from raytracer.appearance.materials import Material
from raytracer.errors import SceneError
from raytracer.integrators.integrator import Whitted
from raytracer.integrators.motion import Motion, moved_rows, moving, object_cubes
from raytracer.kernels.component import Surfaces
from raytracer.kernels.layered_walk import LayeredIntersector
from raytracer.kernels.triangle import Walk
from raytracer.kernels.walk import QueryWalks, SplitWalk, Structure, renew_walk, walk_with
from raytracer.layered.cube import LayeredCube, is_layered
from raytracer.meshes import Mesh
from raytracer.rays import Frame
from raytracer.scene.camera import Camera
from raytracer.scene.layout import Layout
from raytracer.scene.scene import Scene

CAMERA = Camera((0, 0, 1), (0, 0, 0))
"""A camera that nobody looks through, so that none is framed."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """The triangles of `meshes` in the coordinates of `frame`, and the accelerator over them, None without triangles.

    `corners` (N, 3, 3) and `rows` (see `triangle_rows`) are those of the triangles; `moved` is the walk through objects
    that have moved.
    """

    frame: Frame
    meshes: tuple[Mesh, ...]
    corners: NDArray[Any]
    rows: NDArray[Any]
    structure: Structure | None
    moved: Walk | None = None

    @property
    def surfaces(self) -> Surfaces:
        """The attributes of the triangles."""
        return Surfaces.of(self.meshes, WORKING[self.frame.precision])

    def corners_at(self, triangles: NDArray[Any]) -> NDArray[Any]:
        """Return the corners (n, 3, 3) of triangles by their numbers (n,)."""
        return np.asarray(self.corners[triangles])

    def walks(self, backend: str) -> QueryWalks:
        """Return the walks of queries on a backend."""
        assert self.structure is not None
        return QueryWalks(self.structure, self.corners, self.rows, self.frame.precision, backend, self.moved)


class MovedObjects:
    """The meshes of a Mesh or Scene as they have been moved, their `layout`, and the `walk` through them.

    `changed` are the meshes that the last move has placed elsewhere without another walk, by their first triangles.

    `accel`, `precision` and `backend` are those of an Intersector. Raises SceneError for accelerators in which nothing
    moves.
    """

    layout: Layout
    walk: Walk

    def __init__(
        self, mesh_or_scene: Mesh | Scene, accel: str | LayeredCube, precision: str, backend: str | None
    ) -> None:
        layered = isinstance(accel, LayeredCube) or is_layered(accel)
        if not layered and accel not in MOVABLE:
            raise SceneError(
                f'objects move in a hierarchy, beside a grid or in cubes, and this Intersector has accel="{accel}": '
                'choose accel="bvh"'
            )
        self.precision, self.backend = precision, backend or "numpy"
        self.structure = "bvh" if layered else str(accel)
        options: dict[str, Any] = {"secondary": accel} if isinstance(accel, LayeredCube) else {"accel": accel}
        self._cubes = Whitted(**options) if layered else None
        meshes = mesh_or_scene.meshes if isinstance(mesh_or_scene, Scene) else (mesh_or_scene,)
        self._motion = Motion([plain(mesh) for mesh in meshes])
        self._moving: tuple[int, ...] = ()
        self.changed: dict[int, Mesh] = {}

    @property
    def meshes(self) -> tuple[Mesh, ...]:
        """The meshes where they are now."""
        return tuple(self._motion.meshes)

    @property
    def geometry(self) -> Geometry:
        """The triangles where they are now."""
        layout, cubes = self.layout, self.layout.secondary
        structure = layout.structure if self._cubes is None else cubes
        corners = layout.triangles[:, :3].reshape(-1, 3, 3)
        frame = Frame(layout.origin, layout.scale, self.precision)
        return Geometry(frame, self.meshes, corners, layout.triangles, structure, self.walk)

    def move(self, name: str | int, transform: ArrayLike) -> bool:
        """Place the meshes of a name, or the one of a number; return True where `walk` has become another one.

        Raises SceneError for unknown names and other matrices, and for a mesh without triangles.
        """
        with moving(self, self._motion, name, transform):
            renewed = not self._updated()
            if renewed:
                self._build()
        return renewed

    def _updated(self) -> bool:
        """Update the tables; return False where they have to be made anew."""
        if not self._moving:
            return False
        changes = moved_rows(self._motion, self._moving, self.layout, self.precision)
        if changes is None:
            return False
        meshes = (mesh for mesh, _ in self._motion.changes.values())
        self.changed = {change.first: mesh for change, mesh in zip(changes, meshes, strict=True)}
        renew_walk(self._split, self.layout, changes)
        return True

    def _build(self) -> None:
        """Make the accelerators and tables, each moving object its own."""
        motion, before = self._motion, self.layout.secondary if self._moving else None
        self._moving = tuple(sorted(motion.changed | set(self._moving)))
        scene = Scene(motion.meshes, camera=CAMERA)
        layout = Layout.of(scene, self.structure, self.precision, None, self._moving, self.backend)
        self._split: Walk | SplitWalk
        if self._cubes is None:
            self.walk = self._split = walk_with(layout.structure, layout.triangles, self.backend, forest=layout.forest)
        else:
            cubes = object_cubes(self._cubes, motion, self._moving, layout, self.backend, before)
            layout = dataclasses.replace(layout, secondary=cubes)
            exact = walk_with(layout.structure, layout.triangles, self.backend, forest=layout.forest)
            self.walk = LayeredIntersector(cubes, exact.triangles)
            self._split = SplitWalk(exact, self.walk)
        self.layout = layout


def plain(mesh: Mesh) -> Mesh:
    """Return a mesh without the attributes that only pictures need."""
    return dataclasses.replace(mesh, colors=None, material=Material())
