"""The builders of the hierarchy side by side: CPU time of the tree, of all its tables, and of rays through it.

    print(builders(quick=False).markdown())

The meshes are torus knots of 10**5 and 10**6 triangles. Mitsuba and Embree build trees of their own.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks import peers, rays
from benchmarks.studies import backend, rounds_of, spread
from benchmarks.tables import Table
from raytracer import Intersector, Mesh
from raytracer.accel.choice import build
from raytracer.accel.space import to_kernel, triangle_rows
from raytracer.kernels.bvh_walk import BvhIntersector
from raytracer.kernels.triangle import Triangles
from raytracer.kernels.wide_walk import WideIntersector
from raytracer.meshes.shapes import knot

BUILDERS = ("bvh:sah", "bvh:ploc")
HEAD = ("builder", "triangles", "tree s", "with tables s", "tree ratio", "coherent rays ratio", "incoherent rays ratio")


def builders(quick: bool) -> Table:
    """Return CPU seconds of every builder, and the CPU time of rays through each tree in times of the first's."""
    meshes = [knot(segments=30, sides=10)] if quick else [knot(segments=n, sides=n // 8) for n in (640, 2000)]
    turns = 2 if quick else 5
    peer_names, _ = peers.available(["mitsuba", "embreex"])
    for name in peer_names:
        peers.start(name)
    rows = []
    for mesh in meshes:
        rows += _rows(mesh, peer_names, turns, 32 if quick else 1024)
        rays.forget()
    note = (
        f"CPU time of all threads: medians of {turns} rounds, with the first and the third quartile. With tables: from "
        f"corners to all tables of both walks, wide nodes included. Ratios are to the first builder's time in the same "
        f"round; rays take the closest hit, on {backend()}."
    )
    return Table("builders", note, HEAD, rows)


def _rows(mesh: Mesh, peer_names: list[str], turns: int, size: int) -> list[list[str]]:
    corners, *_ = to_kernel(mesh.corners, "f32")
    makers: dict[str, Callable[[], Any]] = {name: partial(build, name, corners, backend=backend()) for name in BUILDERS}
    whole = [partial(_with_tables, name, mesh.corners) for name in BUILDERS]
    makers |= {name: maker(mesh) for name, maker in _PEERS.items() if name in peer_names}
    trees = np.array(rounds_of(list(makers.values()), turns, time.process_time))
    tables = np.array(rounds_of(whole, turns, time.process_time))
    shoot = [Intersector(mesh, name, backend()) for name in BUILDERS]
    walks = []
    for ray_arrays in (rays.primary_rays(mesh, size), rays.secondary_rays(mesh, size // 2)):
        seconds = np.array(
            rounds_of([partial(one.intersect, *ray_arrays) for one in shoot], 2 * turns, time.process_time)
        )
        walks.append([spread(times / seconds[0], 2) for times in seconds])
    rows = []
    for k, name in enumerate(makers):
        ours = [column[k] if k < len(shoot) else "" for column in walks]
        with_tables = spread(tables[k], 2) if k < len(shoot) else ""
        rows.append([name, f"{len(mesh):,}", spread(trees[k], 3), with_tables, spread(trees[k] / trees[0], 2), *ours])
    return rows


def _with_tables(name: str, corners: np.ndarray) -> tuple[Any, Any]:
    """Make all that an Intersector reads."""
    corners, *_ = to_kernel(corners, "f32")
    triangles, bvh = Triangles.of(triangle_rows(corners), np.float32), build(name, corners, backend=backend())
    return BvhIntersector(bvh, triangles, together=True), WideIntersector(bvh, triangles, backend=backend())


def _mitsuba(mesh: Mesh) -> Callable[[], Any]:
    """Build the scene of a mesh that Mitsuba has."""
    import mitsuba as mi

    shape = rays.mitsuba_mesh(mesh)
    return lambda: mi.load_dict({"type": "scene", "mesh": shape})


def _embree(mesh: Mesh) -> Callable[[], Any]:
    """Build the scene of the corners; Embree does so before the first ray."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    corners = np.float32(mesh.corners)
    eye, ray = np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32)

    def make() -> Any:
        scene = EmbreeScene()
        geometry = TriangleMesh(scene, corners)
        assert geometry is not None  # the scene does not hold it itself
        return scene.run(eye, ray, query="DISTANCE")

    return make


_PEERS = {"mitsuba": _mitsuba, "embreex": _embree}
