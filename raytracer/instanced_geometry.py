"""The instances of a scene as an Intersector asks about them: they share their triangles and the accelerators of these.

Stage: query. A move of instances changes their places and the upper hierarchy alone.

    geometry = InstancedGeometry(scene, "opencl")
    geometry.move("leaf", transform)                     # True where every table is another one
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raytracer.accel.choice import INSTANCES
from raytracer.accel.two_levels import ROWS, TwoLevels
from raytracer.appearance.materials import Material
from raytracer.integrators.motion import Motion, moved_instances, moving
from raytracer.kernels.component import Surfaces
from raytracer.kernels.walk import QueryWalks
from raytracer.meshes import Mesh
from raytracer.moved import CAMERA
from raytracer.rays import Frame
from raytracer.scene.instanced import Parts
from raytracer.scene.layout import Layout, uv_rows
from raytracer.scene.scene import Scene


class InstancedGeometry:
    """The meshes of a Mesh or Scene with triangles, and the `layout` in two levels of them, for a backend."""

    layout: Layout

    def __init__(self, mesh_or_scene: Mesh | Scene, backend: str) -> None:
        meshes = mesh_or_scene.meshes if isinstance(mesh_or_scene, Scene) else (mesh_or_scene,)
        self.backend = backend
        self._motion = Motion([mesh.with_material(Material()) for mesh in meshes])  # no mesh shines or is clear
        self._lay_out()

    def _lay_out(self) -> None:
        self.layout = Layout.of(self._scene, INSTANCES, backend=self.backend)

    @property
    def _scene(self) -> Scene:
        return Scene(self._motion.meshes, camera=CAMERA)

    @property
    def meshes(self) -> tuple[Mesh, ...]:
        """The meshes where they are now."""
        return tuple(self._motion.meshes)

    @property
    def frame(self) -> Frame:
        """The kernel's coordinates."""
        return Frame(self.layout.origin, self.layout.scale, "f32")

    @property
    def structure(self) -> TwoLevels:
        """The accelerator."""
        assert isinstance(self.layout.structure, TwoLevels)
        return self.layout.structure

    @property
    def surfaces(self) -> Surfaces:
        """The attributes of the triangles, each part's in coordinates of its own."""
        layout, instanced = self.layout, self.layout.instanced
        assert instanced is not None
        normals = None if layout.normals is None else layout.normals.astype(np.float32)
        meshes = Parts.of(self._scene).meshes
        uvs = uv_rows(meshes).astype(np.float32) if any(mesh.uv is not None for mesh in meshes) else None
        return Surfaces(normals, uvs, layout.object_of, instanced.meshes[:, 0].copy())

    def walks(self, backend: str) -> QueryWalks:
        """Return the walks of queries on a backend."""
        rows = self.layout.triangles
        return QueryWalks(self.structure, rows[:, :3].reshape(-1, 3, 3), rows, "f32", backend)

    def corners_at(self, triangles: NDArray[np.integer]) -> NDArray[np.float64]:
        """Return the corners (n, 3, 3) of triangles by their numbers (n,) among those of all meshes."""
        instanced = self.layout.instanced
        assert instanced is not None
        sizes = np.array([len(mesh) for mesh in self._motion.meshes])
        ends = np.cumsum(sizes)
        mesh = np.searchsorted(ends, triangles, side="right")
        firsts, instances = instanced.places(sizes)
        own = self.layout.triangles.reshape(-1, 3, 4)[firsts[mesh] + triangles - (ends - sizes)[mesh], :, :3]
        rows = self.structure.rows.reshape(-1, ROWS, 4)[instances[mesh]].astype(np.float64)
        corners = np.einsum("nij,nkj->nki", rows[:, :3, :3], own) + rows[:, None, :3, 3]
        mirrored = rows[:, 8, 3] < 0
        corners[mirrored] = corners[mirrored, ::-1]
        return np.asarray(corners)

    def move(self, name: str | int, transform: ArrayLike) -> bool:
        """Place the meshes of a name, or the one of a number; return True where the layout is made anew.

        Raises SceneError for unknown names and other matrices, and for a mesh without triangles.
        """
        with moving(self, self._motion, name, transform):
            placed = moved_instances(self._motion, self.layout)
            if placed is None:
                self._lay_out()
            else:
                self.layout = placed
        return placed is None
