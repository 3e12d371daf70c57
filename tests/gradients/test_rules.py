"""The rules of the op table: against difference quotients in 240 bits, and at kinks against the conventions."""

from __future__ import annotations

import numpy as np
import pytest

import shpy as sh
from shpy.accuracy.reference import evaluate
from shpy.ir.builder import Builder
from shpy.ir.nodes import Function, Module, Port
from shpy.ir.ops import OPS
from shpy.ir.tangents import TANGENTS, flat
from shpy.ir.types import FLOATS, Base, vec
from shpy.passes.derivatives.forward import ForwardFunctions
from shpy.testing.observers import Setting
from tests.backends.running import TARGETS, run

STEP = 2.0**-100
POINTS = 3
DOMAINS = {
    **dict.fromkeys(("asin", "acos", "atanh"), (-0.9, 0.9)),
    **dict.fromkeys(("sqrt", "rsqrt", "log", "log2", "log10", "pow"), (0.2, 3.0)),
    "acosh": (1.2, 4.0),
    "log1p": (-0.8, 2.0),
    "refract": (-0.7, 0.7),
}
"""The ranges of operands outside of which an operation has no derivative; others are drawn from -2 to 2."""
GIVES_FLOATS = [n for n, row in OPS.items() if row.bases & FLOATS and row.gives in ("T", "S", "V3")]


def test_every_operation_has_a_rule() -> None:
    lacking = [n for n in GIVES_FLOATS if OPS[n].tangent is None]
    assert not lacking, f"shpy/ir/tangents.py lacks the rule of {', '.join(lacking)}"
    assert {n for n, row in OPS.items() if row.gives == "F"} <= {n for n, rule in TANGENTS.items() if rule is flat}
    assert set(TANGENTS) <= set(OPS)


def program_of(function: Function) -> sh.Program:
    inputs = tuple(Port(str(p.name), f"Attrib{p.type.size}{p.type.base}") for p in function.inputs)
    outputs = tuple(Port(str(v.name), f"Attrib{v.type.size}{v.type.base}") for v in function.outputs)
    return sh.Program.from_ir(Module(function.name, inputs, outputs, (), (), (function,)))


def tangent_and_quotient(name: str, size: int) -> tuple[sh.Program, sh.Program]:
    """Return the programs of an operation's tangent, and of (f(x + h d) - f(x - h d)) / 2 h."""
    types = OPS[name].arguments(vec(Base.F, size))
    assert types is not None
    b = Builder(name)
    value = b.let(name, *[b.input(t, f"x{k}") for k, t in enumerate(types)])
    b.store(b.output(value.type, "y"), value)
    function = b.finish()
    moving = tuple(t.is_float for t in types)
    world = ForwardFunctions([""], {}.__getitem__, str, {})
    forward = world.seeded(function, moving, {})
    b = Builder(name)
    xs = [b.input(t, f"x{k}") for k, t in enumerate(types)]
    ds = {k: b.input(t, f"d_x{k}") for k, t in enumerate(types) if t.is_float}
    sides = []
    for sign in (1, -1):
        steps = {k: b.let("mul", d, b.const(d.type, [sign * STEP] * d.type.size)) for k, d in ds.items()}
        sides.append(b.let(name, *[b.let("add", x, steps[k]) if k in ds else x for k, x in enumerate(xs)]))
    change = b.let("sub", *sides)
    quotient = b.let("mul", change, b.const(change.type, [0.5 / STEP] * change.type.size))
    b.store(b.output(quotient.type, "d_y"), quotient)
    return program_of(forward), program_of(b.finish())


@pytest.mark.parametrize("size", [1, 3])
def test_rules_are_the_derivatives(size: int) -> None:
    """In 240 bits, a tangent is the difference quotient with a step of 2**-100, to the digits of rounded constants."""
    rng = np.random.default_rng(size)
    wrong = {}
    for name in GIVES_FLOATS:
        types = OPS[name].arguments(vec(Base.F, size))
        if types is None:
            continue
        low, high = DOMAINS.get(name, (-2.0, 2.0))
        data = {}
        for k, t in enumerate(types):
            shape = (POINTS,) if t.size == 1 else (POINTS, t.size)
            x = rng.uniform(low, high, shape)
            data[f"x{k}"] = np.float32(x) if t.is_float else np.int32(3 * x) if t.is_int else x > 0
        for k, t in enumerate(types):
            if t.is_float:
                data[f"d_x{k}"] = np.float32(rng.uniform(-1, 1, data[f"x{k}"].shape))
        rule, quotient = tangent_and_quotient(name, size)
        tangent = 0 if OPS[name].tangent is flat else evaluate(Setting(rule, (), data)).outputs[-1].high
        slope = evaluate(Setting(quotient, (), data)).outputs[0].high
        error = np.max(np.abs(tangent - slope) / (1 + np.abs(slope)))
        if not error < 1e-15:
            wrong[name] = error
    assert not wrong


KINKS = [
    ("abs(x)", 0, 0),
    ("min(x, 1.0)", 1, 1),
    ("max(1.0, x)", 1, 0),
    ("clamp(x, 0.0, 1.0)", 1, 1),
    ("floor(x)", 0.5, 0),
    ("fract(x)", 1, 1),
    ("mod(x, 2.0)", 2, 1),
    ("sqrt(x)", 0, 0),
    ("sqrt(sh.max(x, 0.0))", -1, 0),
    ("sqrt(x*x)", 0, 0),
    ("pow(x, 0.5)", 0, 0),
    ("pow(x, 1.0)", 0, 1),
    ("pow(x, 2.0)", 0, 0),
    ("acos(sh.clamp(x, -1.0, 1.0))", 2, 0),
    ("cbrt(x)", 0, 0),
    ("asin(x)", 1, 0),
    ("acosh(x)", 1, 0),
    ("length(sh.Attrib3f(x, 0, 0))", 0, 0),
    ("distance(sh.Attrib3f(x, 0, 0), (0, 0, 0))", 0, 0),
    ("normalize(sh.Attrib3f(x, 0, 0)).x", 0, 0),
    ("hypot(x, 0.0)", 0, 0),
    ("atan2(x, 0.0)", 0, 0),
    ("smoothstep(1.0, 1.0, x)", 1, 0),
    ("smootherstep(0.0, 1.0, x)", 1, 0),
    ("cond(x > 0, x, 0.0)", 0, 0),
    ("refract(sh.Attrib2f(x, -0.6), sh.Attrib2f(0, 1), 2.0).x", 0.8, 0),
    ("log(x)", 0, np.inf),
    ("exp(1 / x)", -0.0, np.nan),
    ("sqrt(x)", -1, np.nan),
    ("asin(x)", 2, np.nan),
    ("acosh(x)", 0, np.nan),
]


def test_kinks() -> None:
    """The first derivative is the convention's on every backend; where the value is finite, the second is a number."""
    names = ", ".join(f"x{k}: sh.Attrib1f" for k in range(len(KINKS)))
    firsts = ", ".join(f"sh.gradient(lambda x: sh.{text})(x{k})" for k, (text, _, _) in enumerate(KINKS))
    seconds = ", ".join(
        f"sh.gradient(sh.gradient(lambda x: sh.{text}))(x{k})"
        for k, (text, _, slope) in enumerate(KINKS)
        if np.isfinite(slope)
    )
    space: dict[str, sh.Program] = {"sh": sh}  # type: ignore[dict-item]
    exec(f"@sh.program\ndef slopes({names}):\n    return {firsts}, {seconds}\n", space)
    exec(f"@sh.program\ndef firsts({names}):\n    return {firsts}\n", space)
    at = [np.float32(x) for _, x, _ in KINKS]
    for target in TARGETS:  # second derivatives have the bits of numpy elsewhere: test_generated_gradients.py
        results = run(space["slopes" if target == "numpy" else "firsts"], target, *at).outputs
        for (text, x, expected), slope in zip(KINKS, results, strict=False):
            assert np.array_equal(slope, expected, equal_nan=True), f"{text} at {x} on {target}: {slope}"
        assert np.isfinite(results[len(KINKS) :]).all(), target
        assert len(results) > len(KINKS) or target != "numpy"
