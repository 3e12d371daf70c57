"""The Utah teapot: 32 bicubic Bézier patches, with the control points that Martin Newell measured in 1975.

Stage: scene description. The patches are joined into four surfaces that are closed around: pot, lid, handle and spout.
Each is an array (rows, columns, 3) of control points, in which neighbouring patches share a row or a column, and is
sampled at once, so that there are no cracks between patches. The z axis of the data is up and becomes y.

Source: F. Crow, "The Origins of the Teapot", IEEE Computer Graphics and Applications 7 (1), 1987.

>>> len(teapot(divisions=4)), float(teapot(divisions=4).vertices[:, 1].max())
(992, 3.15)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from raytracer.appearance.materials import PLAIN
from raytracer.appearance.metallic_roughness import AnyMaterial
from raytracer.errors import SceneError
from raytracer.meshes.mesh import Mesh, joined
from raytracer.meshes.shapes import Count, Floats, lattice, shape, unwrapped

# Turned on a wheel: radius and height of each ring, from the pole on.
_POT = ((0, 0), (1.425, 0), (1.5, 0.075), (1.5, 0.15), (1.5, 0.225), (2, 0.45), (2, 0.9), (2, 1.35), (1.75, 1.875),
        (1.5, 2.4), (1.4375, 2.53125), (1.3375, 2.53125), (1.4, 2.4))  # fmt: skip
_LID = ((0, 3.15), (0.8, 3.15), (0, 2.85), (0.2, 2.7), (0.4, 2.55), (1.3, 2.55), (1.3, 2.4))
# Symmetric: x and z of the two points of each section that lie in the plane y = 0, and y of the two beside them.
_HANDLE = ((-1.5, 2.25, -1.6, 2.025, 0.3), (-2.5, 2.25, -2.3, 2.025, 0.3), (-3, 2.25, -2.7, 2.025, 0.3),
           (-3, 1.8, -2.7, 1.8, 0.3), (-3, 1.35, -2.7, 1.575, 0.3), (-2.65, 0.9375, -2.5, 1.125, 0.3),
           (-1.9, 0.6, -2, 0.9, 0.3))  # fmt: skip
_SPOUT = ((1.7, 0.6, 1.7, 1.425, 0.66), (3.1, 0.825, 2.6, 1.425, 0.66), (2.4, 2.025, 2.3, 2.1, 0.25),
          (3.3, 2.4, 2.7, 2.4, 0.25), (3.525, 2.49375, 2.8, 2.475, 0.25), (3.45, 2.5125, 2.9, 2.475, 0.15),
          (3.2, 2.4, 2.8, 2.4, 0.15))  # fmt: skip
_ARC = 0.56
"""The distance of a quarter ring's inner control points along the tangent, in radii."""
_KNOB_ARC = 0.5625
"""The same for the ring of radius 0.8 round the knob of the lid."""


@shape
def teapot(material: AnyMaterial = PLAIN, *, divisions: Count = 31) -> Mesh:
    """Make Newell's teapot on the plane y = 0, its spout along x: 64 * divisions**2 - 8 * divisions triangles.

    The pot is 4 wide and the knob of the lid 3.15 high. Each patch is cut into `divisions` by `divisions` cells; 31
    give 61,256 triangles. Normals are those of the patches. u runs around each of pot, lid, handle and spout, v along
    it: upwards on the pot, downwards on the lid. As in Newell's data nothing closes the gap round the lid, the mouth of
    the spout, and the ends of handle and spout inside the pot. Raises SceneError for fewer than 2 divisions.
    """
    if divisions < 2:
        raise SceneError(f"a patch of the teapot is cut into 2 by 2 cells or more, not {divisions}")
    around = [_ring(_POT, -1), _ring(_LID, 1), _section(_HANDLE), _section(_SPOUT)]
    return joined([_sampled(control, divisions, material) for control in around], "teapot")


def _ring(profile: Sequence[tuple[float, float]], turn: int) -> Floats:
    """Return control points (rows, 12, 3) of a surface of revolution about z; `turn` is 1 or -1, its direction."""
    quarter = np.array([(1, 0), (1, _ARC), (_ARC, 1)])
    knob = np.array([(1, 0), (1, _KNOB_ARC), (_KNOB_ARC, 1)])
    rows = []
    for radius, height in profile:
        x, y = radius * (knob if radius == 0.8 else quarter).T
        ring = np.concatenate([(x, y), (-y, x), (-x, -y), (y, -x)], axis=1)
        rows.append(np.stack([ring[0], turn * ring[1], np.full(12, height)], axis=1))
    return np.array(rows)


def _section(profile: Sequence[tuple[float, float, float, float, float]]) -> Floats:
    """Return control points (rows, 6, 3) of a tube that is symmetric to the plane y = 0."""
    return np.array(
        [
            [(x0, 0, z0), (x0, -y, z0), (x1, -y, z1), (x1, 0, z1), (x1, y, z1), (x0, y, z0)]
            for x0, z0, x1, z1, y in profile
        ]
    )


def _sampled(control: Floats, divisions: int, material: AnyMaterial) -> Mesh:
    """Return the mesh of a surface that is closed around its columns; its first row may be a pole."""
    rows, columns = control.shape[0] // 3, control.shape[1] // 3
    along, along_slope = _bernstein(rows, divisions, closed=False)
    around, around_slope = _bernstein(columns, divisions, closed=True)

    def tensor(v: Floats, u: Floats) -> Floats:
        return np.asarray(np.einsum("iv,ju,vux->ijx", v, u, control))

    places, across = tensor(along, around), tensor(along, around_slope)
    pole = not np.ptp(control[0], axis=0).any()
    if pole:
        # The derivative around vanishes; beside the pole it has the direction of the mixed derivative.
        places[0], across[0] = control[0, 0], tensor(along_slope, around_slope)[0]
    normals = np.cross(tensor(along_slope, around), across)
    parameters, faces = lattice(rows * divisions, columns * divisions, closed=False)
    uv = unwrapped(parameters[:, ::-1][faces], (0,))
    if pole:
        last = columns * divisions - 1  # of the row's vertices, which become one
        whole = (faces <= last).sum(axis=1) < 2  # the others have no area
        faces, uv = np.maximum(faces - last, 0)[whole], uv[whole]
        places, normals = places.reshape(-1, 3)[last:], normals.reshape(-1, 3)[last:]
    upright = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # takes rows (x, y, z) to (x, z, -y)
    places, normals = (a.reshape(-1, 3) @ upright for a in (places, normals))
    return Mesh(places, faces, normals, material=material, uv=uv)


def _bernstein(patches: int, divisions: int, *, closed: bool) -> tuple[Floats, Floats]:
    """Return weights of the control points of a chain of cubic patches at each sample, and their derivatives.

    Both are (samples, controls): 3 * patches controls and patches * divisions samples for a closed chain, one more of
    both for an open one.
    """
    sample = np.arange(patches * divisions + (not closed))
    patch = np.minimum(sample // divisions, patches - 1)
    t = sample / divisions - patch
    s = 1 - t
    values = np.stack([s**3, 3 * s * s * t, 3 * s * t * t, t**3], axis=1)
    slopes = 3 * np.stack([-s * s, s * (s - 2 * t), t * (2 * s - t), t * t], axis=1)
    controls = 3 * patches + (not closed)
    used = (3 * patch[:, None] + np.arange(4)) % controls
    tables = np.zeros((2, len(sample), controls))
    tables[:, sample[:, None], used] = values, slopes
    return tables[0], tables[1]
