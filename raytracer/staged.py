"""The staged tracer: kernels over streams of rays, run one after the other by a host that sees only how many wrote.

Stage: render. Christen 2005, section 5.6. In each round every ray is followed to its end, then all are shaded at once,
which makes the rays of the next round: those to a light, or the mirrored ones. Within a round the traverser and the
intersector take turns: the intersector runs once the share `threshold` of the rays on their way waits for it.

    staged = StagedTracer(tracer, rays, backend="opencl", threshold=0.2)
    pixel = staged.trace((256, 256))        # the arrays of a Pixel
    staged.log.calls                        # {"generate": 1, "traverse": 31, ...}
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import shpy as sh
from raytracer.kernels import stages
from raytracer.kernels.tracer import EyeRays, Pixel, Tracer

__all__ = ["Log", "StagedTracer"]

_STREAMS: dict[str, Any] = {
    "ray": stages.Ray, "light": stages.Light, "point": stages.Point, "cell": stages.Cell, "items": stages.Items,
    "nearest": stages.Nearest, "state": sh.Attrib1i,
}  # fmt: skip
_LAYERS = Pixel(sh.Color3f, sh.Attrib1f, sh.Normal3f, sh.Attrib1i, sh.Attrib1i)  # type: ignore[arg-type]


@dataclass
class Log:
    """What the host saw: `calls` of each stage, and of each round how many rays it began with and what it took.

    Rays to lights count too. A round's `seconds` end when the next one's rays are counted.
    """

    calls: Counter[str] = field(default_factory=Counter)
    alive: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def add(self, round: int, rays: int, seconds: float) -> None:
        """Add one round of a band."""
        if round == len(self.alive):
            self.alive.append(0)
            self.seconds.append(0.0)
        self.alive[round] += rays
        self.seconds[round] += seconds


class StagedTracer:
    """The compiled stages of a tracer whose accelerator is a grid.

    `threshold`, from 0 to 1, is the share of the rays on their way that must wait before the intersector runs.
    `params` are the uniforms of the eye rays; `clock` gives the seconds of the log.
    """

    def __init__(
        self,
        tracer: Tracer,
        rays: EyeRays,
        *,
        backend: str,
        threshold: float,
        precision: str = "f32",
        math: str = "strict",
    ) -> None:
        self.threshold = threshold
        self.log = Log()
        self.clock: Callable[[], float] = time.perf_counter
        self.programs = stages.programs(tracer, rays)
        self.params = self.programs["generate"].params
        self._place: dict[str, Any] = {"backend": backend, "precision": precision}
        # No budget of iterations: a stage goes through `at_once` cells or triangles and no more.
        self._kernels = {
            name: program.compile(**self._place, math=math, loop_limit=None) for name, program in self.programs.items()
        }

    @property
    def at_once(self) -> Any:
        """The Param that says through how many cells or triangles a ray goes in one call; the thesis has 1."""
        return self.programs["traverse"].params["at_once"]

    def trace(self, shape: tuple[int, int]) -> Any:
        """The layers of a band of `shape` = (height, width), as arrays in a Pixel; the log goes on."""
        streams = {name: sh.Stream.empty(shape, type_, **self._place) for name, type_ in _STREAMS.items()}
        layers = Pixel(*(sh.Stream.empty(shape, type_, **self._place) for type_ in _LAYERS))  # type: ignore[arg-type]
        band = {**streams, "pixel": layers}
        self._run("generate", band)
        round, rays = 0, self._run("precalculate", band).count
        while rays:
            started = self.clock()
            self._follow(band)
            self._run("shade", band)
            left = self._run("precalculate", band).count
            self.log.add(round, rays, self.clock() - started)
            round, rays = round + 1, left
        return Pixel(*(np.asarray(layer) for layer in layers))  # type: ignore[arg-type]

    def _follow(self, band: dict[str, Any]) -> None:
        """Run traverser and intersector until no ray is on its way."""
        waiting = self._run("waiting", band).count
        while True:
            on_their_way = waiting + self._run("traverse", band).count
            waiting = self._run("waiting", band).count
            if not on_their_way:
                return
            # With `>` a threshold of 1 would never be reached.
            if waiting and waiting >= self.threshold * on_their_way:
                self._run("intersect", band)
                waiting = self._run("waiting", band).count

    def _run(self, stage: str, band: dict[str, Any]) -> sh.Result:
        """Start a stage, whose inputs and outputs are the streams of their names."""
        self.log.calls[stage] += 1
        program, kernel = self.programs[stage], self._kernels[stage]
        given = {name: band[name] for name in program.inputs}
        written = stages.WRITES.get(stage)
        result: sh.Result = kernel.run(**given, out=written and {name: band[name] for name in written})
        return result
