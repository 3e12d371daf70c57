"""Everything that a scene can be made of, as meshes in their places.

Stage: scene description. `Scene` calls `placed` on its meshes.

>>> import numpy as np
>>> triangle = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], name="sail")
>>> [mesh.name for mesh in placed([triangle, Instance(triangle, np.diag([1, 2, 1, 1]))])]
['sail', 'sail']
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import Any

from raytracer.errors import SceneError
from raytracer.memory import check_triangles
from raytracer.meshes.folder import Notices
from raytracer.meshes.from_trimesh import parts_of
from raytracer.meshes.instance import Instance
from raytracer.meshes.mesh import Mesh


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
        notices = Notices(f"trimesh.{type(thing).__name__}")
        yield from parts_of(thing, notices)
        notices.warn()
    else:
        raise _stranger(thing)


def _of_trimesh(thing: Any) -> bool:
    """Return True for a mesh or scene of trimesh. Who has one has imported trimesh, so this imports nothing."""
    trimesh = sys.modules.get("trimesh")
    return trimesh is not None and isinstance(thing, trimesh.Trimesh | trimesh.Scene)


def _stranger(thing: Any) -> SceneError:
    cure = "; Scene.load reads a file" if isinstance(thing, str) or hasattr(thing, "__fspath__") else ""
    made = "a Mesh, Instance, trimesh.Trimesh or trimesh.Scene, or several of them"
    return SceneError(f"a scene is made of {made}, not of {type(thing).__name__} {str(thing)[:60]!r}{cure}")
