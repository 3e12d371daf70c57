"""Measure the errors of a program's results on every backend, mode and precision.

Stage: measure. Takes a program and a domain, gives a `Report`.

    report = measure(program, {"x": (1e-3, 1e3, "log")}, math=["strict", "fast"])
    print(report.table())
    report.plot("error.png")
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.accuracy.domain import Domain, Samples, draw
from shpy.accuracy.reference import Exact, Kind, Truth, evaluate
from shpy.accuracy.report import BINS, Report, Row
from shpy.backend.registry import backend, backends as listed
from shpy.errors import BackendUnavailable, CompileError, ShpyTypeError
from shpy.lang.recording.location import here
from shpy.passes.modes import MODES, PRECISIONS, REPRODUCIBLE, mode_name
from shpy.programs import Program, check_count
from shpy.testing.denormals import meets_denormals
from shpy.testing.observers import Setting
from shpy.testing.runs import Run, run
from shpy.units import relative, ulps

Array = NDArray[Any]


@dataclass(frozen=True)
class Variant:
    """One way to compile: `math` None for the default mode."""

    backend: str
    math: str | None
    precision: str
    fuse: bool = False

    @property
    def options(self) -> dict[str, Any]:
        """Return the keywords of `compile`."""
        mode = {"math": self.math} if self.math is not None else {}
        return {"precision": self.precision, **mode, **({"fuse": True} if self.fuse else {})}

    @property
    def mode(self) -> str:
        """The name of its mode."""
        return mode_name(self.math or "default", self.fuse)

    def __str__(self) -> str:
        return " ".join(filter(None, (self.backend, self.math, "fused" if self.fuse else None, self.precision)))


def variants(
    backends: Iterable[str] | str | None,
    math: Iterable[str] | str | None,
    precision: Iterable[str] | str | None,
    fuse: Iterable[bool] | bool = False,
) -> list[Variant]:
    """Return every combination; None means all available backends, all modes, or f32.

    Modes that contract by themselves have no variant with `fuse`. Raises ShpyTypeError for an unknown mode or
    precision, and where nothing is left; BackendUnavailable for an unknown backend.
    """
    for what, values, choices in (("precision", precision, PRECISIONS), ("math", math, MODES)):
        for unknown in [x for x in _several(values, (), what) if x not in choices]:
            raise ShpyTypeError(f"{what}={unknown!r} is unknown", loc=here(), cure=" or ".join(map(repr, choices)))
    for name in _several(backends, (), "backends"):
        backend(name)
    fusions = list(fuse) if isinstance(fuse, Iterable) else [fuse]
    if not fusions or not all(isinstance(f, bool) for f in fusions):
        raise ShpyTypeError(f"fuse={fuse!r} is neither", loc=here(), cure="fuse=True, False, or (False, True) for both")
    modes = _several(math, MODES, "math")
    forms = [(m, f) for m in modes for f in fusions if m in REPRODUCIBLE or not f]
    if modes and not forms:
        cure = 'math=["strict", "portable"]'
        raise ShpyTypeError(f"math={math!r} contracts by itself, without fuse=True", loc=here(), cure=cure)
    names = _several(backends, [b.name for b in listed() if b.available], "backends")
    precisions = _several(precision, ["f32"], "precision")
    return [Variant(b, m, p, f) for b in names for m, f in forms for p in precisions]


def _several(names: Iterable[str] | str | None, default: Iterable[str], what: str) -> list[str]:
    if not isinstance(names, Iterable | None):
        raise ShpyTypeError(
            f"{what}={names!r} is no name and no list of names", loc=here(), cure=f"{what}=None for all"
        )
    return list(default) if names is None else [names] if isinstance(names, str) else list(names)


def measure(
    program: Program,
    domain: Domain,
    backends: Iterable[str] | str | None = None,
    math: Iterable[str] | str | None = None,
    precision: Iterable[str] | str | None = None,
    reference: Kind = "mpmath",
    samples: int = 2000,
    seed: int = 0,
    fuse: Iterable[bool] | bool = False,
) -> Report:
    """Run the program on `samples` elements of the domain, and on special values, and compare with exact results.

    `domain` says for each input a range, (lo, hi) or (lo, hi, "log"), an array, or a function of a numpy Generator and
    a count. Each variant is measured on inputs of its own precision, in ULP of its own type. Special values in the
    domain's ranges count like the others; those outside are counted apart, as edges. `fuse=(False, True)` measures
    strict and portable mode with and without contracted sums. A variant that its target cannot
    run is skipped, and the report lists it. Raises ShpyTypeError for a domain that does not fit the program.
    """
    check_count("seed", seed, 0)
    rows: list[Row] = []
    skipped: list[tuple[str, str]] = []
    truths: dict[str, tuple[Samples, Truth]] = {}
    for variant in variants(backends, math, precision, fuse):
        if variant.precision not in truths:
            drawn = draw(program, domain, samples, np.random.default_rng(seed), precision=variant.precision)
            setting = Setting(program, drawn.inputs, options={"precision": variant.precision})
            truths[variant.precision] = drawn, evaluate(setting, reference)
        drawn, truth = truths[variant.precision]
        try:
            rows += _rows(program, variant, drawn, truth)
        except (BackendUnavailable, CompileError) as error:
            skipped.append((str(variant), error.message))
    inputs = {precision: drawn.leaves for precision, (drawn, _) in truths.items()}
    return Report(program.name, reference, tuple(rows), tuple(skipped), inputs)


def _rows(program: Program, variant: Variant, drawn: Samples, truth: Truth) -> Iterator[Row]:
    setting = Setting(program, drawn.inputs, options=variant.options)
    results = run(setting, variant.backend)
    flushed = meets_denormals(setting) if results.flushes else np.zeros(drawn.count, np.bool_)
    for k, name in enumerate(program.outputs):
        yield _row(variant, name, drawn, results, truth, k, flushed)


def _row(variant: Variant, name: str, drawn: Samples, results: Run, truth: Truth, output: int, flushed: Array) -> Row:
    exact = truth.outputs[output]
    errors, off = error_of(results, truth, output)
    counted = drawn.inside & ~flushed & (results.written | truth.written)
    kept, kept_off = errors[counted], off[counted]
    outside = ~drawn.inside & ~flushed
    largest = float(kept.max(initial=0.0))
    beyond = outside & (errors > max(4.0, largest))
    worst = int(np.flatnonzero(counted)[np.argmax(kept)]) if kept.size else 0

    def inputs(n: int) -> dict[str, Any]:
        return {leaf: array[n] for leaf, array in drawn.leaves.items()}

    return Row(
        backend=variant.backend,
        math=variant.math,
        precision=variant.precision,
        fuse=variant.fuse,
        output=name,
        count=int(counted.sum()),
        ulp=_three(kept),
        relative=_three(kept_off),
        worst=inputs(worst),
        found=_value(results.outputs[output][worst]),
        exact=_value(exact.high[worst]),
        histogram=tuple(int(n) for n in np.bincount(np.searchsorted(BINS, kept), minlength=len(BINS) + 1)),
        specials=int(outside.sum()),
        edges=int(beyond.sum()),
        edge=inputs(int(np.flatnonzero(beyond)[0])) if beyond.any() else None,
        flushed=int((flushed & drawn.inside).sum()),
        errors=np.where(counted, errors, np.nan),
    )


def error_of(results: Run, truth: Truth, output: int, dtype: Any = None) -> tuple[Array, Array]:
    """Return the errors of one output in ULP and relative, each (n,): the largest of the components.

    ULP are those of the output's own type, or of `dtype`. The error of ints and bools is their difference. It is
    infinite where only one of the two runs wrote the element, and 0 where neither did.
    """
    exact, values = truth.outputs[output], results.outputs[output]
    if values.dtype.kind == "f":
        errors, off = _float_errors(values, exact, np.dtype(dtype or values.dtype))
    else:
        errors = off = np.abs(values.astype(np.float64) - exact.high.astype(np.float64))
    ended = results.written != truth.written
    unwritten = ~results.written & ~truth.written
    whole = np.where(ended, np.inf, np.where(unwritten, 0.0, errors.max(axis=1)))
    return whole, np.where(ended, np.inf, np.where(unwritten, 0.0, off.max(axis=1)))


def _float_errors(values: Array, exact: Exact, dtype: Any) -> tuple[Array, Array]:
    low = exact.low if values.dtype == np.float64 else None
    return ulps(values, exact.high, dtype=dtype, rest=low), relative(values, exact.high)


def _three(errors: Array) -> tuple[float, float, float]:
    """Return the largest, the 99th percentile and the median."""
    if not errors.size:
        return 0.0, 0.0, 0.0
    return (
        float(errors.max()),
        float(np.quantile(errors, 0.99, method="higher")),
        float(np.quantile(errors, 0.5, method="higher")),
    )


def _value(array: Array) -> Any:
    return array[0].item() if array.size == 1 else array.tolist()
