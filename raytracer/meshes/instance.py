"""Instances: a mesh with a transform and a name of its own.

Stage: scene description. A `Scene` takes instances beside meshes.

>>> import numpy as np
>>> triangle = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], name="sail")
>>> Instance(triangle, np.diag([1, 2, 1, 1])).placed.vertices[2].tolist()
[0.0, 2.0, 0.0]
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Final

from raytracer.errors import SceneError, warn
from raytracer.memory import TRIANGLE, check_triangles
from raytracer.meshes.mesh import Mesh, affine

MANY: Final = 1 << 20
"""Triangles of instances from which on a warning says that each instance gets its own."""


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


def placed_all(name: str, parts: Iterable[Mesh | Instance]) -> list[Mesh]:
    """Return meshes as they are, and instances in their places; `name` is that of the scene or file.

    An sh.ShpyWarning says beforehand what many instances take. Raises SceneError where the triangles exceed the memory.
    """
    parts = list(parts)
    instances = [part for part in parts if isinstance(part, Instance)]
    shared = {id(part.mesh): len(part.mesh) for part in instances}
    total, different = sum(len(part.mesh) for part in instances), sum(shared.values())
    check_triangles(total + sum(len(part) for part in parts if isinstance(part, Mesh)))
    if total >= MANY and total >= 2 * different:
        plural = "" if len(shared) == 1 else "es"
        warn(
            f"{name}: each of {len(instances):,} instances of {len(shared):,} mesh{plural} gets triangles of its own, "
            f"{total:,} where {different:,} are different: they take {total * TRIANGLE / 2**30:.1f} GiB of memory or "
            "more, and are prepared one by one"
        )
    return [part.placed if isinstance(part, Instance) else part for part in parts]
