"""The deformation of glTF's meshes: morph targets, whose weights say how far vertices go, and skins on joints.

Stage: scene description. Section numbers are those of glTF 2.0. `scene.gltf_scene` deforms the meshes of each pose.

    skin = skin_of(document, 0)
    deformation.deformed([0.5], matrices[skin.joints] @ skin.inverse)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.errors import SceneError
from raytracer.meshes.gltf import Document
from raytracer.meshes.mesh import Mesh

Rows = NDArray[Any]
_SEVERAL = 4
"""Joints of a vertex in one pair of attributes."""


class Skin(NamedTuple):
    """The nodes that are the joints of a skin, and the matrices (J, 4, 4) from the mesh's coordinates to theirs."""

    joints: list[int]
    inverse: NDArray[np.float64]


class Deformation(NamedTuple):
    """The deformation of the V vertices of a `mesh`, whose `normals` (V, 3) are None where it is flat.

    Each of the `targets` adds to positions and normals, (V, 3) each or None. `joints` (V, n) are places among those of
    a skin and `weights` (V, n) their shares, None for a mesh that no skin moves.
    """

    mesh: Mesh
    normals: Rows | None
    targets: list[tuple[Rows | None, Rows | None]]
    joints: Rows | None
    weights: NDArray[np.float64] | None

    def deformed(self, amounts: Sequence[float], matrices: NDArray[np.float64] | None) -> Mesh:
        """Return the mesh with its targets added in these amounts, moved by the matrices (J, 4, 4) of joints if any."""
        places, normals = self.mesh.vertices.copy(), None if self.normals is None else self.normals.astype(np.float64)
        for amount, (place, normal) in zip(amounts, self.targets, strict=False):
            if amount and place is not None:
                places += amount * place
            if amount and normal is not None and normals is not None:
                normals += amount * normal
        if matrices is not None and self.joints is not None and self.weights is not None:
            if self.joints.max(initial=0) >= len(matrices):
                raise SceneError(f"a vertex names joint {self.joints.max()}, and its skin has {len(matrices)}")
            # The mean of the matrices (section 3.7.3.3): joint by joint, as most memory would go to a product of all.
            means = np.zeros((len(places), 4, 4))
            for column, weight in zip(self.joints.T, self.weights.T, strict=True):
                means += weight[:, None, None] * matrices[column]
            turn = means[:, :3, :3]
            places = np.einsum("vij,vj->vi", turn, places) + means[:, :3, 3]
            if normals is not None:
                x, y, z = turn.transpose(2, 0, 1)
                cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=2)
                normals = np.einsum("vij,vj->vi", cofactors, normals)
        return self.mesh.with_vertices(places, normals)


def deformation_of(
    document: Document, primitive: dict[str, Any], mesh: Mesh, normals: Rows | None, kept: Any
) -> Deformation | None:
    """Return the deformation of a primitive's mesh, or None; `kept` is the index of its vertices' rows."""

    def read(attributes: dict[str, Any], name: str) -> Rows | None:
        if name not in attributes:
            return None
        rows = document.array(attributes[name])
        if rows.shape[1] != 3:
            raise SceneError(f"a morph target adds rows {rows.shape} to the {name} of vertices")
        return np.asarray(rows[kept])

    targets = [(read(target, "POSITION"), read(target, "NORMAL")) for target in primitive.get("targets", [])]
    sets: list[tuple[Rows, Rows]] = []
    attributes = primitive["attributes"]
    while f"JOINTS_{len(sets)}" in attributes:
        joints, weights = (document.array(attributes[f"{name}_{len(sets)}"]) for name in ("JOINTS", "WEIGHTS"))
        if joints.shape != weights.shape or joints.shape[1] != _SEVERAL or joints.dtype.kind != "u":
            raise SceneError(f"a skin's vertices have joints {joints.shape} and weights {weights.shape}")
        sets.append((joints[kept], weights[kept]))
    if not targets and not sets:
        return None
    if not sets:
        return Deformation(mesh, normals, targets, None, None)
    shares = np.concatenate([weights for _, weights in sets], axis=1).astype(np.float64)
    whole = shares.sum(axis=1)
    shares[whole == 0, 0] = 1  # the format requires a joint for each vertex
    shares /= shares.sum(axis=1, keepdims=True)
    return Deformation(mesh, normals, targets, np.concatenate([joints for joints, _ in sets], axis=1), shares)


def skin_of(document: Document, number: Any) -> Skin:
    """Return a skin of a document by its number (section 5.28)."""
    entry = document.one("skins", number)
    joints = [int(joint) for joint in entry["joints"]]
    if "inverseBindMatrices" not in entry:
        return Skin(joints, np.tile(np.eye(4), (len(joints), 1, 1)))
    rows = document.array(entry["inverseBindMatrices"])
    if rows.shape[1] != 16 or len(rows) < len(joints):
        raise SceneError(f"a skin of {len(joints)} joints has inverse bind matrices {rows.shape}")
    inverse = rows[: len(joints)].astype(np.float64).reshape(-1, 4, 4)
    return Skin(joints, inverse.transpose(0, 2, 1))
