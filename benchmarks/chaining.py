"""Chains of kernels over streams: what a kernel costs within one, and what elements that do not run save.

    python -m benchmarks --only chaining,early

Each number is the best of some runs after one that does not count; a run ends when the device has finished it.
"""

from __future__ import annotations

from functools import partial

import numpy as np

import shpy as sh
from benchmarks.studies import Table, best
from raytracer import Mesh

SHARES = (1.0, 0.1, 0.01, 0.001)
SMALL = 64


@sh.program
def polar(x: sh.Attrib1f, y: sh.Attrib1f):
    """Three programs that connect by name: this one, `twist` and `cartesian`."""
    return {"r": sh.sqrt(x * x + y * y), "phi": sh.atan2(y, x)}


@sh.program
def twist(r: sh.Attrib1f, phi: sh.Attrib1f):
    """Turn each point by an angle that falls with its distance."""
    return {"r": r, "phi": phi + 1 / (0.5 + r)}


@sh.program
def cartesian(r: sh.Attrib1f, phi: sh.Attrib1f):
    """Back to coordinates."""
    return {"x": r * sh.cos(phi), "y": r * sh.sin(phi)}


@sh.program
def relax(u: sh.Table[sh.Attrib1f, 2]) -> sh.Attrib1f:
    """Jacobi's step."""
    i = sh.grid_index(2)
    return 0.25 * (u[i + (0, 1)] + u[i - (0, 1)] + u[i + (1, 0)] + u[i - (1, 0)])


@sh.program
def drift(u: sh.Attrib1f) -> sh.Attrib1f:
    """As little as a kernel can do."""
    return 0.5 * u + 1


@sh.program
def escape(c: sh.Point2f) -> sh.Attrib1f:
    """Return a computation that is worth leaving out: 60 sines, without a branch."""
    z = sh.Attrib1f(c.x)
    for _ in range(60):
        z = sh.sin(z) * 0.25 + c.y
    return z


def available() -> list[str]:
    """Return the backends of this machine."""
    return [b.name for b in sh.backends() if b.available]


def finished(stream: sh.Stream) -> None:
    """Wait for the device that computes a stream."""
    stream.place.space.finish()


def chaining(mesh: Mesh, quick: bool) -> Table:
    """Return a kernel within a chain over few elements; three kernels against the fused one; 500 steps of Jacobi."""
    del mesh
    count, steps, side, repeats = (1 << 10, 20, 16, 20) if quick else (1 << 20, 500, 1024, 2000)
    note = (
        f"Microseconds of each of {repeats} kernels over {SMALL} elements in sh.repeat. Milliseconds of three programs "
        f"over {count:,} elements, in sh.sequence and fused by <<, and of {steps} steps of Jacobi over {side} x {side}."
    )
    head = ["backend", "µs a kernel", "in sequence, ms", "fused, ms", "Jacobi, ms"]
    rows = []
    for backend in available():
        seconds = _times_on(backend, count, steps, side, repeats)
        rows.append([backend, *(f"{1e3 * s:.2f}" for s in seconds)])
    return Table("chaining", note, head, rows)


def _times_on(backend: str, count: int, steps: int, side: int, repeats: int) -> tuple[float, ...]:
    """Return the seconds of each column; the first in milliseconds."""
    x, y = (np.random.default_rng(k).normal(size=count).astype(np.float32) for k in (1, 2))
    apart = sh.sequence(polar, twist, cartesian)
    fused = (cartesian << twist << polar).compile(backend)
    streams = {n: sh.Stream(a, sh.Attrib1f, backend=backend) for n, a in (("x", x), ("y", y))}
    few = sh.Stream(x[:SMALL], sh.Attrib1f, backend=backend)
    plate = sh.Stream(np.resize(x, (side, side)), sh.Attrib1f, backend=backend)
    return (
        best(lambda: finished(sh.repeat(drift, repeats).run(u=few).streams["u"]))[0] / repeats * 1e3,
        best(lambda: finished(apart.run(**streams).streams["x"]))[0],
        best(lambda: finished(fused(streams["x"], streams["y"])["x"]))[0],
        best(lambda: finished(sh.repeat(relax, steps).run(u=plate).streams["u"]), 2)[0],
    )


def early(mesh: Mesh, quick: bool) -> Table:
    """Measure runs of which a share of the elements are alive: scattered at random, and all at the beginning."""
    del mesh
    count = 1 << 12 if quick else 1 << 20
    rng = np.random.default_rng(3)
    points = rng.random((count, 2), np.float32)
    rows = []
    for backend in available():
        c = sh.Stream(points, sh.Point2f, backend=backend)
        kernel = escape.compile(backend)
        out = sh.Stream.empty(count, sh.Attrib1f, backend)
        whole = best(partial(_run, kernel, c, out, None), 3)[0]
        for name, ranks in (("scattered", rng.random(count)), ("together", np.arange(count) / count)):
            masks = [sh.Stream(ranks < share, sh.Attrib1b, backend=backend) for share in SHARES]
            seconds = [whole, *(best(partial(_run, kernel, c, out, mask), 3)[0] for mask in masks)]
            rows.append([f"{backend}, {name}", *(f"{1e3 * s:.1f}" for s in seconds)])
        ranks, result = rng.random(count), np.empty(count, np.float32)
        whole = best(partial(kernel.run, points, out=result), 3)[0]
        masked = [best(partial(kernel.run, points, out=result, where=ranks < share), 3)[0] for share in SHARES]
        rows.append([f"{backend}, scattered, arrays", *(f"{1e3 * s:.1f}" for s in (whole, *masked))])
    note = (
        f"Milliseconds of 60 sines for {count:,} elements in streams or arrays, without where= and with so many alive."
    )
    return Table("early", note, ["backend", "no where=", *(f"{share:.1%}" for share in SHARES)], rows)


def _run(kernel: sh.Kernel, c: sh.Stream, out: sh.Stream, where: sh.Stream | None) -> None:
    finished(kernel.run(c, out=out, where=where).outputs)
