"""The staged tracer: kernels over streams of rays, run one after the other by a host that sees only how many wrote.

Stage: render. Christen 2005, section 5.6. In each round every ray is followed to its end, then all are shaded at once,
which makes the rays of the next round: those to a light, or the mirrored ones. Within a round the traverser and the
intersector take turns: the intersector runs once the share `threshold` of the rays on their way waits for it.
Rays that have become few are copied to streams of their own. In the thesis each call goes over all rays, and a pass
before it sets depths, so that the depth test rejects the rays that the kernel does not need: so it is with `early_z`.

    staged = StagedTracer(tracer, rays, backend="opencl", threshold=0.2)
    pixel = staged.trace((256, 256))        # the arrays of a Pixel
    staged.log.calls                        # {"generate": 1, "traverse": 31, ...}
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import shpy as sh
from raytracer.kernels import stages
from raytracer.kernels.eye_rays import EyeRays, PanoramaRays
from raytracer.kernels.pixel import Pixel
from raytracer.kernels.tracer import Light, Ray, Tracer

SPARSE = 1 / 4
"""Share of the rays of a band that are on their way, below which they are copied to streams of their own."""
LEAST = 1 << 10
"""Rays of a band that are too few for that: a call takes as long for one ray."""
_STREAMS: dict[str, Any] = {
    "ray": Ray, "light": Light, "cell": stages.Cell, "items": stages.Items,
    "nearest": stages.Nearest, "state": sh.Attrib1i,
}  # fmt: skip
_LAYERS = Pixel(sh.Color3f, sh.Attrib1f, sh.Normal3f, sh.Attrib1i, sh.Attrib1i)  # type: ignore[arg-type]


@dataclass
class Log:
    """Counts of a picture: `calls` of each stage; of each round, the rays at its start and its seconds.

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
    With `early_z` a pass before each stage makes the mask of the rays that need it: see `_masked`. `kernels` are those
    of the stages by name; `params` are the uniforms of the eye rays; `clock` gives the seconds of the log; `compacts`
    says whether kernels run over the rays on their way alone once these are few.
    """

    def __init__(
        self,
        tracer: Tracer,
        rays: EyeRays | PanoramaRays,
        *,
        backend: str,
        threshold: float,
        early_z: bool = False,
        precision: str = "f32",
        math: str = "strict",
        fuse: bool = False,
    ) -> None:
        self.threshold = threshold
        self.log = Log()
        self.compacts = not early_z
        self.clock: Callable[[], float] = time.perf_counter
        self.programs = stages.programs(tracer, rays)
        self._streams = _STREAMS | {"point": tracer.surfaces.interaction, "light": tracer.light_struct}
        self.params = self.programs["generate"].params
        self._place: dict[str, Any] = {"backend": backend, "precision": precision}
        options = {**self._place, "math": math, "fuse": fuse}
        # No loop limit: a stage visits at most `at_once` cells or triangles.
        self.kernels = {name: program.compile(**options, loop_limit=None) for name, program in self.programs.items()}
        masks = stages.MASKS if early_z else {}
        self._masks = {name: late.program.compile(**options) for name, late in masks.items()}

    @property
    def at_once(self) -> Any:
        """The Param that says through how many cells or triangles a ray goes in one call; the thesis has 1."""
        return self.programs["traverse"].params["at_once"]

    def trace(self, shape: tuple[int, int]) -> Any:
        """Trace a band of `shape` = (height, width); return its layers as arrays in a Pixel. The log goes on."""
        streams = {name: sh.Stream.empty(shape, type_, **self._place) for name, type_ in self._streams.items()}
        layers = Pixel(*(sh.Stream.empty(shape, type_, **self._place) for type_ in _LAYERS))  # type: ignore[arg-type]
        band = {**streams, **layers._asdict()}
        self._run("generate", band)
        self._rounds(band, 0, self._placed(band))
        return Pixel(*(np.asarray(layer) for layer in layers))  # type: ignore[arg-type]

    def _rounds(self, band: dict[str, Any], round: int, rays: int) -> None:
        """Follow and shade `rays` rays, and those that come of them, until there are none."""
        while rays:
            if self._is_sparse(band, rays):
                few, index = self._dense(band, "unfinished", [*self._streams, *_LAYERS._fields])
                self._rounds(few, round, rays)
                for name in _LAYERS._fields:
                    sh.scatter(few[name], index, out=band[name])
                return
            started = self.clock()
            self._follow(band)
            self._run("shade", band)
            left = self._placed(band)
            self.log.add(round, rays, self.clock() - started)
            round, rays = round + 1, left

    def _placed(self, band: dict[str, Any]) -> int:
        """Place rays in the grid, and let them try the objects that move beside it; return the number of rays."""
        rays: int = self._run("precalculate", band).count
        if "objects" in self.programs:
            self._run("objects", band)
        return rays

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
            if self._is_sparse(band, on_their_way):
                few, index = self._dense(band, "moving", ["ray", "cell", "items", "nearest", "state"])
                if few["state"].size:
                    self._follow(few)
                    for name in ("nearest", "state"):
                        sh.scatter(few[name], index, out=band[name])
                return

    def _is_sparse(self, band: dict[str, Any], rays: int) -> bool:
        """Return whether so few rays of a band are left that calls over them alone are worth the copies."""
        return bool(self.compacts and rays <= band["state"].size * SPARSE and band["state"].size > LEAST)

    def _dense(self, band: dict[str, Any], chosen: str, names: Sequence[str]) -> tuple[dict[str, Any], Any]:
        """Copy the rays that the kernel `chosen` selects to shorter streams; return these and the rays' indices."""
        self.log.calls["compact"] += 1
        state, index = sh.compact(band["state"], self._run(chosen, band).outputs)
        few = {name: state if name == "state" else sh.gather(band[name], index) for name in names}
        return few, index

    def _run(self, stage: str, band: dict[str, Any]) -> sh.Result:
        """Start a stage, whose inputs and outputs are the streams of their names."""
        self.log.calls[stage] += 1
        program, kernel = self.programs[stage], self.kernels[stage]
        written = stages.WRITES.get(stage)
        out = written and {name: _stream(band, name) for name in written}
        inputs = {name: _stream(band, name) for name in program.inputs}
        if stage in self._masks:
            inputs["where"] = self._masked(stage, band)
        result: sh.Result = kernel.run(**inputs, out=out)
        return result

    def _masked(self, stage: str, band: dict[str, Any]) -> Any:
        """Return the mask of the rays that a stage needs, by a pass of early-z culling.

        Where kernels are fragment programs, the mask becomes a depth, and the depth test keeps the other rays'
        fragments from running; other backends skip the rays in their own ways.
        """
        self.log.calls["mask"] += 1
        if "mask" not in band:
            band["mask"] = sh.Stream.empty(band["state"].shape, sh.Attrib1b, **self._place)
        self._masks[stage].run(band["state"], out=band["mask"])
        return band["mask"]


def _stream(band: dict[str, Any], name: str) -> Any:
    return {layer: band[layer] for layer in _LAYERS._fields} if name == "pixel" else band[name]
