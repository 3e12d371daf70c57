"""Instances: a mesh with a transform and a name of its own.

Stage: scene description. A `Scene` takes instances beside meshes.

>>> import numpy as np
>>> triangle = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], name="sail")
>>> Instance(triangle, np.diag([1, 2, 1, 1])).placed.vertices[2].tolist()
[0.0, 2.0, 0.0]
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from raytracer.errors import SceneError
from raytracer.meshes.mesh import Mesh, affine


@dataclass(frozen=True, eq=False)
class Instance:
    """A mesh that stands in a scene where `transform` moves it.

    `transform` (4, 4) multiplies columns (x, y, z, 1); it may scale, shear and mirror. `name` is the mesh's own if none
    is given. A `Scene` keeps a moved copy of the mesh's triangles for each of its instances, which take as much memory
    as so many meshes. Raises SceneError for what is no mesh or no such matrix.
    """

    mesh: Mesh
    transform: Any
    name: str | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.mesh, Mesh):
            raise SceneError(f"an Instance is one of a Mesh, not of a {type(self.mesh).__name__}")
        object.__setattr__(self, "transform", affine(self.transform))

    @property
    def placed(self) -> Mesh:
        """The transformed mesh, with the name of the instance if it has one."""
        moved = self.mesh.transformed(self.transform)
        return moved if self.name in (None, moved.name) else replace(moved, name=self.name)
