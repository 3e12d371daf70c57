"""Roundings: the lines of a program by their share of its error, and the condition of each input.

Stage: measure. Takes a program of one float and a domain, gives `Roundings`.

    print(sh.accuracy.roundings(root, {"b": (1, 100), "c": (0.1, 1)}))

Reverse mode computes the derivative of the result by each intermediate value. A rounding changes that value by half a
unit in the last place at most, so |derivative * value| * 2**-24 bounds its effect, to the first order (ADAPT, Menon et
al. 2018; CHEF-FP, Vassiliev and Vassilev 2022).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.accuracy.domain import Domain, draw
from shpy.errors import Loc, ShpyTypeError
from shpy.gradients.calls import reverse_call
from shpy.lang.programs.inline import call_recorded
from shpy.lang.programs.joined import rerecorded
from shpy.lang.programs.outline import outlined
from shpy.lang.recording.location import here
from shpy.lang.recording.text import written
from shpy.lang.values import arithmetic
from shpy.lang.values.structure import Layout, flatten, leaves
from shpy.programs import Program, check_count

Array = NDArray[Any]


@dataclass(frozen=True)
class RoundingLine:
    """A line of the program: its share of the error's bound, 0 to 1, in the mean over the elements."""

    loc: Loc | None
    share: float

    @property
    def text(self) -> str:
        """The user's text, where it can be read."""
        return written(self.loc)


@dataclass(frozen=True)
class Roundings:
    """The lines of a program, the greatest share first, and the condition of each input.

    `conditions` has for each leaf of an input the median and the largest condition number: by how much a relative error
    of the input grows in the result. `values` are the results in binary64, (n,); `bounds` are the most that all
    roundings at f32 may change each by, to the first order, (n,); `inputs` are the elements, by leaf.
    """

    program: str
    lines: tuple[RoundingLine, ...]
    conditions: dict[str, tuple[float, float]]
    values: Array = field(repr=False)
    bounds: Array = field(repr=False)
    inputs: dict[str, Array] = field(repr=False)

    def __str__(self) -> str:
        with np.errstate(all="ignore"):
            ulps = np.abs(self.bounds / np.spacing(np.abs(self.values).astype(np.float32)))
        kept = ulps[np.isfinite(ulps)]
        size = f"{np.median(kept):.3g} ULP in the median, {np.max(kept):.3g} at most" if kept.size else "unknown"
        rows = [f"{self.program}: roundings at f32 may change the result by {size}"]
        rows += [f"  {line.share:6.1%}  {line.loc}: {line.text}".rstrip() for line in self.lines if line.share >= 5e-4]
        rows.append("condition of each input (median, largest)")
        rows += [f"  {name}: {median:.3g}, {largest:.3g}" for name, (median, largest) in self.conditions.items()]
        return "\n".join(rows)


def roundings(
    program: Program,
    domain: Domain,
    *,
    output: str | None = None,
    samples: int = 2000,
    seed: int = 0,
    most: int | None = None,
) -> Roundings:
    """Return the lines of a program by their share of the error of its result, and the condition of each input.

    The result is one float, of several outputs the one called `output`. `domain` is that of `measure`, without special
    values. `most` is the number of iterations that are kept of a loop without a known bound, as in `sh.gradient`.

    Raises ShpyTypeError for a result of another type and for a domain that does not fit, RecordError for a loop without
    a bound.
    """
    drawn = draw(program, domain, samples, np.random.default_rng(seed), special=False)
    check_count("seed", seed, 0)
    leaf = _leaf_of(program, output)
    derived, names, lines = _derived(program, leaf, most)
    results = derived.compile("numpy", precision="f64").run(*drawn.inputs).outputs
    columns: dict[str, Array] = {
        name: np.broadcast_to(np.asarray(x, np.float64), (drawn.count, *np.shape(x)[1:])) for name, x in results.items()
    }
    value = columns["value"]
    bounds = np.stack([columns[f"line_{k}"] for k in range(len(lines))]) if lines else np.zeros((1, drawn.count))
    total = bounds.sum(axis=0)
    counted = np.isfinite(total) & (total > 0)
    shares = (bounds[:, counted] / total[counted]).mean(axis=1) if counted.any() else np.zeros(len(bounds))
    order = [RoundingLine(loc, float(share)) for loc, share in zip(lines, shares, strict=False)]
    conditions = {}
    for k, name in enumerate(names):
        change = np.abs(columns[f"d_{k}"] * drawn.leaves[name])
        with np.errstate(all="ignore"):
            condition = (change.sum(axis=-1) if change.ndim > 1 else change) / np.abs(value)
        condition = condition[np.isfinite(condition)]
        conditions[name] = (float(np.median(condition)), float(np.max(condition))) if condition.size else (0.0, 0.0)
    ordered = tuple(sorted(order, key=lambda line: -line.share))
    return Roundings(program.name, ordered, conditions, value, total, drawn.leaves)


def _leaf_of(program: Program, output: str | None) -> int:
    """Return the number of the output's leaf, which is one float."""
    outputs = program.outputs
    names = [n for n, cls in outputs.items() if cls.size == 1 and cls.type.is_float]
    if output in names or (output is None and len(outputs) == len(names) == 1):
        return list(outputs).index(output if output is not None else names[0])
    what = f"output={output!r}" if output is not None else f"the outputs of {program.name}"
    raise ShpyTypeError(
        f"sh.accuracy.roundings takes an output of one float, not {what}",
        loc=here(),
        cure=" or ".join(f"output={n!r}" for n in names) or "a program that returns one component, as in v.x",
    )


def _derived(program: Program, leaf: int, most: int | None) -> tuple[Program, list[str], list[Loc | None]]:
    """Return the program of the value, its derivatives and the errors of lines; the names of inputs; the lines."""
    recorded = program.recorded
    moving = [
        n
        for n, layout in recorded.inputs.items()
        if isinstance(layout, Layout) and all(cls.type.is_float for _, _, cls in leaves(layout, n))
    ]
    if not moving:
        raise ShpyTypeError(f"{program.name} has no input of floats", loc=here(), cure="x: sh.Attrib1f")
    names = [path for n in moving for path, _, _ in leaves(recorded.inputs[n], n)]  # type: ignore[arg-type]
    lines: list[Loc | None] = []

    def result(**arguments: Any) -> Any:
        return flatten(recorded.output, call_recorded(recorded, arguments), "the result")[leaf]

    def body(arguments: Mapping[str, Any]) -> Any:
        outline = outlined("sh.accuracy.roundings", result, [], arguments, moving)
        handles, found = reverse_call(outline, None, [0], most, rounding=True)
        lines[:] = found
        types = [outline.function.outputs[0].type, *(v.type for m in outline.moved for v in m.inputs)]
        types += [outline.function.outputs[0].type.scalar] * len(found)
        keys = ["value", *(f"d_{k}" for k in range(len(names))), *(f"line_{k}" for k in range(len(found)))]
        values = [arithmetic.make_value("Attrib", t, outline.frame, h) for t, h in zip(types, handles, strict=True)]
        return dict(zip(keys, values, strict=True))

    again = rerecorded(f"{program.name}_roundings", recorded, recorded.inputs, None, body, recorded.defaults)
    return Program(again), names, lines
