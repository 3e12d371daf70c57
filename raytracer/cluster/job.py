"""The unit of work of a cluster: a scene with its integrator, and the Renderer that each worker process keeps for it.

Stage: cluster. A task gets a `Job` and its key; the first task of a process compiles the Renderer, later ones reuse it.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

import shpy as sh
from raytracer.accel.programs import LateProgram
from raytracer.errors import ClusterError
from raytracer.integrators.integrator import Integrator
from raytracer.integrators.renderer import Renderer
from raytracer.scene.scene import Scene

_PROBES = 4096


@dataclass(frozen=True, eq=False)
class Job:
    """A scene, the integrator of its picture, and the backend on which every worker runs it."""

    scene: Scene
    integrator: Integrator
    backend: str


class JobRenderer:
    """A job's Renderer in this process, the fingerprint of its results, and its `Renderer.origin`."""

    def __init__(self, job: Job) -> None:
        self.renderer = Renderer(job.scene, integrator=job.integrator, backend=job.backend)
        self.fingerprint = fingerprint(self.renderer)
        self.origin = self.renderer.origin()


class _ProbeResults(NamedTuple):
    quotient: sh.Attrib1f
    fused: sh.Attrib1f
    roots: sh.Attrib2f
    waves: sh.Attrib2f
    powers: sh.Attrib3f
    unit: sh.Vector3f


@LateProgram
def probe(x: sh.Attrib1f, y: sh.Attrib1f) -> _ProbeResults:
    """Compute operations that drivers and processors may round differently."""
    return _ProbeResults(
        x / y,
        x * y + x,
        sh.Attrib2f(sh.sqrt(x), sh.rsqrt(y)),
        sh.Attrib2f(sh.sin(64 * x), sh.cos(64 * y)),
        sh.Attrib3f(sh.exp(4 * x), sh.log(y), sh.pow(x, 8 * y)),
        sh.normalize(sh.Vector3f(x, y, 1)),
    )


def fingerprint(renderer: Renderer) -> str:
    """Return a digest of all that determines a worker's bits: the tables of the scene, and the results of `probe`.

    Workers of the same fingerprint give the same picture; in strict mode all of them have the same.
    """
    layout = renderer.layout
    if layout is None:
        return ""
    tables = layout.triangles, layout.normals, layout.colors, layout.uvs, layout.material_rows, layout.cones
    instanced = layout.instanced
    places = () if instanced is None else (instanced.meshes, instanced.levels.rows)
    numbers = layout.sheens, layout.glass, layout.layers, layout.mirrors, layout.lights, renderer.levels_around
    return probed(renderer.backend, renderer.integrator, *tables, *places, *numbers)


def probed(backend: str, integrator: Integrator, *tables: Any) -> str:
    """Return a digest of the results of `probe` in an integrator's arithmetic, and of tables."""
    numbers = np.arange(1, 2 * _PROBES + 1, dtype=np.uint64) * 2654435761 % (1 << 24)  # Knuth's multiplicative hash
    x, y = ((numbers + 1) / np.float32(1 << 24)).astype(np.float32).reshape(2, -1)
    results = probe.program.compile(backend, **integrator.arithmetic)(x, y)
    digest = hashlib.sha256()
    for table in (*tables, *results):
        digest.update(b"-" if table is None else np.ascontiguousarray(table).tobytes())
    return digest.hexdigest()[:16]


def check_alike(before: str | None, digest: str, integrator: Integrator, backend: str) -> str:
    """Return a worker's fingerprint; ClusterError if that of another worker, `before`, differs."""
    if before is not None and digest != before:
        raise ClusterError(
            f"the cluster's workers compute different bits with math={integrator.math!r} on {backend}, as their "
            'processors or drivers differ: choose math="strict" or "portable", or workers that are alike'
        )
    return digest
