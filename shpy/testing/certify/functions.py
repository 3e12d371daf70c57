"""Sweeps over the functions: their bits in strict mode, and how far from the exact results they are in each mode.

Stage: test. The bounds are those of the table of operations (`ir/ops.py`); references are binary64, for doubles mpmath.
"""

from __future__ import annotations

import functools
from typing import Any, Final

import numpy as np

from shpy.ir.builder import Builder
from shpy.ir.exact import FUNCTIONS, hard_cases
from shpy.ir.ops import OPS, TRANSCENDENTALS
from shpy.ir.types import vec
from shpy.packages import install
from shpy.passes.modes import Math
from shpy.programs import Program
from shpy.testing.arrays import Array, flat_leaves
from shpy.testing.certify.comparing import compare, compare_arrays
from shpy.testing.certify.findings import Check, DeviceChoice, Finding, Verdict
from shpy.testing.certify.golden import golden
from shpy.testing.certify.inputs import PARTS, everything, no_denormals, pairs, scattered, sweep
from shpy.testing.conformance.operations import program as program_of
from shpy.testing.observers import Setting
from shpy.testing.reference import flushes_denormals

SWEPT: Final = (*sorted(TRANSCENDENTALS), "sqrt", "div", "mod", "fma")
"""The functions of the language that are more than one instruction of every processor."""
PORTABLE: Final = tuple(sorted(TRANSCENDENTALS))
"""Functions with formulas of their own in portable mode."""
_PAIRS: Final = 1 << 19
_COARSE: Final = 128
"""Mantissas for each exponent where bounds are measured."""
_DOUBLES: Final = 100
_TINY: Final = 2.0**-126


@functools.cache
def function(name: str) -> Program:
    """Return the program that applies one operation of the table to scalars."""
    b = Builder(name)
    arity = len(OPS[name].takes)
    b.store(b.output(vec("f"), "result"), b.let(name, *(b.input(vec("f"), "xyz"[k]) for k in range(arity))))
    program: Program = program_of(b.finish())
    return program


def arguments(name: str, mantissas: int | None = None) -> tuple[Array, ...]:
    """Return the inputs of a function's sweep; `mantissas` for each exponent, or as many as by default."""
    arity = len(function(name).inputs)
    if arity == 1:
        return (sweep(mantissas) if mantissas else sweep(),)
    return pairs(512 * mantissas if mantissas else _PAIRS, 11, arity)


def sweep_checks() -> list[Check]:
    """Return the checks of each function and each formula of portable mode: its bits, and its bound in ULP."""
    portable = [Check(f"{name}, portable", functools.partial(_sweep, name, math="portable")) for name in PORTABLE]
    return [Check(name, functools.partial(_sweep, name)) for name in SWEPT] + portable


def sweep_of(name: str, math: Math = "strict") -> Setting:
    """Return the sweep of a function in a mode; in strict mode with the numbers that are hardest to round."""
    arrays = arguments(name)
    if math == "strict" and name in FUNCTIONS:
        arrays = no_denormals(np.concatenate([*arrays, hard_cases(name)[0]]))
    return Setting(function(name), arrays, options={"math": math})


def _sweep(name: str, target: DeviceChoice, math: Math = "strict") -> Finding:
    setting = sweep_of(name, math)
    section = "functions" if math == "strict" else "portable"
    finding, outputs = compare(setting, target, golden()[section].get(name))
    if finding.wrong or name not in TRANSCENDENTALS:
        return finding
    bounded = _bounded(name, outputs[0], setting.inputs, OPS[name].distance(math), target.flushes)
    return bounded if bounded.wrong else Finding(finding.verdict, finding.detail, finding.hash, bounded.ulp)


def bound_checks() -> list[Check]:
    """Return a check of each function's error in relaxed mode, then at f64."""
    names = sorted(TRANSCENDENTALS)
    relaxed = [Check(f"{name}, relaxed", functools.partial(_relaxed, name)) for name in names]
    return relaxed + [Check(f"{name}, f64", functools.partial(_double, name)) for name in names]


def _relaxed(name: str, target: DeviceChoice) -> Finding:
    arrays = arguments(name, _COARSE)
    kernel = target.compile(function(name), math="relaxed")
    (results,) = flat_leaves(kernel(*arrays))
    return _bounded(name, results, arrays, OPS[name].distance("relaxed"), flushes_denormals(kernel.notes))


def _bounded(name: str, results: Array, arrays: tuple[Array, ...], bound: float, flushes: bool) -> Finding:
    meaning = OPS[name].meaning
    with np.errstate(all="ignore"):
        exact = np.asarray(meaning(*(a.astype(np.float64) for a in arrays)))
    off = errors(results, exact)
    if flushes:
        off = np.where(np.abs(exact) <= _TINY, 0, off)
    worst = int(np.argmax(off))
    if off[worst] <= bound:
        return Finding("same", ulp=round(float(off[worst]), 3))
    inputs = ", ".join(repr(a[worst].item()) for a in arrays)
    return Finding(
        "differs",
        f"for {inputs}: {results[worst]!r} is {off[worst]:.3g} units in the last place from {exact[worst]!r}, "
        f"and {bound:.7g} are allowed",
        ulp=float(off[worst]),
    )


def errors(results: Array, exact: Array) -> Array:
    """Return the errors of results against exact ones in binary64, in units in the last place of a binary32."""
    with np.errstate(all="ignore"):
        nearest = exact.astype(np.float32)
        exponent = np.floor(np.log2(np.maximum(np.abs(exact), _TINY)))
        distance = np.abs(results.astype(np.float64) - exact) / 2.0 ** (np.minimum(exponent, 127) - 23)
    same = (results == nearest) & (np.signbit(results) == np.signbit(nearest)) | np.isnan(results) & np.isnan(exact)
    measured = np.where(np.isfinite(nearest) & (nearest != 0), distance, 0)
    return np.where(same, measured, np.nan_to_num(distance, nan=np.inf))


def input_checks() -> list[Check]:
    """Return checks of every function of one argument on all its inputs, in parts of about a minute."""
    return [
        Check(f"{name}, part {part + 1} of {PARTS}", functools.partial(_all, name, part))
        for name in SWEPT
        if len(OPS[name].takes) == 1
        for part in range(PARTS)
    ]


def _all(name: str, part: int, target: DeviceChoice) -> Finding:
    """Compare part of the inputs: numpy's results with the bound, other backends' with numpy's bits here."""
    verdict: Verdict = "same"
    ulp = 0.0
    kernel, reference = target.compile(function(name)), DeviceChoice("numpy").compile(function(name))
    for x in everything(part):
        (results,) = flat_leaves(kernel(x))
        finding = Finding("same")
        if target.backend != "numpy":
            finding = compare_arrays(Setting(function(name), (x,)), target, [results], flat_leaves(reference(x)))
        elif name in TRANSCENDENTALS:
            finding = _bounded(name, results, (x,), OPS[name].distance("strict"), flushes=False)
            ulp = max(ulp, finding.ulp or 0)
        if finding.wrong:
            return finding
        verdict = "denormals" if finding.verdict == "denormals" else verdict
    return Finding(verdict, ulp=ulp or None)


def _double(name: str, target: DeviceChoice) -> Finding:
    """Return the error of strict mode at f64, against mpmath in 160 bits."""
    try:
        import mpmath as mp
    except ImportError:
        return Finding("absent", f"mpmath is not installed: {install('mpmath')}")
    arrays = _doubles(name)
    (results,) = flat_leaves(target.compile(function(name), precision="f64")(*arrays))
    exact_of = _exact(mp, name)
    worst, message = 0.0, ""
    with mp.workprec(160):
        for *arguments, value in zip(*arrays, results, strict=True):
            exact = exact_of(*(mp.mpf(float(a)) for a in arguments))
            place = mp.power(2, max(int(mp.floor(mp.log(abs(exact), 2))), -1022) - 52)
            off = float(abs(mp.mpf(float(value)) - exact) / place) if np.isfinite(value) else np.inf
            if off > worst:
                worst, message = off, f"for {', '.join(map(repr, map(float, arguments)))}: {float(value)!r}"
    bound = OPS[name].double.ulp
    if worst <= bound:
        return Finding("same", ulp=round(worst, 3))
    return Finding(
        "differs", f"{message} is {worst:.3g} units in the last place off, and {bound:g} are allowed", ulp=worst
    )


def _exact(mp: Any, name: str) -> Any:
    others = {
        "cbrt": lambda x: mp.sign(x) * mp.cbrt(abs(x)),
        "exp10": lambda x: mp.power(10, x),
        "exp2": lambda x: mp.power(2, x),
        "log2": lambda x: mp.log(x) / mp.log(2),
        "pow": mp.power,
        "rsqrt": lambda x: 1 / mp.sqrt(x),
    }
    return others.get(name) or getattr(mp, name)


def _doubles(name: str) -> tuple[Array, ...]:
    """Numbers from where the function is defined."""
    u, v = (_between(k) for k in (1, 2))
    match name:
        case "asin" | "acos" | "atanh" | "log1p":
            return (u,)
        case "exp" | "exp2" | "sinh" | "cosh" | "expm1":
            return (700 * u * u * u,)
        case "exp10":
            return (300 * u,)
        case "erfc":
            return (26 * u,)
        case "log" | "log2" | "log10" | "rsqrt":
            return (np.ldexp(1.5 + 0.25 * u, (1000 * v).astype(np.int32)),)
        case "acosh":
            return (1 + np.ldexp(1 + np.abs(u), (30 * v).astype(np.int32)),)
        case "pow":
            return np.ldexp(1 + np.abs(u), (12 * v).astype(np.int32)), 60 * v
        case "atan2" | "hypot":
            return 1000 * u, v
    return (np.ldexp(u, (20 * v).astype(np.int32)),)


def _between(seed: int) -> Array:
    """Numbers between -1 and 1 that are not 0."""
    high, low = (scattered(_DOUBLES, 40 + 2 * seed + k).astype(np.float64) for k in (0, 1))
    return (high + low * 2.0**-32 + 2.0**-40) * 2.0**-31 - 1
