"""Gradients beside JAX's at f64, in both modes: equal to 1e-13 of the gradient's length, at 200 places each.

At f32 they have the same bits on OpenCL at every width and on GLSL as on numpy. `pip install jax`, then
`pytest tests/gradients/beside_jax.py`: no other run collects this file. Each function is written once, for a namespace:
that of shpy or of JAX. The places lie inside of the domains and off the kinks, whose derivatives docs/gradients.md
lists.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import shpy as sh
from tests.backends.running import LANES, differs, run

jax.config.update("jax_enable_x64", True)

Function = Callable[[Any, Any], Any]


def _fract(x: Any) -> Any:
    return x - jnp.floor(x)


def _smoothstep(a: Any, b: Any, x: Any) -> Any:
    t = jnp.clip((x - a) / (b - a), 0, 1)
    return t * t * (3 - 2 * t)


def _reflect(i: Any, n: Any) -> Any:
    return i - 2 * jnp.dot(n, i) * n


def _refract(i: Any, n: Any, eta: Any) -> Any:
    k = 1 - eta * eta * (1 - jnp.dot(n, i) ** 2)
    return eta * i - (eta * jnp.dot(n, i) + jnp.sqrt(k)) * n


SHPY = SimpleNamespace(**{n: getattr(sh, n) for n in dir(sh) if n[0] != "_"}, vec=sh.vec3)
JAX = SimpleNamespace(
    **{n: getattr(jnp, n) for n in "sin cos tan sinh cosh tanh exp exp2 log log2 log10 sqrt cbrt floor sign".split()},
    **{n: getattr(jnp, n) for n in "expm1 log1p hypot abs dot cross".split()},
    **{n: getattr(jnp, f"arc{n[1:]}") for n in "asin acos atan asinh acosh atanh atan2".split()},
    erf=jax.scipy.special.erf,
    erfc=jax.scipy.special.erfc,
    rsqrt=lambda x: 1 / jnp.sqrt(x),
    exp10=lambda x: 10.0**x,
    sinpi=lambda x: jnp.sin(math.pi * x),
    cospi=lambda x: jnp.cos(math.pi * x),
    pow=jnp.power,
    min=jnp.minimum,
    max=jnp.maximum,
    clamp=jnp.clip,
    fract=_fract,
    mod=jnp.mod,
    mix=lambda a, b, t: a * (1 - t) + b * t,
    smoothstep=_smoothstep,
    cond=jnp.where,
    length=jnp.linalg.norm,
    distance=lambda a, b: jnp.linalg.norm(a - b),
    normalize=lambda v: v / jnp.linalg.norm(v),
    reflect=_reflect,
    refract=_refract,
    vec=lambda *parts: jnp.stack([jnp.asarray(x, jnp.float64) for x in parts]),
)

UNARY = """sin cos tan asin acos atan sinh cosh tanh asinh atanh exp exp2 exp10 log log2 log10 sqrt rsqrt cbrt expm1
log1p erf erfc sinpi cospi""".split()


def box(m: Any, p: Any) -> Any:
    q = abs(p) - m.vec(0.3, 0.2, 0.25)
    return m.length(m.max(q, 0.0)) + m.min(m.max(q[0], m.max(q[1], q[2])), 0.0)


def torus(m: Any, p: Any) -> Any:
    x, y, z = p
    return m.hypot(m.hypot(x, z) - 0.7, y) - 0.2


def melted(m: Any, p: Any) -> Any:
    balls = [(0.1, 0.2, 0.3), (0.7, 0.5, 0.2), (0.4, 0.9, 0.6)]
    return -0.1 * m.log(sum(m.exp(-m.distance(p, m.vec(*c)) / 0.1) for c in balls))


def gyroid(m: Any, p: Any) -> Any:
    (x, y, z), k = p, 4.3
    return m.sin(k * x) * m.cos(k * y) + m.sin(k * y) * m.cos(k * z) + m.sin(k * z) * m.cos(k * x)


def folded(m: Any, p: Any) -> Any:
    for k in range(4):
        p = abs(p * 1.7 - m.vec(0.61, 0.47, 0.83)) - 0.05 * k
    return m.length(p) / 1.7**4


def phong(m: Any, p: Any) -> Any:
    n, light, eye = m.normalize(p), m.normalize(m.vec(0.3, 0.8, 0.5)), m.normalize(m.vec(0.1, 0.2, 0.9))
    return m.max(m.dot(n, light), 0.0) + 0.4 * m.pow(m.max(m.dot(m.reflect(-light, n), eye), 1e-3), 12.0)


def ggx(m: Any, p: Any) -> Any:
    h, n, a = m.normalize(p), m.vec(0.0, 0.0, 1.0), p[0] * p[0]
    c = m.dot(h, n)
    d = c * c * (a * a - 1) + 1
    return a * a / (math.pi * d * d) + m.pow(1 - c, 5.0)


def glass(m: Any, p: Any) -> Any:
    bent = m.refract(m.normalize(m.vec(0.3, -0.2, -0.9)), m.normalize(p), 0.7)
    return m.dot(bent, m.vec(1.0, 2.0, 3.0))


def fresnel(m: Any, p: Any) -> Any:
    c, eta = m.normalize(p)[2], 1.5 + 0.1 * p[0]
    t = m.sqrt(1 - (1 - c * c) / (eta * eta))
    s, q = (c - eta * t) / (c + eta * t), (t - eta * c) / (t + eta * c)
    return 0.5 * (s * s + q * q)


def sphere_hit(m: Any, p: Any) -> Any:
    d, o = m.normalize(p), m.vec(-2.0, -2.1, -1.9)
    b, c = m.dot(o, d), m.dot(o, o) - 1.5
    return -b - m.sqrt(m.max(b * b - c, 0.1))


def mandelbrot(m: Any, p: Any) -> Any:
    x, y, a, b = 0.0 * p[0], 0.0 * p[1], p[0] * 0.4 - 0.6, p[1] * 0.4
    for _ in range(8):
        x, y = x * x - y * y + a, 2 * x * y + b
    return m.log(x * x + y * y + p[2])


def newton(m: Any, p: Any) -> Any:
    x, c = 1.0 + 0 * p[0], p[0] + p[1] * p[2]
    for _ in range(6):
        x = x - (x * x * x + x - c) / (3 * x * x + 1)
    return x


def bodies(m: Any, p: Any) -> Any:
    places = [m.vec(math.sin(k), math.cos(k * 1.3), math.sin(k * 0.7) - 2) for k in range(9)]
    return sum(m.rsqrt(m.dot(p - q, p - q) + 0.01) for q in places)


def lennard_jones(m: Any, p: Any) -> Any:
    pair = lambda r: r**-6.0 * (r**-6.0 - 1) if m is JAX else m.pow(r, -6.0) * (m.pow(r, -6.0) - 1)  # noqa: E731
    return pair(m.length(p) + 0.4) + pair(m.distance(p, m.vec(2.0, 2.1, 1.9)))


def pendulum(m: Any, p: Any) -> Any:
    """Step by the method of Runge and Kutta."""
    f = lambda q, v: (v, -p[2] * m.sin(q) - 0.1 * v)  # noqa: E731
    q, v, h = p[0], p[1], 0.1
    for _ in range(6):
        a = f(q, v)
        b = f(q + h / 2 * a[0], v + h / 2 * a[1])
        c = f(q + h / 2 * b[0], v + h / 2 * b[1])
        d = f(q + h * c[0], v + h * c[1])
        q, v = (x + h / 6 * (a[k] + 2 * b[k] + 2 * c[k] + d[k]) for k, x in enumerate((q, v)))
    return q * q + v


def turned(m: Any, p: Any) -> Any:
    """Turn a vector by a quaternion."""
    v, axis, angle = m.vec(0.3, -0.4, 0.9), m.normalize(p), m.length(p)
    u, w = m.sin(angle / 2) * axis, m.cos(angle / 2)
    t = 2 * m.cross(u, v)
    return m.dot(v + w * t + m.cross(u, t), m.vec(1.0, 2.0, 3.0))


def determinant(m: Any, p: Any) -> Any:
    rows = [m.sin(p), m.cos(p * p), p * m.vec(1.0, 2.0, 0.5)]
    return m.dot(rows[0], m.cross(rows[1], rows[2]))


def rosenbrock(m: Any, p: Any) -> Any:
    return sum(100 * (p[k + 1] - p[k] * p[k]) * (p[k + 1] - p[k] * p[k]) + (1 - p[k]) * (1 - p[k]) for k in range(2))


def ackley(m: Any, p: Any) -> Any:
    waves = sum(m.cospi(2 * x) for x in p) / 3
    return -20 * m.exp(-0.2 * m.sqrt(m.dot(p, p) / 3)) - m.exp(waves)


def softmax(m: Any, p: Any) -> Any:
    top = m.max(p[0], m.max(p[1], p[2]))
    return top + m.log(sum(m.exp(3 * (x - top)) for x in p)) - p[1]


def layers(m: Any, p: Any) -> Any:
    """Compute a small network."""
    rng, x = np.random.default_rng(2), p
    for _ in range(3):
        x = m.tanh(m.vec(*(m.dot(m.vec(*map(float, row)), x) + 0.1 for row in rng.normal(size=(3, 3)))))
    return m.dot(x, x)


def interest(m: Any, p: Any) -> Any:
    """Price an option by the formula of Black and Scholes."""
    rate, width, time = 0.1 * p[0], 0.2 + 0.1 * p[1], p[2]
    d = (m.log(1.1 + 0 * time) + (rate + width * width / 2) * time) / (width * m.sqrt(time))
    normal = lambda x: 0.5 * m.erfc(-x * math.sqrt(0.5))  # noqa: E731
    return 1.1 * normal(d) - m.exp(-rate * time) * normal(d - width * m.sqrt(time))


def stripes(m: Any, p: Any) -> Any:
    t = m.fract(3.37 * p[0] + 0.2 * m.sin(p[1]))
    return m.mix(p[1], p[2] * p[2], m.smoothstep(-0.1, 1.2, t)) + m.mod(p[2], 0.37) * m.sign(p[0] - 3)


def chosen(m: Any, p: Any) -> Any:
    x, y, z = p
    inner = m.cond(x > y, x * x * z, m.sqrt(y) / x)
    return m.cond(m.sin(9 * x) > 0.1, inner, inner * m.clamp(z, 0.45, 0.9) + m.min(x, y))


def series(m: Any, p: Any) -> Any:
    """Sum the series of a Bessel function."""
    term, total, t = 1.0 + 0 * p[0], 1.0 + 0 * p[0], p[0] * p[1]
    for k in range(1, 12):
        term = -term * t * t / (4.0 * k * k)
        total = total + term
    return total * p[2]


def angles(m: Any, p: Any) -> Any:
    return m.atan2(p[1], p[0]) * m.acos(p[2] / m.length(p)) + m.pow(p[0], p[1]) + m.hypot(p[0], p[2])


FUNCTIONS: dict[str, Function] = {
    **{name: lambda m, p, name=name: getattr(m, name)(p[0] * p[1]) * p[2] + getattr(m, name)(p[2]) for name in UNARY},
    "acosh": lambda m, p: m.acosh(1 + p[0]) * m.acosh(2 * p[1] + p[2] + 1),
    **{
        f.__name__: f
        for f in (box, torus, melted, gyroid, folded, phong, ggx, glass, fresnel, sphere_hit, mandelbrot, newton)
        + (bodies, lennard_jones, pendulum, turned, determinant, rosenbrock, ackley, softmax, layers, interest)
        + (stripes, chosen, series, angles)
    },
}
SHARES = [list(FUNCTIONS)[k::9] for k in range(9)]
PLACES = np.random.default_rng(11).uniform(0.15, 0.95, (200, 3))


def program_of(names: list[str]) -> sh.Program:
    """Return the program of the value of each function and its gradients in both modes."""

    def derived(f: Function, p: Any) -> Any:
        g = lambda q: f(SHPY, q)  # noqa: E731
        return *sh.gradient(g, value=True)(p), sh.gradient(g, mode="reverse")(p)

    @sh.program
    def own(p: sh.Attrib3f):
        return tuple(x for name in names for x in derived(FUNCTIONS[name], p))

    return own


@pytest.mark.parametrize("name", FUNCTIONS)
def test_gradients_are_those_of_jax(name: str) -> None:
    f = FUNCTIONS[name]
    value, slopes = jax.jit(jax.vmap(jax.value_and_grad(lambda p: f(JAX, p))))(PLACES)
    assert np.isfinite(slopes).all()
    size = np.linalg.norm(slopes, axis=-1, keepdims=True)

    own_value, *both = program_of([name]).compile("numpy", precision="f64")(PLACES)
    np.testing.assert_allclose(own_value, value, rtol=1e-12, atol=1e-13)
    for mode, own_slopes in zip(("forward", "reverse"), both, strict=True):
        error = (np.abs(own_slopes - slopes) / size).max()
        assert error < 1e-13, f"{mode}: {error:.3g}"


@pytest.mark.parametrize("names", SHARES, ids=lambda names: names[0])
def test_gradients_have_the_same_bits(names: list[str]) -> None:
    program, places = program_of(names), PLACES.astype(np.float32)
    expected = run(program, "numpy", places).outputs
    for target in (*LANES, "glsl"):
        for k, (a, b) in enumerate(zip(run(program, target, places).outputs, expected, strict=True)):
            assert not differs(a, b).any(), f"{names[k // 3]}, {('value', 'forward', 'reverse')[k % 3]}, on {target}"
