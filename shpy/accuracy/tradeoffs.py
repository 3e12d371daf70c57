"""Time against error: run every variant of a program, and choose the fastest within an allowed error.

Stage: measure. Takes a program (or a choice), a domain and a budget, gives a `Tradeoff`.

    t = tradeoff(program, {"x": (0, 100)}, budget=sh.accuracy.ulp(4))
    t.best(x)                     # a kernel
    print(t.table())
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from shpy.accuracy.domain import Domain, Samples, draw
from shpy.accuracy.measuring import Variant, error_of, variants
from shpy.accuracy.pareto import Comparison, Point, frontier, names_of, rivals, timed
from shpy.accuracy.pareto_plot import draw as draw_comparison
from shpy.accuracy.reference import Kind, Truth, evaluate
from shpy.accuracy.report import pointer
from shpy.choices import Choice, combinations
from shpy.errors import BackendUnavailable, CompileError, ShpyError, ShpyTypeError
from shpy.ir.nodes import Value
from shpy.lang.recording.location import here
from shpy.pictures.outputs import new_figure, save_figure
from shpy.programs import Program, check_count, check_program
from shpy.run.kernel import Kernel
from shpy.testing.denormals import meets_denormals
from shpy.testing.observers import Setting
from shpy.testing.runs import run
from shpy.units import Budget

_ENOUGH = 0.003
"""Seconds: shorter calls are timed several at once."""
_UNSEEN = 4
"""The ratio of the elements that confirm a choice to those that made it."""


@dataclass
class Candidate:
    """One variant: its options of compilation, the `picks` of the user's choices, its times and its errors.

    `error` is the largest inside the domain, in the budget's unit: ULP are those of the output's own type at f32 for
    every precision, so that variants can be compared. `ns` per element is the median of the rounds, `spread` their
    quartiles. `code` is the length of the emitted text in characters. `held` tells whether the budget was kept on
    unseen inputs; None where these were not run.
    """

    variant: Variant
    picks: dict[str, str]
    program: Program = field(repr=False)
    kernel: Kernel = field(repr=False)
    error: float = 0.0
    ns: float = 0.0
    spread: tuple[float, float] = (0.0, 0.0)
    code: int = 0
    held: bool | None = None

    def __str__(self) -> str:
        return " ".join([str(self.variant), *(f"{name}={picked}" for name, picked in self.picks.items())])


@dataclass(frozen=True)
class Tradeoff:
    """The measured candidates, fastest first, and the skipped variants with the reasons."""

    program: str
    budget: Budget
    candidates: tuple[Candidate, ...]
    skipped: tuple[tuple[str, str], ...]

    @property
    def frontier(self) -> tuple[Candidate, ...]:
        """The candidates than which none is both faster and closer, fastest first."""
        return frontier(self.candidates, _error)

    @property
    def fastest(self) -> Candidate | None:
        """The fastest candidate that keeps the budget, on unseen inputs too."""
        return None if self._comparison.kept is None else self.candidates[self._comparison.kept]

    @property
    def pick(self) -> Candidate:
        """The choice: the fastest candidate whose errors keep the budget, on unseen inputs too.

        Times of a busy machine vary. Of candidates whose times are not separable from the fastest's, the most exact is
        chosen (`shpy.accuracy.pareto`). Raises ShpyError where no candidate keeps the budget.
        """
        if self._comparison.picked is not None:
            return self.candidates[self._comparison.picked]
        nearest = min(self.candidates, key=_error)
        wider = "" if any(c.variant.precision == "f64" for c in self.candidates) else ", or precision=['f64']"
        raise ShpyError(
            f"no variant of {self.program} keeps {self.budget}: the closest, {nearest}, is {nearest.error:.3g} off",
            loc=here(),
            cure=f"a budget of {_rounded_up(nearest.error)}, a smaller domain{wider}",
        )

    @property
    def best(self) -> Kernel:
        """The picked candidate, compiled."""
        return self.pick.kernel

    def table(self) -> str:
        """Return the candidates as text, with a legend of its marks, columns and short names."""
        return "\n  ".join([self._comparison.table(), *self._pointers()])

    def _pointers(self) -> set[str]:
        """Return the line that points to `roundings`, if there is one."""
        errors = ((c, c.error) for c in self.candidates if self.budget.unit == "ulp" and _has_lines(c.program))
        lines = (pointer(c.variant.math, c.variant.precision, error, "") for c, error in errors)
        return {line for line in lines if line is not None}

    def __str__(self) -> str:
        return self.table()

    def json(self) -> dict[str, Any]:
        """Return every candidate for `json.dump`; `like_fastest` marks times not separable from the fastest's."""
        rows = [
            {
                "backend": c.variant.backend,
                "math": c.variant.math,
                "fuse": c.variant.fuse,
                "precision": c.variant.precision,
                "picks": c.picks,
                "ns": c.ns,
                "spread": c.spread,
                "error": c.error,
                "code": c.code,
                "held": c.held,
                **self._comparison.marks(n),
            }
            for n, c in enumerate(self.candidates)
        ]
        budget = {"limit": self.budget.limit, "unit": self.budget.unit}
        return {"program": self.program, "budget": budget, "candidates": rows, "skipped": list(self.skipped)}

    def plot(self, path: str | Path) -> None:
        """Draw time against error with the frontier and the budget; JSON of the same name goes beside it.

        Raises ShpyError without matplotlib, or for a path that is no picture.
        """
        figure = new_figure(10, 6)
        draw_comparison(self._comparison, figure)
        figure.supxlabel("".join(self._pointers()), fontsize=8, x=0.01, ha="left")
        save_figure(figure, Path(path), self.json())

    @cached_property
    def _comparison(self) -> Comparison:
        """The candidates as tables and plots show them, and the choice."""
        unit = "ULP" if self.budget.unit == "ulp" else "relative"
        budget = (
            f"within {self.budget.limit:g} ULP"
            if unit == "ULP"
            else f"within a relative error of {self.budget.limit:g}"
        )
        return Comparison(
            title=f"{self.program}: time against error",
            points=tuple(map(self._point, self.candidates)),
            limit=self.budget.limit,
            budget=budget,
            headings=("variant", "ns/element", "quartiles", f"error ({self.budget.unit})", "code", "keeps the budget"),
            meanings=self._meanings(),
            time="ns per element",
            error="largest error in ULP" if unit == "ULP" else "largest relative error",
            series="backend",
            mode="mode",
            skipped=self.skipped,
        )

    def _point(self, c: Candidate) -> Point:
        kept = "no" if c.held is False or c.error > self.budget.limit else "yes" if c.held else "on these"
        picks = ", ".join(f"{name}={picked}" for name, picked in c.picks.items())
        label = "\n".join(filter(None, (str(c.variant), picks)))
        mode = c.variant.mode
        return Point(str(c), label, c.variant.backend, mode, c.ns, c.spread, c.error, bool(c.held), (str(c.code), kept))

    def _meanings(self) -> dict[str, str]:
        """Explain the columns and the short names of the table."""
        words = " ".join(str(c.variant) for c in self.candidates).split()
        choices = ", choices of yours" if any(c.picks for c in self.candidates) else ""
        off = "in units in the last place of the output's type at f32" if self.budget.unit == "ulp" else "relative"
        return {
            "variant": f"backend, mode, working precision{choices}",
            "ns/element": "nanoseconds from call to result, divided by the elements: the median of the rounds",
            "quartiles": "of the rounds: half of them took a time between these",
            f"error ({self.budget.unit})": f"the largest inside the domain, {off}",
            "code": "characters of the emitted text",
            "keeps the budget": "yes: on unseen inputs too; on these: where it was measured, nothing unseen was tried",
            **names_of(words),
        }


def tradeoff(
    program: Program | Choice,
    domain: Domain,
    budget: Budget,
    backends: Iterable[str] | str | None = None,
    math: Iterable[str] | str | None = None,
    precision: Iterable[str] | str | None = ("f32", "f16", "f64"),
    reference: Kind = "mpmath",
    samples: int = 1000,
    elements: int = 100_000,
    rounds: int = 7,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    fuse: Iterable[bool] | bool = False,
) -> Tradeoff:
    """Run every variant (backend, mode, precision, `fuse`, the user's choices) and pick the fastest within `budget`.

    Errors are those on `samples` elements of the domain and the special values inside it, against the first
    alternatives without rounding. Times are of `elements` elements from call to result, warmed up, all variants in
    turn, `rounds` times. The pick holds on four times as many unseen elements as well, else the next is taken. Variants
    that a target cannot run are skipped and listed. `progress` is called with how many variants and rounds of timing
    are done, and how many there are.
    """
    _check_budget(budget)
    for name, number, least in (("elements", elements, 1), ("rounds", rounds, 1), ("seed", seed, 0)):
        check_count(name, number, least)
    tell = _checked_progress(progress)
    programs = list(combinations(program))
    tried = [(picks, one, variant) for picks, one in programs for variant in variants(backends, math, precision, fuse)]
    steps = len(tried) + rounds
    first = _first_of(programs)
    search = _Search(first, domain, budget, reference, samples, seed)
    candidates: list[Candidate] = []
    skipped: list[tuple[str, str]] = []
    for done, (picks, one, variant) in enumerate(tried):
        tell(done, steps)
        try:
            kernel = one.compile(variant.backend, **variant.options)
            candidate = Candidate(variant, picks, one, kernel, code=len(kernel.source))
            candidate.error = search.error(candidate)
            candidates.append(candidate)
        except (BackendUnavailable, CompileError) as error:
            skipped.append((" ".join([str(variant), *picks.values()]), error.message))
    if not candidates:
        raise ShpyError(f"no variant of {first.name} can be run", loc=here(), cure=skipped[0][1] if skipped else None)
    timed = draw(first, domain, elements, np.random.default_rng(seed + 2), special=False)
    _time(candidates, timed, rounds, lambda done: tell(len(tried) + done, steps))
    candidates.sort(key=lambda c: c.ns)
    _hold([c for c in candidates if c.error <= budget.limit], search)
    return Tradeoff(first.name, budget, tuple(candidates), tuple(skipped))


def _check_budget(budget: object) -> None:
    cure = 'sh.accuracy.ulp(4), or a relative error, sh.accuracy.Budget(1e-3, "relative")'
    if not isinstance(budget, Budget):
        raise ShpyTypeError(f"a budget is a number of units, not {budget!r}", loc=here(), cure=cure)
    if not (isinstance(budget.limit, float | int | np.number) and budget.limit >= 0):
        raise ShpyTypeError(f"the limit of a budget is a number from 0 on, not {budget.limit!r}", loc=here(), cure=cure)
    if budget.unit not in ("ulp", "relative"):
        raise ShpyTypeError(f"the unit of a budget is not {budget.unit!r}", loc=here(), cure=cure)


def _checked_progress(progress: Any) -> Callable[[int, int], None]:
    if not (progress is None or callable(progress)):
        cure = "progress=lambda done, total: print(done, total)"
        raise ShpyTypeError(f"progress={progress!r} is no function", loc=here(), cure=cure)
    return progress or (lambda done, total: None)


def _first_of(programs: list[tuple[dict[str, str], Program]]) -> Program:
    """Return the program that the others are judged by; ShpyTypeError for outputs of other sizes among them."""
    for _, one in programs:
        check_program(one)
    signatures = {
        " and ".join(picks.values()): [out.type.size for out in one.ir.entry.outputs] for picks, one in programs
    }
    (first, expected), *others = signatures.items()
    for other, sizes in others:
        if sizes != expected:
            raise ShpyTypeError(
                f"{first} and {other} give outputs of {expected} and {sizes} components",
                loc=here(),
                cure="alternatives that give the same",
            )
    return programs[0][1]


def _has_lines(program: Program) -> bool:
    """Return whether `roundings` takes the program: its one output is a float, and so are inputs."""
    (output, *others) = program.outputs.values()
    floats = any(isinstance(p, Value) and p.type.is_float for p in program.ir.entry.inputs)
    return not others and output.size == 1 and output.type.is_float and floats


def _rounded_up(number: float) -> str:
    """Return the text of a number of three digits that is not below `number`."""
    text = f"{number:.3g}"
    if float(text) < number and np.isfinite(number):
        text = f"{number * (1 + 5e-3):.3g}"
    return text


def _hold(close: list[Candidate], search: _Search) -> None:
    """Try candidates on unseen inputs: each until the fastest is known, then its rivals, among which errors decide."""
    fastest = None
    while fastest is None and close:
        first = close.pop(0)
        first.held = search.holds(first)
        fastest = first if first.held else None
    if fastest is not None:
        for candidate in rivals([fastest, *close], _error)[1:]:
            candidate.held = search.holds(candidate)


def _error(candidate: Candidate) -> float:
    return candidate.error


class _Search:
    """The inputs of a search with what they must give, and those that are kept back."""

    def __init__(
        self, program: Program, domain: Domain, budget: Budget, reference: Kind, samples: int, seed: int
    ) -> None:
        self.program, self.domain, self.budget, self.reference = program, domain, budget, reference
        self.samples, self.seed = samples, seed
        self.drawn = draw(program, domain, samples, np.random.default_rng(seed))
        self.truth = self.exact(self.drawn, reference)
        self.unseen: tuple[Samples, Truth] | None = None

    def exact(self, drawn: Samples, reference: Kind) -> Truth:
        return evaluate(Setting(self.program, drawn.inputs), reference)

    def error(self, candidate: Candidate) -> float:
        """Return the candidate's largest error inside the domain."""
        return self._error(candidate, self.drawn, self.truth)

    def holds(self, candidate: Candidate) -> bool:
        """Return True if it keeps the budget on inputs that were kept back."""
        if self.unseen is None:
            rng = np.random.default_rng(self.seed + 1)
            drawn = draw(self.program, self.domain, _UNSEEN * self.samples, rng)
            self.unseen = drawn, self.exact(drawn, self.quick())
        return self._error(candidate, *self.unseen) <= self.budget.limit

    def quick(self) -> Kind:
        """Return "f64" if binary64 is as good as exact by the budget's measure, else the reference asked for."""
        if self.reference == "f64":
            return "f64"
        double = Candidate(
            Variant("numpy", None, "f64"), {}, self.program, self.program.compile("numpy", precision="f64")
        )
        return "f64" if self.error(double) <= 0.01 * self.budget.limit else self.reference

    def _error(self, candidate: Candidate, drawn: Samples, truth: Truth) -> float:
        setting = Setting(candidate.program, drawn.inputs, options=candidate.variant.options)
        results = run(setting, candidate.variant.backend)
        counted = drawn.inside & (results.written | truth.written)
        if results.flushes:
            counted &= ~meets_denormals(setting)
        largest = 0.0
        for output, slot in enumerate(self.program.ir.entry.outputs[: len(truth.outputs)]):
            dtype = {"d": np.float64, "h": np.float16}.get(slot.type.base.value, np.float32)
            errors = error_of(results, truth, output, dtype)[self.budget.unit != "ulp"]
            largest = max(largest, float(errors[counted].max(initial=0.0)))
        return largest


def _time(candidates: list[Candidate], drawn: Samples, rounds: int, tell: Callable[[int], None]) -> None:
    """Set each candidate's time and its quartiles."""
    calls = [partial(candidate.kernel, *drawn.inputs) for candidate in candidates]
    each = 1e9 / drawn.count
    for candidate, (middle, (low, high)) in zip(candidates, timed(calls, rounds, _ENOUGH, tell), strict=True):
        candidate.ns, candidate.spread = each * middle, (each * low, each * high)
