"""The nodes of a glTF document: the tree of the scene that is shown, with a matrix for each.

Stage: scene description. Section numbers are those of glTF 2.0. A bad node is left out with those below it.

    for node in nodes_of(document, guard):
        node.entry, node.matrix
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.arrays import is_whole
from raytracer.errors import SceneError
from raytracer.meshes.folder import Fault, shown
from raytracer.meshes.gltf import Document, numbers_of, rows

Matrix = NDArray[np.float64]
_IDENTITY: Final = tuple(np.eye(4).reshape(-1).tolist())
_PLACED: Final = {"matrix", "translation", "rotation", "scale"}
_SCENE: Final = Fault("scene cannot be shown", "scenes cannot be shown")
NODE: Final = Fault("node cannot be read", "nodes cannot be read")
Pose = Mapping[int, Mapping[str, Any]]
"""The entries of nodes that an animation replaces, by the numbers of the nodes."""
Guard = Callable[[Fault, str], AbstractContextManager[None]]
"""Leaves out an entry that cannot be read, by its fault and its place."""


class Node(NamedTuple):
    """A node of the scene, the matrix (4, 4) from its coordinates to the scene's, and its number, -1 without one."""

    entry: dict[str, Any]
    matrix: Matrix
    number: int = -1


def place_of(kind: str, number: Any) -> str:
    """Return the place of an entry of a list, as messages say it: "node 7"."""
    return f"{kind} {shown(str(number))}"


def nodes_of(document: Document, entry: Guard, pose: Pose = MappingProxyType({})) -> Iterator[Node]:
    """Yield the nodes of the default scene in a pose, parents first, in the file's order (section 3.5)."""
    entries = document.all("nodes")
    if not entries:
        for number in range(len(document.all("meshes"))):
            yield Node({"mesh": number}, np.eye(4))
    seen: set[int] = set()
    waiting = [(root, np.eye(4)) for root in reversed(_roots(document, entry))]
    while waiting:
        number, outer = waiting.pop()
        node: Node | None = None
        with entry(NODE, place_of("node", number)):
            if is_whole(number, 0) and number in seen:
                raise SceneError("it has more than one parent")
            properties = {**document.one("nodes", number), **pose.get(number, {})}
            seen.add(number)
            with np.errstate(all="ignore"):  # infinities are found below
                matrix = outer @ local_matrix(properties) if _PLACED & properties.keys() else outer
            if not np.isfinite(matrix).all():
                raise SceneError("its place is not finite")
            children = [(child, matrix) for child in reversed(rows(properties, "children"))]
            node = Node(properties, matrix, number)
        if node is not None:
            yield node
            waiting += children


def _roots(document: Document, entry: Guard) -> list[Any]:
    """Return the numbers of the nodes that no other node has: those of the default scene, where there are scenes."""
    if document.all("scenes"):
        for number in (document.tree.get("scene", 0), 0):  # the first one where the default one is bad
            with entry(_SCENE, place_of("scene", number)):
                return rows(document.one("scenes", number), "nodes")
    entries = document.all("nodes")
    lists = [node.get("children") for node in entries]
    children = {child for numbers in lists if isinstance(numbers, list) for child in numbers if is_whole(child, 0)}
    return [k for k in range(len(entries)) if k not in children]


def local_matrix(entry: Mapping[str, Any]) -> Matrix:
    """Return the matrix of a node: its own, or translation, rotation and scale (section 3.5.3)."""
    if "matrix" in entry:
        matrix = np.array(numbers_of(entry, "matrix", _IDENTITY)).reshape(4, 4).T.copy()
        if not np.allclose(matrix[3], (0, 0, 0, 1)):
            raise SceneError(f"the last row of its matrix is {' '.join(f'{x:g}' for x in matrix[3])}, not 0 0 0 1")
        matrix[3] = 0, 0, 0, 1  # but for rounding in the text
        return matrix
    x, y, z, w = numbers_of(entry, "rotation", (0, 0, 0, 1))
    length = math.sqrt(x * x + y * y + z * z + w * w) or 1.0
    x, y, z, w = x / length, y / length, z / length, w / length
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= numbers_of(entry, "scale", (1, 1, 1))
    matrix[:3, 3] = numbers_of(entry, "translation", (0, 0, 0))
    return matrix
