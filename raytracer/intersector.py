"""Questions about the triangles of a mesh or scene: hits of rays, and closest points.

Stage: query. The same walk as the pictures', without their shading.

    shoot = Intersector(mesh, backend="opencl")
    hits = shoot.intersect(origins, directions)          # hits.t, hits.triangle, hits.u, hits.v
    every = shoot.all_hits(origins, directions)          # every.t[every.offsets[k] : every.offsets[k + 1]]
    near = shoot.closest_point(points)                   # near.points, near.distances, near.triangles
    shoot.move(transform)                                # a rigid object elsewhere
    shoot.move("wheel", transform)                       # one object of a scene elsewhere
    hit = shoot.trace(origin, direction)                 # inside a program of yours: hit.position, hit.normal, …
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import shpy as sh
from raytracer.accel.bvh import Bvh
from raytracer.accel.choice import INSTANCES, build, check
from raytracer.accel.space import WORKING, to_kernel, triangle_rows
from raytracer.accel.two_levels import TwoLevels
from raytracer.backends import chosen_backend
from raytracer.errors import SceneError, users_line
from raytracer.instanced_geometry import InstancedGeometry
from raytracer.kernels import component, nearby, queries
from raytracer.kernels.component import Component, TracedHit, ray_values
from raytracer.kernels.triangle import AheadBound
from raytracer.kernels.walk import SEVERAL, QueryWalks, Structure, Way, lanes_of
from raytracer.layered.cube import LayeredCube, cube_of, is_layered
from raytracer.layered.placed import PlacedCubes
from raytracer.meshes import Mesh
from raytracer.meshes.mesh import check_expansion
from raytracer.moved import CAMERA, Geometry, MovedObjects
from raytracer.rays import AllHits, Closest, Frame, Hits, Pose, Rays, alike, check_streams, is_stream, triples
from raytracer.scene.instanced import shares_many
from raytracer.scene.scene import Scene

START = 16.0
"""The largest distance from its triangle of the origin of a ray with `leaving=True`, in roundings of coordinates."""
_FARTHEST = 2.0**56
"""The limit of the kernel's coordinates, 2**24 times the size of the scene: farther points are clamped to it."""

_RECORDED = ("_component", "_walks", "_closest", "_expanded")
"""The attributes that hold recorded programs; copies record them again."""


class Intersector:
    """Finds hits with the triangles of a mesh, or of all meshes of a scene one after the other.

    `accel` is "bvh", "grid" or "brute" (see `Whitted`), which differ in time alone, or "instances", which shares the
    triangles of a scene's instances; None is the latter for many instances in f32, otherwise "bvh". `backend` is one of
    `sh.backends()`, None for the default; `precision` "f32", "f64" or "f16". Raises SceneError unless it is a mesh or a
    scene, and for another accelerator or precision.

    `accel` may also be a `LayeredCube` of the mesh, or "ldc", "ldc:resolution" or "ldc:resolution:hit", which make one:
    `intersect` and `occluded` are then as exact as the cube is; `count` and `all_hits` raise SceneError.

    Rays are arrays `origins` and `directions` (..., 3) of the same shape, such as (N, 3) or (H, W, 3), and all results
    have that shape without its last axis. Directions may have any length; `t_min` and `t_max` are numbers or arrays
    of the results' shape, in lengths of the directions. float32 arrays go to the device as they are, others are rounded
    to it on the way. Raises SceneError for shapes that do not fit, for what is no real number, for NaN, for infinite
    origins or directions, and for directions of length zero. A ray from farther away than a kernel's numbers reach,
    2**90 times the mesh's size in f32, meets nothing: its own numbers do not say where it passes.

    A ray that starts on a triangle may meet it again at a distance of a few roundings. With `leaving=True` it only
    meets triangles that lie ahead by more than the rounding errors of an origin on a surface: 16 roundings of the
    coordinates, across the triangle's plane. `points` gives such origins for hits.

    On OpenCL rays that have little in common with their neighbours in the arrays walk through the hierarchy one by one,
    others together; which it is to be is seen from a few of them. The hits are the same.
    """

    def __init__(
        self,
        mesh_or_scene: Mesh | Scene,
        accel: str | LayeredCube | None = None,
        backend: str | None = None,
        precision: str = "f32",
    ) -> None:
        if not isinstance(mesh_or_scene, Mesh | Scene):
            raise SceneError(f"an Intersector takes a Mesh or a Scene, not {type(mesh_or_scene).__name__}")
        if precision not in WORKING:
            raise SceneError(f"the precision is one of {', '.join(map(repr, WORKING))}, not {precision!r}")
        if accel is None:
            shares = precision == "f32" and isinstance(mesh_or_scene, Scene) and shares_many(mesh_or_scene)
            accel = INSTANCES if shares else "bvh"
        layered = isinstance(accel, LayeredCube) or is_layered(accel)
        if layered and precision != "f32":
            raise SceneError(f'a layered depth cube works at precision="f32", not {precision!r}')
        if not isinstance(accel, LayeredCube) and not layered:
            check(accel, INSTANCES)
        if accel == INSTANCES and precision != "f32":
            raise SceneError(f'accel="instances" works at precision="f32", not {precision!r}')
        self._accel = accel
        self._pose: Pose | None = None
        self._source = mesh_or_scene
        self._moved: MovedObjects | None = None
        self._target = chosen_backend(backend)
        self._options: dict[str, Any] = {"backend": backend, "precision": precision, "loop_limit": None}
        self._precision, self._floats = precision, WORKING[precision]
        self._kernels: dict[Any, Any] = {}
        self._geometry = self._still_geometry(backend)

    def _still_geometry(self, backend: str | None) -> Geometry | InstancedGeometry:
        """Return the triangles as they were given, and build the accelerator over them."""
        source, precision = self._source, self._precision
        meshes = tuple(source.meshes) if isinstance(source, Scene) else (source,)
        if self._accel == INSTANCES and any(map(len, meshes)):
            return InstancedGeometry(source, self._target)
        check_expansion(source.name, meshes)
        parts = [mesh.corners for mesh in meshes if len(mesh)]
        corners, origin, scale = to_kernel(np.concatenate([np.zeros((0, 3, 3)), *parts]), precision)
        rows, structure = triangle_rows(corners), self._accelerator(corners, backend) if parts else None
        if isinstance(structure, LayeredCube):
            structure.check_triangles(rows)
        return Geometry(Frame(origin, scale, precision), meshes, corners, rows, structure)

    def _accelerator(self, corners: NDArray[np.float64], backend: str | None) -> Structure:
        """Build the accelerator over triangles, or take the user's cube."""
        accel = self._accel
        if isinstance(accel, LayeredCube):
            return accel
        if is_layered(accel):
            return cube_of(accel, self._source, backend)
        return build(accel, corners, self._precision, backend=self._target)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for copies and pickles, without kernels and recorded programs."""
        return {name: value for name, value in self.__dict__.items() if name not in _RECORDED} | {"_kernels": {}}

    def move(self, name: str | int | ArrayLike | None = None, transform: ArrayLike | None = None) -> None:
        """Place all meshes, or the meshes of a name, by `transform` from their original places; None for there.

        `move(transform)` places all of them, and nothing is built anew: rays are taken to them in float64, which costs
        a little for each. `transform` (4, 4) multiplies columns (x, y, z, 1): a rotation, a move, and one scale for all
        axes; it may mirror.

        `move(name, transform)` places the meshes of a name, or the one of a number, among the others, by any matrix
        that `Renderer.move` takes; the hits are the same as for a new Intersector of the moved scene. Instances that
        share their triangles cost a hierarchy over all instances, other meshes beside them a new layout. Elsewhere the
        first move of an object gives it an accelerator of its own; later ones change its parts of the tables alone,
        unless the scene grows beyond the next power of two. `closest_point`, and on a grid `count` and `all_hits`,
        build a hierarchy anew after a move. Programs that `trace` the scene see later moves; one that was recorded
        before the first move of an object raises SceneError when it runs.

        Raises SceneError for unknown names, naming those that there are, for other matrices, and for accel="brute".
        """
        if isinstance(name, str | int) or (name is not None and transform is not None):
            self._move_one(name, np.eye(4) if transform is None else transform)
            return
        transform = name if transform is None else transform
        self._pose = None if transform is None else Pose.of(transform)
        vars(self).pop("_expanded", None)
        if "_component" in self.__dict__:
            self._component.place.put(self._placed)

    def trace(
        self, origin: Any, direction: Any, t_min: Any = 0.0, t_max: Any = np.inf, *, leaving: bool = True
    ) -> TracedHit:
        """Find a ray's nearest hit with t in [t_min, t_max), inside a program: the walk is recorded into it.

        `origin` and `direction` are a point and a vector of the program, `t_min` and `t_max` its numbers, as in
        `Intersector`; the ray's numbers must be those of binary32. A ray of NaN, of infinite numbers, or whose
        direction is 0 meets nothing.

        The walk stands once in a kernel, as a subroutine, however many calls there are. Its tables and the scene's
        place are read when the program runs, so `move` needs no other program. With `leaving` rays may start at a
        `TracedHit.position`: they meet what lies ahead of their origin beyond rounding errors. Without it they meet
        what `intersect` finds, and may begin behind their origin.

        Raises SceneError, with the line, outside of a program, for a scene without triangles, for a scene in
        f16, and where its program runs in another precision than the scene's.
        """
        component = self._recorded("trace")
        return component.trace(ray_values("trace", origin, direction, t_min, t_max), self._ahead(leaving))

    def blocked(
        self, origin: Any, direction: Any, t_max: Any = np.inf, t_min: Any = 0.0, *, leaving: bool = True
    ) -> Any:
        """Return, inside a program, whether a ray meets anything with t in [t_min, t_max), an `sh.Attrib1b`.

        Arguments and errors are those of `trace`. The walk ends at the first hit that it finds.
        """
        component = self._recorded("blocked")
        ray = ray_values("blocked", origin, direction, t_min, t_max)
        return component.find(*ray, True, self._ahead(leaving)).triangle >= 0

    def _recorded(self, name: str) -> Component:
        """Return the walk for the program under way; SceneError if there is none, or nothing to walk through."""
        if self._geometry.structure is None:
            raise SceneError(
                f"{users_line()}: {name} needs triangles, and this scene has none: give it a mesh with some"
            )
        if not sh.is_recording():
            other = "intersect" if name == "trace" else "occluded"
            raise SceneError(
                f"{users_line()}: {name} works while a program is recorded: call it in a function under @sh.program, "
                f"or {other}(origins, directions) with arrays or streams of rays"
            )
        self._geometry.frame.check_programs()
        return self._component

    def _ahead(self, leaving: bool, start: float = 0.0) -> AheadBound | None:
        """Return the bound for rays that leave surfaces, from origins that may be `start` roundings off them."""
        return AheadBound(float(np.finfo(self._floats).eps) / 2, start) if leaving else None

    def _move_one(self, name: Any, transform: ArrayLike) -> None:
        """Move the meshes of a name or a number."""
        if isinstance(self._geometry, InstancedGeometry):
            self._move_instances(self._geometry, name, transform)
            return
        moved = self._moved or MovedObjects(self._source, self._accel, self._precision, self._target)
        renewed = moved.move(name, transform)
        self._moved, self._geometry = moved, moved.geometry
        for outdated in ("_walks", "_closest"):
            vars(self).pop(outdated, None)
        self._renew_component(name, renewed)
        several = SEVERAL if self._accel == "grid" else ()
        self._kernels = {key: kernel for key, kernel in self._kernels.items() if not renewed and key[0] not in several}

    def _move_instances(self, geometry: InstancedGeometry, name: Any, transform: ArrayLike) -> None:
        """Move the meshes of a name or a number where instances share their triangles."""
        renewed, walks = geometry.move(name, transform), vars(self).get("_walks")
        vars(self).pop("_expanded", None)
        if renewed or (walks is not None and not walks.place(geometry.structure)):
            vars(self).pop("_walks", None)
            self._kernels = {}
            self._renew_component(name, True)

    def _renew_component(self, name: Any, renewed: bool) -> None:
        """Let programs that trace the scene see a move; those whose tables are out of use raise when they run."""
        component: Component | None = self.__dict__.get("_component")
        if component is None:
            return
        if not renewed:
            assert self._moved is not None
            component.renew(self._moved.layout.normals, self._moved.changed)
            return
        component.precision.stale = (
            f"the move of {name!r} has given the scene other tables since this was recorded: record the program anew, "
            f"after move({name!r}, None) and the like for all objects that will move"
        )
        del self.__dict__["_component"]

    def intersect(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        *,
        leaving: bool = False,
    ) -> Hits:
        """Find the nearest hit of each ray with t in [t_min, t_max); arguments and errors as in `Intersector`.

        For streams of rays, of points and vectors on the device of this Intersector, the hits are streams there, and so
        may `t_min` and `t_max` be. A stream's ray of NaN, of infinite numbers, or whose direction is 0 meets nothing.
        """
        if is_stream(origins, directions):
            return Hits(*self._over_streams("intersect", origins, directions, t_min, t_max, leaving))
        rays = self._rays(origins, directions, t_min, t_max)
        shape = rays.shape
        if self._has_nothing(rays):
            floats = self._floats
            return Hits(np.full(shape, np.inf, floats), np.full(shape, -1, np.int32), *np.zeros((2, *shape), floats))
        (t, triangle, uv), exact = self._run("intersect", rays, leaving)
        if exact:
            t = self._geometry.frame.distances(t, triangle, rays)
        return Hits(*(part.reshape(shape) for part in (t, triangle, uv[:, 0], uv[:, 1])))

    def occluded(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_max: ArrayLike = np.inf,
        t_min: ArrayLike = 0.0,
        *,
        leaving: bool = False,
    ) -> NDArray[np.bool_]:
        """Return True for each ray with a hit with t in [t_min, t_max); arguments and errors as in `Intersector`.

        For streams of rays it is a stream, as with `intersect`.
        """
        if is_stream(origins, directions):
            stream: NDArray[Any] = self._over_streams("occluded", origins, directions, t_min, t_max, leaving)
            return stream
        rays = self._rays(origins, directions, t_min, t_max)
        if self._has_nothing(rays):
            return np.zeros(rays.shape, dtype=bool)
        return np.asarray(self._run("occluded", rays, leaving)[0][0].reshape(rays.shape))

    def count(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        *,
        leaving: bool = False,
    ) -> NDArray[np.int32]:
        """Count the triangles that each ray hits with t in [t_min, t_max), int32; arguments as in `Intersector`.

        A ray through an edge or a corner hits every triangle there.
        """
        rays = self._rays(origins, directions, t_min, t_max)
        if self._has_nothing(rays):
            return np.zeros(rays.shape, np.int32)
        return np.asarray(self._run("count", rays, leaving)[0][0].reshape(rays.shape))

    def all_hits(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        *,
        leaving: bool = False,
    ) -> AllHits:
        """Find every hit of each ray with t in [t_min, t_max), as many as `count` says; arguments and errors as there.

        The first walk finds four hits; rays with more go on from their last one.
        """
        rays = self._rays(origins, directions, t_min, t_max)
        if self._has_nothing(rays):
            nothing = np.zeros(0, self._floats)
            return AllHits(np.zeros(len(rays) + 1, np.int64), nothing, np.zeros(0, np.int32), nothing, nothing)
        rounds = list(self._rounds(rays, leaving))
        ray, rank, *columns = (np.concatenate(parts) for parts in zip(*rounds, strict=True))
        offsets = np.concatenate([[0], np.cumsum(np.bincount(ray, minlength=len(rays)))])
        if len(rounds) > 1:
            places = offsets[ray] + rank
            for column in columns:
                column[places] = column.copy()
        return AllHits(offsets, *columns)

    def _rounds(self, rays: Rays, leaving: bool) -> Iterator[tuple[NDArray[Any], ...]]:
        """Yield the hits of each walk in flat arrays: ray, place among the ray's hits, t, triangle, u and v."""
        here, after, done = np.arange(len(rays)), (-np.inf, -1), 0
        while len(here):
            going = rays[here] if done else rays
            (*fours, last), exact = self._run("list_more" if done else "list_hits", going, leaving, *after)
            t, triangle, u, v = fours[0] if len(fours) == 1 else map(np.hstack, zip(*fours, strict=True))
            if exact:
                t = self._geometry.frame.distances(t, triangle, going)
            hits = np.flatnonzero(triangle.reshape(-1) >= 0)
            each, rank = np.divmod(hits, triangle.shape[1])
            yield here[each], done + rank, *(column.reshape(-1)[hits] for column in (t, triangle, u, v))
            more = triangle[:, -1] >= 0
            here, after, done = here[more], (last[more], triangle[more, -1]), done + triangle.shape[1]

    def closest_point(self, points: ArrayLike) -> Closest:
        """Find the point of the mesh that is closest to each of `points` (..., 3).

        Of triangles at the same distance that of the lowest number. Errors are a few roundings of float32 of the mesh's
        size and of the distance. Instances that share their triangles get triangles of their own, with the first call.
        Raises SceneError for other shapes, for numbers that are not real or not finite, and for another precision than
        "f32".
        """
        if self._precision != "f32":
            raise SceneError(f'closest_point works at precision="f32", not {self._precision!r}')
        query_points = triples("points", points)
        finite = np.isfinite(query_points).all(axis=-1)
        if not finite.all():
            raise SceneError(f"points contain NaN or infinity, first in point {np.argwhere(~finite)[0].tolist()}")
        shape, flat = query_points.shape[:-1], query_points.reshape(-1, 3).astype(np.float64, copy=False)
        if isinstance(self._geometry, InstancedGeometry):
            return self._expanded.closest_point(query_points)
        if self._geometry.structure is None or not len(flat):
            return Closest(np.full(query_points.shape, np.nan), np.full(shape, np.inf), np.full(shape, -1, np.int32))
        own = flat if self._pose is None else self._pose.inside(flat)
        place, farthest = own - self._geometry.frame.origin, _FARTHEST / self._geometry.frame.scale
        place *= (farthest / np.maximum(np.abs(place).max(axis=1), farthest))[:, None]
        place = (place * self._geometry.frame.scale).astype(np.float32)
        way, triangle = self._closest(place)
        closest = self._outside(
            (place + way.astype(np.float64)) / self._geometry.frame.scale + self._geometry.frame.origin
        )
        apart = closest - flat
        large = np.abs(apart).max(axis=1)  # the squares may overflow f64
        distance = large * np.linalg.norm(apart / np.where(large > 0, large, 1)[:, None], axis=1)
        return Closest(closest.reshape(query_points.shape), distance.reshape(shape), triangle.reshape(shape))

    def points(self, hits: Hits | AllHits) -> NDArray[np.float64]:
        """Return the points of hits, (..., 3), as means of the triangles' corners; NaN where nothing was met.

        Rays that go on from there take `leaving=True`.
        """
        points = np.full((*hits.triangle.shape, 3), np.nan)
        met = hits.triangle >= 0
        if met.any():
            corners = self._geometry.corners_at(hits.triangle[met])
            u, v = (part[met].astype(np.float64)[:, None] for part in (hits.u, hits.v))
            mean = (1 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]
            points[met] = self._outside(mean / self._geometry.frame.scale + self._geometry.frame.origin)
        return points

    def _rays(self, origins: ArrayLike, directions: ArrayLike, t_min: ArrayLike, t_max: ArrayLike) -> Rays:
        """Return the rays that a user gives in the mesh's own coordinates."""
        rays = Rays.of(origins, directions, t_min, t_max)
        if self._pose is None:
            return rays
        rays.check()
        return self._pose.from_outside(rays)

    def _outside(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert the mesh's own places to those where they stand."""
        return places if self._pose is None else self._pose.outside(places)

    def _over_streams(self, name: str, origins: Any, directions: Any, t_min: Any, t_max: Any, leaving: bool) -> Any:
        """Run a query over streams of rays; return its streams."""
        place = check_streams(origins, directions, t_min, t_max, self._target, self._precision)
        if self._geometry.structure is None:
            nothing = (np.inf, sh.Attrib1f), (-1, sh.Attrib1i), (0, sh.Attrib1f), (0, sh.Attrib1f)
            fill = nothing if name == "intersect" else ((False, sh.Attrib1b),)
            options = {"backend": place.backend, "device": place.device, "precision": place.precision}
            streams = [sh.Stream(np.full(origins.shape, value), kind, **options) for value, kind in fill]
            return streams if name == "intersect" else streams[0]
        key = name, place, leaving
        if key not in self._kernels:
            program = getattr(component, name)(self._component, self._ahead(leaving, START))
            lanes = lanes_of(self._target, self._geometry.structure)
            self._kernels[key] = program.compile(**self._options, device=place.device or None, **lanes)
        return self._kernels[key](origins, directions, t_min, t_max)

    def _has_nothing(self, rays: Rays) -> bool:
        """Return whether there is no triangle or no ray; the rays are checked then."""
        if self._geometry.structure is None:
            rays.check()
        return self._geometry.structure is None or not len(rays)

    def _run(self, name: str, rays: Rays, leaving: bool, *more: Any) -> tuple[tuple[Any, ...], bool]:
        """Run a query's kernel; return its outputs, and True if the rays had to be converted before it."""
        for exact in (False, True) if self._geometry.frame.is_direct else (True,):
            if exact:
                rays.check()
            with np.errstate(over="ignore"):  # the kernel refuses infinities
                inputs = [np.asarray(values, self._floats) for values in self._geometry.frame.inputs(rays, exact)]
            *outputs, wrong = self._kernel(name, rays, leaving, exact)(*inputs, *more)
            if exact or not wrong.any():
                break
        return tuple(outputs), exact

    def _kernel(self, name: str, rays: Rays, leaving: bool, exact: bool) -> Any:
        """Return the kernel for these rays, with one lane where they diverge; rays through a cube always diverge."""
        key = name, self._way(rays), leaving, exact
        if key not in self._kernels:
            structure = self._geometry.structure
            if name in SEVERAL and isinstance(structure, LayeredCube | PlacedCubes):
                raise SceneError('a layered depth cube finds the nearest hit alone: count hits with accel="bvh"')
            walk = self._walks.walk_for(name, self._ahead(leaving, START), key[1])
            lanes = lanes_of(self._target, structure, alone=key[1] == "alone")
            self._kernels[key] = getattr(queries, name)(walk, exact).compile(**self._options, **lanes)
        return self._kernels[key]

    def _way(self, rays: Rays) -> Way:
        """Return how rays walk: where they diverge, each goes through the BVH in a packet of one lane."""
        structure, frame = self._geometry.structure, self._geometry.frame
        structure = structure.top if isinstance(structure, TwoLevels) else structure
        if not self._walks.has_wide or not isinstance(structure, Bvh) or np.any(rays.near < 0):
            return "any"
        low, high = (side[0] / frame.scale + frame.origin for side in (structure.low, structure.high))
        return "packets" if alike(rays.eye, rays.ray, low, high) else "alone"

    @cached_property
    def _walks(self) -> QueryWalks:
        """The walks through the triangles where they are now."""
        return self._geometry.walks(self._target)

    @cached_property
    def _component(self) -> Component:
        """The walk as a component of programs, made on first use."""
        surfaces, frame = self._geometry.surfaces, self._geometry.frame
        return Component(self._walks.walk, frame.origin, frame.scale, self._precision, surfaces, self._placed)

    @property
    def _placed(self) -> Any:
        """The pose by which programs trace this mesh."""
        return self._pose and (self._pose.turn, self._pose.back, self._pose.offset)

    @cached_property
    def _expanded(self) -> Intersector:
        """The triangles of all instances, each in a place of its own, for closest points."""
        expanded = Intersector(Scene(self._geometry.meshes, camera=CAMERA), "bvh", self._options["backend"])
        expanded._pose = self._pose
        return expanded

    @cached_property
    def _closest(self) -> Any:
        """The kernel for closest points."""
        program = nearby.closest_point(self._walks.wide)
        return program.compile(**self._options, **lanes_of(self._target, None, alone=True))
