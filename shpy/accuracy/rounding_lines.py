"""Roundings: the lines of a program by their share of its error, and the condition of each input.

Stage: measure. Takes a program of one float and a domain, gives `Roundings`.

    print(sh.accuracy.roundings(root, {"b": (1, 100), "c": (0.1, 1)}))

Reverse mode computes the derivative of the result by each intermediate value. A rounding changes that value by half a
unit in the last place at most, so |derivative * value| * 2**-24 bounds its effect, to the first order (ADAPT, Menon et
al. 2018; CHEF-FP, Vassiliev and Vassilev 2022).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.accuracy.domain import Domain, Samples, draw
from shpy.accuracy.stable_forms import StableForm, stable_forms
from shpy.errors import Loc, ShpyTypeError
from shpy.gradients.calls import reverse_call
from shpy.lang.programs.inline import call_recorded
from shpy.lang.programs.joined import rerecorded
from shpy.lang.programs.outline import outlined
from shpy.lang.programs.record import RecordedProgram
from shpy.lang.recording.location import here
from shpy.lang.recording.text import written
from shpy.lang.values import arithmetic
from shpy.lang.values.structure import Layout, flatten, leaves
from shpy.passes.pipeline import optimise
from shpy.programs import Program, check_count

Array = NDArray[Any]


ENOUGH = 4.0
"""ULP; a program whose results change by at most this much needs no other form."""
_TRIES = 8
"""The most forms that are measured; each takes about as long as the report without forms."""


@dataclass(frozen=True)
class RoundingLine:
    """A line of the program: its share of the error's bound, 0 to 1, in the mean over the elements.

    `forms` are expressions, `new`, that lose fewer digits than those of the line, `old`.
    """

    loc: Loc | None
    share: float
    forms: tuple[StableForm, ...] = ()

    @property
    def text(self) -> str:
        """The user's text, where it can be read."""
        return written(self.loc)


@dataclass(frozen=True)
class Roundings:
    """The lines of a program, the greatest share first, and the condition of each input.

    `conditions` has for each leaf of an input the median and the largest condition number: by how much a relative error
    of the input grows in the result. `values` are the results in binary64, (n,); `bounds` are the most that all
    roundings at f32 may change each by, to the first order, (n,); `inputs` are the elements, by leaf. `better` are the
    bounds of the program with the forms of the lines, (n,); None without forms.
    """

    program: str
    lines: tuple[RoundingLine, ...]
    conditions: dict[str, tuple[float, float]]
    values: Array = field(repr=False)
    bounds: Array = field(repr=False)
    inputs: dict[str, Array] = field(repr=False)
    better: Array | None = field(default=None, repr=False)

    def __str__(self) -> str:
        rows = [f"{self.program}: roundings at f32 may change the result by {_spoken(self.values, self.bounds)}"]
        for line in self.lines:
            if line.share >= 5e-4 or line.forms:
                rows.append(f"  {line.share:6.1%}  {line.loc}: {line.text}".rstrip())
            rows += [f"          write {form.new} for {form.old}" for form in line.forms]
        if self.better is not None:
            rows.append(f"  so written, roundings may change it by {_spoken(self.values, self.better)}")
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
    values. `most` is the number of iterations that are kept of a loop without a known bound, as in `sh.gradient`. A
    line that cancels has `forms` where those of `stable_forms` have the same values and a smaller bound on the domain.

    Raises ShpyTypeError for a result of another type and for a domain that does not fit, RecordError for a loop without
    a bound.
    """
    drawn = draw(program, domain, samples, np.random.default_rng(seed), special=False)
    check_count("seed", seed, 0)
    leaf = _leaf_of(program, output)

    def study(recorded: RecordedProgram) -> _Study:
        return _study(program.name, recorded, leaf, most, drawn)

    first = study(program.recorded)
    forms, better = _forms(program.recorded, first, study)
    counted = np.isfinite(first.total) & (first.total > 0)
    shares = (
        (first.errors[:, counted] / first.total[counted]).mean(axis=1) if counted.any() else np.zeros(len(first.lines))
    )
    lines = {loc: float(share) for loc, share in zip(first.lines, shares, strict=True)}
    lines = {form.loc: 0.0 for form in forms} | lines
    ordered = sorted(lines, key=lambda loc: -lines[loc])
    return Roundings(
        program.name,
        tuple(RoundingLine(loc, lines[loc], tuple(f for f in forms if f.loc == loc)) for loc in ordered),
        _conditions(first, drawn),
        first.value,
        first.total,
        drawn.leaves,
        better.total if forms else None,
    )


@dataclass(frozen=True)
class _Study:
    """The values of a program at f64, (n,), its derivatives by the leaves of inputs, the errors of lines, (k, n)."""

    value: Array
    derivatives: dict[str, Array]
    lines: list[Loc | None]
    errors: Array

    @cached_property
    def total(self) -> Array:
        """The bounds, (n,)."""
        return np.asarray(self.errors.sum(axis=0))


def _study(name: str, recorded: RecordedProgram, leaf: int, most: int | None, drawn: Samples) -> _Study:
    derived, names, lines = _derived(name, recorded, leaf, most)
    results = derived.compile("numpy", precision="f64").run(*drawn.inputs).outputs
    columns: dict[str, Array] = {
        name: np.broadcast_to(np.asarray(x, np.float64), (drawn.count, *np.shape(x)[1:])) for name, x in results.items()
    }
    errors = [columns[f"line_{k}"] for k in range(len(lines))]
    derivatives = {name: columns[f"d_{k}"] for k, name in enumerate(names)}
    return _Study(columns["value"], derivatives, lines, np.reshape(errors, (len(lines), drawn.count)))


def _conditions(study: _Study, drawn: Samples) -> dict[str, tuple[float, float]]:
    """Return the median and the largest condition of each leaf of an input."""
    conditions = {}
    for name, derivative in study.derivatives.items():
        change = np.abs(derivative * drawn.leaves[name])
        with np.errstate(all="ignore"):
            condition = (change.sum(axis=-1) if change.ndim > 1 else change) / np.abs(study.value)
        condition = condition[np.isfinite(condition)]
        conditions[name] = (float(np.median(condition)), float(np.max(condition))) if condition.size else (0.0, 0.0)
    return conditions


def _forms(
    recorded: RecordedProgram, first: _Study, study: Callable[[RecordedProgram], _Study]
) -> tuple[list[StableForm], _Study]:
    """Return the forms that lower the bound, in the order in which they do, and the study of the program with them."""
    forms: list[StableForm] = []
    module, best, tries = optimise(recorded.module, fixed=False), first, 0
    while _ulps(best.value, best.total).max(initial=0) > ENOUGH:
        better: list[tuple[float, _Study, StableForm]] = []
        for form in stable_forms(module):
            if better and (form.loc, form.old) != (better[0][2].loc, better[0][2].old):
                break
            if tries < _TRIES:
                tries += 1
                other = study(replace(recorded, module=form.module))
                if _is_better(other, best):
                    better.append((float(np.median(_ulps(other.value, other.total))), other, form))
        if not better:
            break
        _, best, form = min(better, key=lambda entry: entry[0])
        forms.append(form)
        module = optimise(form.module, fixed=False)
    return forms, best


def _is_better(other: _Study, best: _Study) -> bool:
    """Return whether a form has the same values, and a bound that is lower by a quarter, or at most by three quarters.

    The values of two forms at f64 differ by their roundings, which are 2**-29 of those at f32.
    """
    counted = np.isfinite(best.value) & np.isfinite(best.total)
    with np.errstate(all="ignore"):
        same = np.abs(best.value - other.value) <= 2.0**-20 * (best.total + other.total)
    if not counted.any() or not same[counted].all():
        return False
    before, after = (_ulps(s.value[counted], s.total[counted]) for s in (best, other))
    lower = np.median(after) < 0.75 * np.median(before) or after.max() < 0.25 * before.max()
    return bool(lower and after.max() <= before.max())


def _ulps(values: Array, bounds: Array) -> Array:
    """Return the finite bounds in units of the last place of the values at f32."""
    with np.errstate(all="ignore"):
        ulps = np.abs(bounds / np.spacing(np.abs(values).astype(np.float32)))
    return np.asarray(ulps[np.isfinite(ulps)])


def _spoken(values: Array, bounds: Array) -> str:
    ulps = _ulps(values, bounds)
    return f"{np.median(ulps):.3g} ULP in the median, {np.max(ulps):.3g} at most" if ulps.size else "unknown"


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


def _derived(
    name: str, recorded: RecordedProgram, leaf: int, most: int | None
) -> tuple[Program, list[str], list[Loc | None]]:
    """Return the program of the value, its derivatives and the errors of lines; the names of inputs; the lines."""
    moving = [
        n
        for n, layout in recorded.inputs.items()
        if isinstance(layout, Layout) and all(cls.type.is_float for _, _, cls in leaves(layout, n))
    ]
    if not moving:
        raise ShpyTypeError(f"{name} has no input of floats", loc=here(), cure="x: sh.Attrib1f")
    names = [path for n in moving for path, _, _ in leaves(recorded.inputs[n], n)]  # type: ignore[arg-type]
    lines: list[Loc | None] = []

    def result(**arguments: Any) -> Any:
        return flatten(recorded.output, call_recorded(recorded, arguments), "the result")[leaf]

    def body(arguments: Mapping[str, Any]) -> Any:
        outline = outlined("sh.accuracy.roundings", result, [], arguments, moving)
        handles, reverse = reverse_call(outline, None, [0], most, rounding=True)
        lines[:] = reverse.lines
        types = [outline.function.outputs[0].type, *(v.type for m in outline.moved for v in m.inputs)]
        types += [outline.function.outputs[0].type.scalar] * len(lines)
        keys = ["value", *(f"d_{k}" for k in range(len(names))), *(f"line_{k}" for k in range(len(lines)))]
        values = [arithmetic.make_value("Attrib", t, outline.frame, h) for t, h in zip(types, handles, strict=True)]
        return dict(zip(keys, values, strict=True))

    again = rerecorded(f"{name}_roundings", recorded, recorded.inputs, None, body, recorded.defaults)
    return Program(again), names, lines
