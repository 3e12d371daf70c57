"""Matrices of affine and projective maps, for columns on the right: `rotate(axis, angle) @ p`.

Stage: record. As in Sh, maps of the plane are Matrix3f and maps of space Matrix4f, in homogeneous coordinates; a Point
has w = 1 and a Vector w = 0. `m @ sh.Attrib4f(p, 1)` keeps w, which `perspective` needs: divide by it.

    m = translate((0, 0, -5)) @ rotate((0, 1, 0), sh.radians(30)) @ scale((2, 2, 2))
"""

from __future__ import annotations

from typing import Any

from shpy.lang.values.builtins import cos, cross, dot, normalize, sin, tan
from shpy.lang.values.matrix import MATRICES, Matrix3f, Matrix4f
from shpy.lang.values.types import Attrib1f, Attrib3f
from shpy.library.mathematics import outer
from shpy.library.operands import vector


def translate(offset: Any) -> Any:
    """Return the map that moves points by `offset`: a Matrix3f for two components, a Matrix4f for three."""
    v = vector(offset, (2, 3), "sh.library.translate")
    n = v.size
    rows = [(*(float(r == c) for c in range(n)), v[r]) for r in range(n)]
    return MATRICES[f"Matrix{n + 1}f"](*rows, (*(0.0,) * n, 1.0))


def scale(factors: Any) -> Any:
    """Return the map that scales each axis: a Matrix3f for two factors, a Matrix4f for three."""
    v = vector(factors, (2, 3), "sh.library.scale")
    n = v.size
    rows = [tuple(v[r] if r == c else 0.0 for c in range(n + 1)) for r in range(n)]
    return MATRICES[f"Matrix{n + 1}f"](*rows, (*(0.0,) * n, 1.0))


def rotate(axis: Any, angle: Any = None) -> Any:
    """Return a rotation: `rotate(angle)` of the plane (Matrix3f), `rotate(axis, angle)` of space (Matrix4f).

    Angles are in radians, counterclockwise when the axis points at the viewer (Rodrigues's formula). The axis may have
    any length but 0: with an axis of zeros the matrix scales by cos(angle) in place of a rotation.
    """
    if angle is None:
        turn = Attrib1f(vector(axis, (1,), "sh.library.rotate"))
        s, c = sin(turn), cos(turn)
        return Matrix3f((c, -s, 0), (s, c, 0), (0, 0, 1))
    a = normalize(Attrib3f(vector(axis, (3,), "sh.library.rotate")))
    turn = Attrib1f(vector(angle, (1,), "sh.library.rotate"))
    s, c = sin(turn), cos(turn)
    x, y, z = s * a.x, s * a.y, s * a.z
    spin = Matrix3f((c, -z, y), (z, c, -x), (-y, x, c))
    rows = (outer((1 - c) * a, a) + spin).rows
    return Matrix4f(*((row, 0) for row in rows), (0, 0, 0, 1))


def look_at(eye: Any, target: Any, up: Any = (0, 1, 0)) -> Any:
    """Return the map from the world to a camera at `eye` that looks along its -z axis at `target`, y upwards.

    A Matrix4f as of gluLookAt. Where `up` is along the line of sight, or `target` is `eye`, the matrix has rows of
    zeros.
    """
    origin, aim, above = (Attrib3f(vector(v, (3,), "sh.library.look_at")) for v in (eye, target, up))
    forward = normalize(aim - origin)
    side = normalize(cross(forward, above))
    upward = cross(side, forward)
    axes = (side, upward, -forward)
    return Matrix4f(*((axis, -dot(axis, origin)) for axis in axes), (0, 0, 0, 1))


def perspective(angle: Any, aspect: Any, near: Any, far: Any) -> Any:
    """Return the projection of gluPerspective: z from -near to -far becomes -1 to 1 after the division by w = -z.

    `angle` is the field of view from bottom to top in radians, `aspect` width over height.
    """
    sizes = [Attrib1f(vector(v, (1,), "sh.library.perspective")) for v in (angle, aspect, near, far)]
    height = 1 / tan(sizes[0] / 2)
    _, ratio, front, back = sizes
    depth = front - back
    return Matrix4f(
        (height / ratio, 0, 0, 0),
        (0, height, 0, 0),
        (0, 0, (back + front) / depth, 2 * back * front / depth),
        (0, 0, -1, 0),
    )
