"""The walk of a scene in programs of users: `Intersector.trace` and `Intersector.blocked`.

Stage: kernel. Moreno-Fortuny and McCool plan their tracer as "a modular system": its intersector is a component of
other programs. A call is recorded into the program under way; the walk itself is one subroutine for all calls, and what
it reads of the scene are tables and params, so that a scene which changes needs no other kernel.

    @sh.program
    def lit(point: sh.Point3f, light: sh.Point3f) -> sh.Attrib1b:
        return ~near.blocked(point, light - point, t_max=1)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.accel.bounds import far
from raytracer.accel.space import WORKING, Rows
from raytracer.errors import SceneError, users_line
from raytracer.kernels.point import barylerp, curve_depth, curved_normal, place_of, rows_of
from raytracer.kernels.queries import QueryRay
from raytracer.kernels.triangle import AheadBound, Walk
from raytracer.kernels.walk import HitValue, InstanceValue
from raytracer.meshes import Mesh
from raytracer.scene.layout import normal_rows, uv_rows
from shpy import SH_IF

Pose = tuple[Rows, Rows, Rows] | None
"""The pose of a scene: (turn, back, offset) takes its own point x to `turn @ x + offset`, and `back` inverts `turn`.

None is where it was made."""
UNLIMITED = float(np.finfo(np.float32).max)
"""The limit of a ray that has none. Drivers in fast mode compute with no infinity."""
SHIFTED, POSED = 4.0, 16.0
"""Roundings of its coordinates by which a point is moved off its triangle farther: where the scene is far from 0, and
where the object has been moved, so that a point is turned on its way out and on its way back."""


@sh.struct
class TracedHit:
    """The nearest hit of a ray that a program traces.

    `t`, `triangle`, `u` and `v` are those of `Hits`; `hit` tells whether anything was met. `object` is the number of
    the mesh among the scene's. `normal` is the unit normal, interpolated between normals at corners, and `face` that of
    the triangle, both on the side that the ray comes from. `uv` are the mesh's texture coordinates, 0 where it has
    none. `position` is the point in the scene's units, moved off the triangle to the side that the ray comes from by a
    bound of its rounding errors: rays that go on from there do not meet the triangle again. Where the mesh has normals
    at its corners, it is moved onto the curved surface that they describe, too (Hanika 2021, Ray Tracing Gems II,
    chapter 4). Where nothing is met, `t` is infinite, `triangle` and `object` are -1, and the rest is 0.
    """

    t: sh.Attrib1f
    triangle: sh.Attrib1i
    u: sh.Attrib1f
    v: sh.Attrib1f
    hit: sh.Attrib1b
    object: sh.Attrib1i
    normal: sh.Normal3f
    uv: sh.TexCoord2f
    face: sh.Normal3f
    position: sh.Point3f


class FoundHit(NamedTuple):
    """The result of the walk's subroutine: distance, triangle, barycentric uv, and the factor of the direction."""

    t: sh.Attrib1f
    triangle: sh.Attrib1i
    uv: sh.TexCoord2f
    shrink: sh.Attrib1f


class FoundInstance(NamedTuple):
    """A `FoundHit`, the triangle's number `id` in the tables, the weights of its corners there, and its instance."""

    t: sh.Attrib1f
    triangle: sh.Attrib1i
    uv: sh.TexCoord2f
    shrink: sh.Attrib1f
    id: sh.Attrib1i
    own_uv: sh.TexCoord2f
    instance: sh.Attrib1i


@dataclass(frozen=True, eq=False)
class Surfaces:
    """The normals, uv coordinates and meshes of triangles: rows as those of `Layout`, None where no mesh has any.

    `object_of` (N,) is each triangle's mesh, None if all of them belong to mesh 0. `mesh_of` (I,) is the mesh of each
    instance, 0 for that of the settled triangles; None without instances.
    """

    normals: NDArray[Any] | None
    uvs: NDArray[Any] | None
    object_of: NDArray[np.int32] | None
    mesh_of: NDArray[np.int32] | None = None

    @classmethod
    def of(cls, meshes: Sequence[Mesh], floats: type[np.floating[Any]]) -> Surfaces:
        """Return the rows of meshes, as kernels that work in `floats` hold them."""
        solid = [mesh for mesh in meshes if len(mesh)]
        numbers = [number for number, mesh in enumerate(meshes) if len(mesh)]
        normals = normal_rows(solid)
        return cls(
            None if normals is None else normals.astype(floats, copy=False),
            uv_rows(solid).astype(floats, copy=False) if any(mesh.uv is not None for mesh in solid) else None,
            np.repeat(numbers, list(map(len, solid))).astype(np.int32) if any(numbers) else None,
        )


class Precision(sh.Table):  # type: ignore[type-arg]
    """A table without a use but its data: to send them to a kernel of another precision than the scene's is an error.

    The kernel's text does not have it, as nothing reads it there. `stale`, if it is not empty, says why programs that
    have it no longer see the scene.
    """

    stale = ""

    def __init__(self, precision: str) -> None:
        super().__init__([0.0], sh.Attrib1f, "precision_of_scene", unique=False)
        self.precision, self.line = precision, ""

    def data(self, dtype: Any) -> Any:
        """Return the data; SceneError for another precision, and for a scene that has other tables now."""
        if self.stale:
            raise SceneError(f"{self.line}: {self.stale}")
        if np.dtype(dtype) != WORKING[self.precision]:
            other = next(name for name, floats in WORKING.items() if floats == np.dtype(dtype))
            raise SceneError(
                f"{self.line}: this traces a scene in {self.precision}, and its program runs in {other}: compile it "
                f'with precision="{self.precision}", or make Intersector(..., precision="{other}")'
            )
        return super().data(dtype)


class ScenePlace:
    """The params that take rays into the kernel's coordinates: `origin` and `scale`, and the pose of what was moved."""

    def __init__(self, origin: NDArray[np.float64], scale: float, roundoff: float, pose: Pose) -> None:
        self._origin, self._roundoff = origin, roundoff
        values = self._values(pose)
        # Names that are read off lines: a program that traces two scenes numbers them. Pages show no sliders for them.
        scene_origin = sh.Param(sh.Point3f, origin, title="")
        scene_scale = sh.Param(sh.Attrib1f, scale, title="")
        scene_moved = sh.Param(sh.Attrib1i, values["moved"], title="")
        scene_back = sh.Param(sh.Matrix3f, values["back"], title="")
        scene_turn = sh.Param(sh.Matrix3f, values["turn"], title="")
        scene_offset = sh.Param(sh.Vector3f, values["offset"], title="")
        scene_slack = sh.Param(sh.Attrib2f, values["slack"], title="")
        self.origin, self.scale, self.moved = scene_origin, scene_scale, scene_moved
        self.back, self.turn, self.offset, self.slack = scene_back, scene_turn, scene_offset, scene_slack

    def put(self, pose: Pose) -> None:
        """Place the scene anew; see `Pose`."""
        for name, value in self._values(pose).items():
            getattr(self, name).value = value

    def _values(self, pose: Pose) -> dict[str, Any]:
        """Return the values of the params of a pose."""
        turn, back, offset = (np.eye(3), np.eye(3), np.zeros(3)) if pose is None else pose
        roundings = SHIFTED if self._origin.any() else 0.0
        size = float(np.cbrt(abs(np.linalg.det(turn))))
        slack = self._roundoff * (roundings if pose is None else POSED)
        reach = float(np.abs(offset).sum()) + size * float(np.abs(self._origin).sum())
        slacks = slack, slack * reach
        return {"moved": int(pose is not None), "back": back, "turn": turn, "offset": offset, "slack": slacks}

    def own(self, origin: Any, direction: Any) -> tuple[Any, Any]:
        """Return a ray's origin and direction in the coordinates in which the scene was made."""
        eye, ray = sh.Point3f(origin), sh.Vector3f(direction)
        with SH_IF(self.moved > 0):
            eye[:] = sh.Point3f(self.back @ sh.Vector3f(eye - self.offset))
            ray[:] = self.back @ ray
        return eye, ray

    def turned(self, normal: Any) -> Any:
        """Return a unit vector as the scene stands."""
        unit = sh.Normal3f(normal)
        with SH_IF(self.moved > 0):
            unit[:] = sh.normalize(self.turn @ sh.Vector3f(normal))
        return unit

    def world(self, point: Any, facing: Any) -> Any:
        """Return a point of the kernel's coordinates where it stands; `facing` as `turned` leads off its triangle."""
        place = sh.Point3f(point / self.scale + self.origin)
        with SH_IF(self.moved > 0):
            place[:] = sh.Point3f(self.turn @ sh.Vector3f(place)) + self.offset
        size = abs(place)
        return place + (self.slack.x * (size.x + size.y + size.z) + self.slack.y) * facing


class Component:
    """A scene's walk for programs of users; `walk` has no bound for rays that start on a surface.

    `line` is where a program last recorded it, "" before.
    """

    def __init__(
        self,
        walk: Walk,
        origin: NDArray[np.float64],
        scale: float,
        precision: str,
        surfaces: Surfaces,
        pose: Pose,
    ) -> None:
        floats = WORKING[precision]
        self.walk, self.roundoff = walk, float(np.finfo(floats).eps) / 2
        self.place = ScenePlace(origin, scale, self.roundoff, pose)
        self.precision = Precision(precision)
        self.line = ""
        self._normals = _table(surfaces.normals, sh.Attrib4f, "normals")
        self._uvs = _table(surfaces.uvs, sh.TexCoord2f, "uvs")
        self._object_of = _table(surfaces.object_of, sh.Attrib1i, "object_of")
        self._mesh_of = _table(surfaces.mesh_of, sh.Attrib1i, "mesh_of")
        self._finders: dict[AheadBound | None, Any] = {}

    def trace(self, ray: tuple[Any, Any, Any, Any], bound: AheadBound | None) -> TracedHit:
        """Record the search for the nearest hit of (origin, direction, t_min, t_max)."""
        nearest = self.find(*ray, False, bound)
        struct: Any = TracedHit
        hit = sh.Attrib1b(nearest.triangle >= 0)
        inside = partial(sh.cond, hit)
        normal, face, position = self.point(nearest, *ray[:2])
        uv = sh.TexCoord2f(0, 0) if self._uvs is None else inside(self._lerp(self._uvs, nearest), 0.0)
        number = inside(self._object(nearest), -1)
        result: TracedHit = struct(
            nearest.t, nearest.triangle, nearest.uv.x, nearest.uv.y, hit, number,
            inside(normal, 0.0), uv, inside(face, 0.0), inside(position, 0.0),
        )  # fmt: skip
        return result

    def renew(self, normals: Rows | None, moved: Mapping[int, Mesh]) -> None:
        """Update the attributes of objects' surfaces, each by its first triangle; the walk's tables have been updated.

        `normals` are those of the scene. A mesh that is mirrored has its corners in another order.
        """
        for first, mesh in moved.items():
            rows = slice(3 * first, 3 * (first + len(mesh)))
            if self._normals is not None and normals is not None:
                self._normals.update(normals[rows], start=rows.start)
            if self._uvs is not None:
                self._uvs.update(uv_rows([mesh]), start=rows.start)

    def find(self, origin: Any, direction: Any, t_min: Any, t_max: Any, any_hit: bool, bound: AheadBound | None) -> Any:
        """Record a call of the walk; return its `FoundHit`."""
        self.line = self.precision.line = users_line()
        self.precision[0]  # the program has the table, and its kernel drops it
        return self.finder(bound)(origin, direction, t_min, t_max, sh.Attrib1b(any_hit))

    def finder(self, bound: AheadBound | None) -> Any:
        """Return the subroutine of the walk with this bound."""
        if bound not in self._finders:
            self._finders[bound] = _finder(self.walk.bounded(bound), self.place)
        return self._finders[bound]

    def point(self, nearest: Any, origin: Any, direction: Any) -> tuple[Any, Any, Any]:
        """Return the normal, the normal of the triangle and the point of a hit, as in `TracedHit`."""
        eye, ray = self.place.own(origin, direction)
        eye, ray = (eye - self.place.origin) * self.place.scale, ray * nearest.shrink
        hit = self._own_hit(nearest, nearest.t * (self.place.scale / nearest.shrink))
        corners = self.walk.triangles.corners_of(hit)
        front = sh.Normal3f(corners[0].w, corners[1].w, corners[2].w)
        side = sh.cond(sh.dot(front, ray) > 0, -1.0, 1.0)
        face = side * front
        places = tuple(corner.xyz for corner in corners)
        point, beside = place_of(self.walk.triangles, self.roundoff, hit, places, front, ray, eye)
        position, normal = point + beside * face, face
        if self._normals is not None:
            normals: Any = rows_of(self._normals, hit)
            if self._mesh_of is not None:
                normals = [self.walk.triangles.instances[hit.instance].normal(normal) for normal in normals]
            normal = curved_normal(hit, normals, side, face)
            position -= curve_depth(hit, normals, point, places, side)
        outward = self.place.turned(face)
        return self.place.turned(normal), outward, self.place.world(position, outward)

    def _lerp(self, table: Any, nearest: Any) -> Any:
        hit = self._own_hit(nearest, nearest.t)
        return barylerp(hit, *rows_of(table, hit))

    def _own_hit(self, nearest: Any, t: Any) -> Any:
        """Return a hit by the numbers that tables of triangles have."""
        if self._mesh_of is None:
            return HitValue(t, nearest.triangle, nearest.uv)
        return InstanceValue(t, sh.max(nearest.id, 0), nearest.own_uv, sh.max(nearest.instance, 0))

    def _object(self, nearest: Any) -> Any:
        """Return the number of the mesh of a hit."""
        hit = self._own_hit(nearest, nearest.t)
        number = 0 if self._object_of is None else self._object_of[hit.id]
        return number if self._mesh_of is None else number + self._mesh_of[hit.instance]


def _finder(walk: Walk, place: ScenePlace) -> Callable[..., Any]:
    """Return the subroutine that finds a ray's hit; where `any_hit` holds, the first that is found.

    A `t_max` from `UNLIMITED` on is no limit, whatever the direction's length.
    """
    kind: Any = FoundHit if walk.triangles.instances is None else FoundInstance

    @sh.subroutine
    def find_hit(
        origin: sh.Point3f, direction: sh.Vector3f, t_min: sh.Attrib1f, t_max: sh.Attrib1f, any_hit: sh.Attrib1b
    ) -> kind:
        eye, ray = place.own(origin, direction)
        converted = QueryRay(eye, ray, t_min, t_max, place.origin, place.scale, exact=False, keeps_unit=True)
        limit = sh.cond(~converted.wrong & (t_max >= UNLIMITED), far(), converted.limit)
        hit = walk(converted.ray, converted.eye, converted.near, limit, any_hit)
        own = () if hit.instance is None else (hit.id, hit.uv, hit.instance)
        return kind(converted.outside(hit.l, hit.id), *hit.in_scene, converted.shrink, *own)

    return find_hit


def ray_values(name: str, origin: Any, direction: Any, t_min: Any, t_max: Any) -> tuple[Any, Any, Any, Any]:
    """Return the arguments of a call as values; SceneError, with the user's line, for those that make no ray.

    An infinite number as `t_max` becomes `UNLIMITED`. Values of 64 bits are refused, since nothing narrows by itself.
    """
    t_max = UNLIMITED if isinstance(t_max, float) and t_max == np.inf else t_max
    kinds = {"origin": sh.Point3f, "direction": sh.Vector3f, "t_min": sh.Attrib1f, "t_max": sh.Attrib1f}
    cures = {
        sh.Point3f: "sh.Point3f(x, y, z)",
        sh.Vector3f: "sh.Vector3f(x, y, z)",
        sh.Attrib1f: "a number",
    }
    narrow = {sh.Point3f: "sh.Point3f(p)", sh.Vector3f: "sh.Vector3f(v)", sh.Attrib1f: "sh.Attrib1f(t)"}
    double: Any = sh.Attrib1d
    values = []
    for (what, kind), value in zip(kinds.items(), (origin, direction, t_min, t_max), strict=True):
        size, is_wide = getattr(type(value), "size", None), getattr(value, "base", None) is double.base
        try:
            if is_wide or (isinstance(size, int) and size != (1 if kind is sh.Attrib1f else 3)):
                raise TypeError
            values.append(kind(value.tolist() if isinstance(value, np.ndarray) else value))
        except (sh.ShpyError, TypeError, ValueError):
            spoken = type(value).__name__ if hasattr(type(value), "size") else repr(value)
            cure = (narrow if is_wide else cures)[kind]
            raise SceneError(f"{users_line()}: the {what} of {name} is {cure}, not {spoken:.60}") from None
    return tuple(values)


class StreamHit(NamedTuple):
    """A ray's nearest hit, as `Hits` has it."""

    t: sh.Attrib1f
    triangle: sh.Attrib1i
    u: sh.Attrib1f
    v: sh.Attrib1f


def intersect(component: Component, bound: AheadBound | None) -> Any:
    """Record the program that finds the nearest hits of streams of rays."""

    @sh.program
    def intersect(origin: sh.Point3f, direction: sh.Vector3f, t_min: sh.Attrib1f, t_max: sh.Attrib1f) -> StreamHit:
        hit = component.find(origin, direction, t_min, t_max, False, bound)
        return StreamHit(hit.t, hit.triangle, hit.uv.x, hit.uv.y)

    return intersect


def occluded(component: Component, bound: AheadBound | None) -> Any:
    """Record the program that tells which rays of streams meet anything."""

    @sh.program
    def occluded(origin: sh.Point3f, direction: sh.Vector3f, t_min: sh.Attrib1f, t_max: sh.Attrib1f) -> sh.Attrib1b:
        return sh.Attrib1b(component.find(origin, direction, t_min, t_max, True, bound).triangle >= 0)

    return occluded


def _table(rows: NDArray[Any] | None, kind: Any, name: str) -> Any:
    if rows is None:
        return None
    return sh.Table(rows, kind, name, unique=False)
