"""Check the promises of `tradeoff` with six kernels and three scenes, on inputs that it has not seen.

    print(STUDIES["budgets"](mesh, quick=False).markdown())

A pick is good if it keeps the budget there, and if of all candidates that keep it none is much faster when they are
timed again, in turns. The reference of the check on kernels is binary64, that on scenes the picture in f64.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np

import shpy as sh
from benchmarks.frames import scene_of
from benchmarks.rounds import once
from benchmarks.studies import Table, backend
from raytracer import Mesh, Scene
from raytracer.integrators.renderer import Renderer
from raytracer.studies import tradeoff as trade

ROUNDS = 15
SEED = 4711
"""The seed of inputs that no search has drawn."""
CAMERAS = 8
"""Number of cameras from which the pictures of each scene are checked."""


@sh.program
def growth(x: sh.Attrib1f) -> sh.Attrib1f:
    total = sh.Attrib1f(0)
    for k in range(16, 0, -1):
        total[:] = sh.mad(total, x, 1.0 / k)
    return total


@sh.program
def bell(x: sh.Attrib1f) -> sh.Attrib1f:
    return sh.exp(-x * x / 2)


@sh.program
def polar(x: sh.Attrib1f, y: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f]:
    return sh.length(sh.vec2(x, y)), sh.atan2(y, x)


@sh.program
def tone(light: sh.Attrib1f) -> sh.Attrib1f:
    return sh.pow(light / (1 + light), 1 / 2.2)


@sh.program
def wave(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
    return 2 + sh.sin(3 * x) + 0.5 * sh.cos(5 * y)


def fresnel(cosine: sh.Attrib1f) -> sh.Attrib1f:
    """Return the share that glass mirrors, averaged over both polarisations."""
    inside = sh.sqrt(1 - (1 - cosine * cosine) / 2.25)
    along = (inside - 1.5 * cosine) / (inside + 1.5 * cosine)
    across = (cosine - 1.5 * inside) / (cosine + 1.5 * inside)
    return (along * along + across * across) / 2


def schlick(cosine: sh.Attrib1f) -> sh.Attrib1f:
    """Return Schlick's approximation (1994) of `fresnel`."""
    return 0.04 + 0.96 * (1 - cosine) ** 5


glass = sh.choice("glass", {"fresnel": fresnel, "schlick": schlick})

Range = tuple[float, float] | tuple[float, float, str]
KERNELS: Sequence[tuple[str, Any, dict[str, Range], Any]] = (
    ("growth, 16 terms", growth, {"x": (0.0, 1.0)}, sh.accuracy.ulp(4)),
    ("bell curve", bell, {"x": (-4.0, 4.0)}, sh.accuracy.ulp(64)),
    ("polar coordinates", polar, {"x": (0.1, 10.0), "y": (0.1, 10.0)}, sh.accuracy.ulp(4)),
    ("tone curve", tone, {"light": (1e-3, 1e3, "log")}, sh.accuracy.ulp(16)),
    ("waves", wave, {"x": (-10.0, 10.0), "y": (-10.0, 10.0)}, sh.accuracy.ulp(8)),
    ("glass", glass, {"cosine": (0.05, 1.0)}, sh.accuracy.Budget(0.3, "relative")),
)


def kernels(mesh: Mesh, quick: bool) -> Table:
    """Return six kernels, each with its error budget."""
    del mesh
    rows = [_kernel(*arguments, quick) for arguments in KERNELS]
    note = "The pick of `sh.accuracy.tradeoff` for a budget, on 100,000 elements that it has not seen."
    return Table("budgets", note, ("kernel", "budget", "pick", "keeps it", "time over the fastest's"), rows)


def _kernel(name: str, program: Any, domain: dict[str, Range], budget: Any, quick: bool) -> Sequence[str]:
    count = 1_000 if quick else 100_000
    tradeoff = sh.accuracy.tradeoff(
        program, domain, budget, samples=200 if quick else 1000, elements=count, reference="f64" if quick else "mpmath"
    )
    pick = tradeoff.pick
    inputs = _drawn(domain, count)
    first = program.picked() if isinstance(program, type(glass)) else program
    exact = (first if isinstance(first, sh.Program) else sh.program(first)).compile("numpy", precision="f64")(*inputs)

    def share(candidate: Any) -> float:
        return _kept(candidate.kernel(*inputs), exact, budget)

    good = [c for c in tradeoff.candidates if c is pick or (c.error <= budget.limit and share(c) >= 0.999)]
    seconds = _in_turns([partial(c.kernel, *inputs) for c in good], 2 if quick else ROUNDS)
    slower = seconds[good.index(pick)] / min(seconds)
    return name, str(budget), str(pick), f"{share(pick):.3%}", f"{slower:.2f}"


def _drawn(domain: dict[str, Range], count: int) -> list[np.ndarray]:
    """Draw `count` elements of the domain at random, in binary32."""
    rng = np.random.default_rng(SEED)
    drawn = []
    for low, high, *log in domain.values():
        ends = np.log([low, high]) if log else (low, high)
        numbers = rng.uniform(*ends, count)
        drawn.append(np.clip(np.exp(numbers) if log else numbers, low, high).astype(np.float32))
    return drawn


def _kept(outputs: Any, exact: Any, budget: Any) -> float:
    """Return the share of elements all of whose outputs keep the budget."""
    measure = {"ulp": sh.accuracy.ulp, "relative": sh.accuracy.relative}[budget.unit]
    pairs = zip(*(a if isinstance(a, tuple) else (a,) for a in (outputs, exact)), strict=True)
    kept = [measure(np.asarray(f).astype(np.float32), e) <= budget.limit for f, e in pairs]
    return float(np.mean(np.all(kept, axis=0)))


def _in_turns(runs: Sequence[Callable[[], Any]], rounds: int) -> list[float]:
    """Return the median seconds of each run. Runs take turns, each after a warm-up call; short runs are repeated."""
    timings: list[list[float]] = [[] for _ in runs]
    for _ in range(rounds):
        for run, seconds in zip(runs, timings, strict=True):
            calls = max(1, int(0.01 / once(run)))
            seconds.append(sum(once(run) for _ in range(calls)) / calls)
    return [float(np.median(seconds)) for seconds in timings]


def scenes(mesh: Mesh, quick: bool) -> Table:
    """Return two built-in scenes and a mesh on a mirror."""
    cases = [("boxes", Scene.builtin("boxes"), 1.0), ("mirror-box", Scene.builtin("mirror-box"), 4.0)]
    cases.append((f"{mesh.name} on a mirror", scene_of(mesh), 2.0))
    rows = [_scene(*one, quick) for one in cases[: 1 if quick else None]]
    note = (
        f"The pick of `raytracer tradeoff` on {backend()} for a root mean square error in 255ths, on {CAMERAS} "
        "pictures from elsewhere."
    )
    return Table("scenes within", note, ("scene", "budget", "pick", "keeps it", "time over the fastest's"), rows)


def _scene(name: str, scene: Scene, limit: float, quick: bool) -> Sequence[str]:
    bounces = 1 if quick else 3
    tradeoff = trade.tradeoff(scene, max_error=limit, backend=backend(), bounces=bounces)
    angles = [360 * (k + 0.5) / CAMERAS for k in range(2 if quick else CAMERAS)]
    cameras = [trade.turned(scene.camera, angle, 1.1 if k % 2 else 0.9) for k, angle in enumerate(angles)]
    reference = trade.reference(scene, backend(), bounces)
    exact = [reference.render(trade.SIZE, camera=camera) for camera in cameras]

    def renderer(candidate: trade.Candidate) -> Renderer:
        return Renderer(scene, backend=backend(), **asdict(candidate.variant))

    def kept(one: Renderer) -> int:
        pictures = [one.render(trade.SIZE, camera=camera) for camera in cameras]
        return sum(trade.errors(p, e)["rmse"] <= limit for p, e in zip(pictures, exact, strict=True))

    good = [c for c in tradeoff.candidates if c.worst <= limit]
    renderers = [renderer(c) for c in good]
    seconds = _in_turns([partial(one.render, trade.SIZE) for one in renderers], 2 if quick else ROUNDS)
    at = good.index(tradeoff.pick)
    share = f"{kept(renderers[at])} of {len(cameras)}"
    return name, f"{limit:g}/255", str(tradeoff.pick.variant), share, f"{seconds[at] / min(seconds):.2f}"


STUDIES: dict[str, Callable[[Mesh, bool], Table]] = {"budgets": kernels, "scenes-within": scenes}
