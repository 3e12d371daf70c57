"""A picture as workers see it: the scene and its integrator, and the Renderer that a worker process keeps for them.

Stage: cluster. A task is handed a `Job` and its key; the first one of a process compiles, the others find the Renderer.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

import shpy as sh
from raytracer.integrators.integrator import Integrator
from raytracer.integrators.renderer import Renderer
from raytracer.scene.scene import Scene

KEPT = 2
"""Renderers that a process keeps."""
_PROBES = 4096


@dataclass(frozen=True, eq=False)
class Job:
    """A scene, the integrator of its picture, and the backend on which every worker runs it."""

    scene: Scene
    integrator: Integrator
    backend: str


@dataclass
class Kept:
    """The Renderer of a job in this process, the fingerprint of what it computes, and its `Renderer.origin`."""

    renderer: Renderer
    fingerprint: str
    origin: str
    lock: Any = field(default_factory=threading.Lock)


_kept: OrderedDict[str, Kept] = OrderedDict()
_making = threading.Lock()


@contextmanager
def kept(job: Job, key: str) -> Iterator[Kept]:
    """Give the Renderer of a job, for one thread at a time; it is made once in a process."""
    with _making:
        if key not in _kept:
            while len(_kept) >= KEPT:
                _kept.popitem(last=False)
            renderer = Renderer(job.scene, integrator=job.integrator, backend=job.backend)
            _kept[key] = Kept(renderer, fingerprint(renderer), renderer.origin())
        _kept.move_to_end(key)
        found = _kept[key]
    with found.lock:
        yield found


class _Probed(NamedTuple):
    quotient: sh.Attrib1f
    fused: sh.Attrib1f
    roots: sh.Attrib2f
    waves: sh.Attrib2f
    powers: sh.Attrib3f
    unit: sh.Vector3f


@sh.program
def probe(x: sh.Attrib1f, y: sh.Attrib1f) -> _Probed:
    """Compute what drivers and processors round differently where they may."""
    return _Probed(
        x / y,
        x * y + x,
        sh.Attrib2f(sh.sqrt(x), sh.rsqrt(y)),
        sh.Attrib2f(sh.sin(64 * x), sh.cos(64 * y)),
        sh.Attrib3f(sh.exp(4 * x), sh.log(y), sh.pow(x, 8 * y)),
        sh.normalize(sh.Vector3f(x, y, 1)),
    )


def fingerprint(renderer: Renderer) -> str:
    """Return a digest of what decides a worker's bits: the tables of the scene, and the results of `probe`.

    Workers of the same fingerprint give the same picture; in strict mode all of them have the same.
    """
    layout = renderer.layout
    if layout is None:
        return ""
    digest = hashlib.sha256()
    tables = layout.triangles, layout.normals, layout.colors, layout.uvs, layout.material_rows, layout.glass
    for table in (*tables, layout.lights, *_probed(renderer)):
        digest.update(b"-" if table is None else np.ascontiguousarray(table).tobytes())
    return digest.hexdigest()[:16]


def _probed(renderer: Renderer) -> Any:
    options: dict[str, Any] = {"precision": renderer.integrator.precision, "math": renderer.integrator.math}
    numbers = np.arange(1, 2 * _PROBES + 1, dtype=np.uint64) * 2654435761 % (1 << 24)  # Knuth's multiplicative hash
    x, y = ((numbers + 1) / np.float32(1 << 24)).astype(np.float32).reshape(2, -1)
    return probe.compile(renderer.backend, **options)(x, y)
