"""A mesh in another place, and everything that a scene can be made of as meshes.

Stage: scene description. `Scene` calls `placed` on what it is given.

>>> import numpy as np
>>> triangle = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], name="sail")
>>> [mesh.name for mesh in placed([triangle, Instance(triangle, np.diag([1, 2, 1, 1]))])]
['sail', 'sail']
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from raytracer.errors import SceneError
from raytracer.memory import check_triangles
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
        """The mesh in its place."""
        moved = self.mesh.transformed(self.transform)
        return moved if self.name in (None, moved.name) else replace(moved, name=self.name)


def placed(things: Any) -> tuple[Mesh, ...]:
    """Return the meshes of a Mesh, Instance, trimesh.Trimesh or trimesh.Scene, or of several of them, in order.

    Raises SceneError for anything else, and where the triangles exceed the memory.
    """
    single = isinstance(things, Mesh | Instance) or _of_trimesh(things)
    if not single and (isinstance(things, str | bytes) or not isinstance(things, Iterable)):
        raise _stranger(things)
    parts = [part for thing in ([things] if single else things) for part in _parts(thing)]
    check_triangles(sum(len(part.mesh if isinstance(part, Instance) else part) for part in parts))
    return tuple(part.placed if isinstance(part, Instance) else part for part in parts)


def _parts(thing: Any) -> Iterator[Mesh | Instance]:
    if isinstance(thing, Mesh | Instance):
        yield thing
    elif _of_trimesh(thing):
        from raytracer.meshes.folder import Notices  # here: only those who have trimesh need them
        from raytracer.meshes.from_trimesh import parts_of

        notices = Notices(f"trimesh.{type(thing).__name__}")
        yield from parts_of(thing, notices)
        notices.warn()
    else:
        raise _stranger(thing)


def _of_trimesh(thing: Any) -> bool:
    """Whether something is a mesh or scene of trimesh, which is not imported for the question."""
    trimesh = sys.modules.get("trimesh")
    return trimesh is not None and isinstance(thing, trimesh.Trimesh | trimesh.Scene)


def _stranger(thing: Any) -> SceneError:
    cure = "; Scene.load reads a file" if isinstance(thing, str) or hasattr(thing, "__fspath__") else ""
    made = "a Mesh, Instance, trimesh.Trimesh or trimesh.Scene, or several of them"
    return SceneError(f"a scene is made of {made}, not of {type(thing).__name__} {str(thing)[:60]!r}{cure}")
