"""The plot of a trade-off: colour by series, marker by mode, the frontier with its points labelled.

Stage: measure. Draws a `Comparison` into an empty figure of matplotlib.

    draw(comparison, figure)

The points of a frontier fall from the upper left to the lower right, and the area below it is empty: there the labels
stand.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Final

from shpy.accuracy.pareto import Comparison, Point
from shpy.passes.modes import CONTRACTIONS

_MARKERS: Final = "os^DvP*X"
_SERIES: Final = ("numpy", "opencl", "glsl")
_GAP: Final = 9.0
"""Points between a label and its marker."""
_FARTHEST: Final = 100
"""The largest power of ten of an error, up or down, that is drawn in its place."""


def draw(comparison: Comparison, figure: Any) -> None:
    """Draw time against error, both on logarithmic scales, with a legend outside of the data."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axes = figure.add_subplot()
    axes.set(xscale="log", yscale="log", xlabel=comparison.time, ylabel=comparison.error, title=comparison.title)
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.grid(which="major", color="0.92")
    axes.set_axisbelow(True)
    low, high = _places(comparison)

    def place(error: float) -> float:
        return min(max(error, low), high)

    handles = _draw_points(comparison, axes, place)
    _draw_lines(comparison, axes, place)
    legend = figure.legend(handles=handles, loc="outside right upper", fontsize=9, frameon=False, alignment="left")
    for text in legend.get_texts():
        text.set_fontweight("bold" if text.get_text() in (comparison.series, comparison.mode) else "normal")
    _label(comparison, axes, place, figure)


def _places(comparison: Comparison) -> tuple[float, float]:
    """Return the heights at which no error and an infinite one are drawn: a decade below and above all others."""
    errors = (*(p.error for p in comparison.points), comparison.limit)
    sizes = [math.log10(e) for e in errors if 0 < e < math.inf] or [0.0]
    return 10.0 ** max(math.floor(min(sizes) - 1), -_FARTHEST), 10.0 ** min(math.ceil(max(sizes) + 1), _FARTHEST)


def _draw_points(comparison: Comparison, axes: Any, place: Any) -> list[Any]:
    """Draw every point with the quartiles of its time; return the entries of the legend."""
    series = _in_order({p.series for p in comparison.points}, _SERIES)
    modes = _in_order({p.mode for p in comparison.points}, tuple(CONTRACTIONS))
    colours = {name: f"C{n % 10}" for name, n in series.items()}
    markers = {name: _MARKERS[n % len(_MARKERS)] for name, n in modes.items()}
    for n, p in enumerate(comparison.points):
        height, colour = place(p.error), colours[p.series]
        if n in comparison.front:
            axes.plot(p.spread, (height, height), color=colour, linewidth=3, alpha=0.4, solid_capstyle="butt")
        axes.plot(
            p.time, height, markers[p.mode], color=colour, markersize=7, markeredgecolor="white", markeredgewidth=0.7
        )
    entry = _entries()
    handles = [entry(comparison.series, None)]
    handles += [entry(name, dict(marker="o", color=colours[name])) for name in series]
    if len(modes) > 1:
        handles += [entry(" ", None), entry(comparison.mode, None)]
        handles += [entry(name, dict(marker=markers[name], color="0.4")) for name in modes]
    handles += [entry(" ", None), entry("frontier", dict(color="0.6", linestyle="-"))]
    handles += [entry(comparison.budget, dict(color="0.2", linestyle="--"))]
    handles += [entry("quartiles of its times", dict(color="0.7", linewidth=3, linestyle="-"))]
    if comparison.picked is not None:
        handles += [entry("pick", dict(marker="o", markersize=12, color="black", fillstyle="none"))]
    return handles


def _entries() -> Any:
    """Return a function that makes an entry of the legend; a heading without a style."""
    from matplotlib.lines import Line2D

    def entry(label: str, style: dict[str, Any] | None) -> Any:
        return Line2D([], [], **({"linestyle": ""} | (style or {})), label=label)

    return entry


def _in_order(names: Iterable[str], usual: tuple[str, ...]) -> dict[str, int]:
    """Return a number for each name; if one is in `usual`, all usual names keep their numbers."""
    every = [*(usual if set(names) & set(usual) else ()), *sorted(set(names) - set(usual))]
    return {name: n for n, name in enumerate(every) if name in names}


def _draw_lines(comparison: Comparison, axes: Any, place: Any) -> None:
    """Draw the frontier as steps, the budget, the errors that have no logarithm, and a ring around the pick."""
    front = [comparison.points[n] for n in comparison.front]
    axes.plot([p.time for p in front], [place(p.error) for p in front], color="0.6", drawstyle="steps-post", zorder=1.5)
    axes.axhline(place(comparison.limit), color="0.2", linewidth=1, linestyle="--")
    for error, name in ((0.0, "exact"), (math.inf, "infinite")):
        if any(p.error == error for p in comparison.points):
            axes.axhline(place(error), color="0.8", linewidth=0.8, linestyle=(0, (1, 3)))
            axes.text(
                1.005, place(error), name, transform=axes.get_yaxis_transform(), va="center", fontsize=8, color="0.4"
            )
    if comparison.picked is not None:
        p = comparison.points[comparison.picked]
        axes.plot(p.time, place(p.error), "o", color="black", fillstyle="none", markersize=12)


def _label(comparison: Comparison, axes: Any, place: Any, figure: Any) -> None:
    """Write the names of the frontier to the left of its points, each below the one before."""
    front = [(comparison.points[n], n == comparison.picked) for n in comparison.front]
    texts = [
        axes.annotate(
            p.label,
            (p.time, place(p.error)),
            xytext=(-_GAP, 0),
            textcoords="offset points",
            ha="right",
            va="center",
            fontsize=8,
            fontweight="bold" if picked else "normal",
            arrowprops=dict(arrowstyle="-", color="0.5", linewidth=0.6, relpos=(1, 0.5), shrinkA=0, shrinkB=4),
            bbox=dict(boxstyle="round,pad=0.15", color="white", alpha=0.8, linewidth=0),
        )
        for p, picked in front
    ]
    for text in texts:
        text.set_in_layout(False)
    for _ in range(3):  # room for the labels moves the points
        figure.draw_without_rendering()
        _make_room(axes, [p for p, _ in front], texts)
        figure.draw_without_rendering()
        _spread_out(axes, front, place, texts)
    axes.axhspan(place(comparison.limit), axes.get_ylim()[1], color="0.96", zorder=0)


def _extent(text: Any) -> Any:
    """Return the bounding box of a label in pixels, without the line from the label to its point."""
    from matplotlib.text import Text

    return Text.get_window_extent(text)


def _make_room(axes: Any, front: list[Point], texts: list[Any]) -> None:
    """Move the left and lower end of the axes so that the labels fit."""
    box = axes.get_window_extent()
    extents = [_extent(text) for text in texts]
    left, right = (math.log10(v) for v in axes.get_xlim())
    for p, extent in zip(front, extents, strict=True):
        share = min((extent.width + 2 * _GAP * texts[0].figure.dpi / 72) / box.width, 0.8)
        left = min(left, (math.log10(p.time) - share * right) / (1 - share))
    bottom, top = (math.log10(v) for v in axes.get_ylim())
    below = min(extent.y0 for extent in extents) - box.y0 - _GAP
    if below < 0:
        bottom += below / box.height * (top - bottom)
    axes.set(xlim=(10**left, 10**right), ylim=(10**bottom, 10**top))


def _spread_out(axes: Any, front: list[tuple[Point, bool]], place: Any, texts: list[Any]) -> None:
    """Move each label below the one before, as far as it takes for none to cover another."""
    points = texts[0].figure.dpi / 72
    ceiling = math.inf
    for (p, _), text in zip(front, texts, strict=True):
        height = _extent(text).height
        own = float(axes.transData.transform((p.time, place(p.error)))[1])
        middle = min(own, ceiling - height / 2)
        text.xyann = (-_GAP, (middle - own) / points)
        ceiling = middle - height / 2
