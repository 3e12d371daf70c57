"""A picture of measurements: for each work a bar for each contender, how many times as long as ours it took.

draw(results, "bench.png")
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmarks.report import base_of, label, spread
from benchmarks.rounds import Measured
from shpy.files import replacing
from shpy.outputs import new_figure


def draw(results: Sequence[Measured], path: Path) -> None:
    """Write the picture; ShpyError without matplotlib."""
    figure = new_figure(8, 0.6 + sum(0.5 + 0.22 * len(m.seconds) for m in results))
    axes = figure.subplots(len(results), 1, squeeze=False, height_ratios=[2 + len(m.seconds) for m in results])
    for axis, measured in zip(axes[:, 0], results, strict=True):
        base = base_of(measured)
        quartiles = {name: spread(measured.ratios(name, base)) for name in measured.seconds}
        names = [label(name) for name in quartiles]
        middles = [q[0] for q in quartiles.values()]
        whiskers = [[q[0] - q[1] for q in quartiles.values()], [q[2] - q[0] for q in quartiles.values()]]
        colors = ["#c2571a" if n.startswith("shpy") else "#5a7d9a" for n in names]
        axis.barh(names, middles, xerr=whiskers, color=colors, error_kw={"linewidth": 0.8})
        axis.set_xscale("log")
        axis.axvline(1, color="black", linewidth=0.8)
        axis.invert_yaxis()
        axis.set_title(f"{measured.work.name}: time as a multiple of {label(base)}", fontsize=9, loc="left")
        axis.tick_params(labelsize=8)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120)
