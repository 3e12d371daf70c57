"""The cost of derivatives: a value with its gradient by three inputs, beside the value alone, differences, and peers.

    print(gradients(Setup(quick=True)).markdown())

The four programs are compiled for OpenCL where there is a device, otherwise for numpy, in strict mode, and read and
write streams, so that only kernels count. Differences are central ones: six evaluations in one kernel. JAX and Dr.Jit,
where they are installed, read and write arrays of their own, one for each component.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np

import shpy as sh
from benchmarks import peers
from benchmarks.rounds import Apart, in_turns, peer_run
from benchmarks.studies import backend
from benchmarks.tables import Setup, Table
from benchmarks.work import Run
from shpy import SH_FOR

ELEMENTS, ROUNDS = 1_000_000, 9
STEP = 2.0**-10
"""The step of the differences; none is right for all elements."""
PLACES = np.random.default_rng(7).normal(size=(12, 3)).astype(np.float32)
BODIES = sh.Table(PLACES, sh.Attrib3f)


@sh.program
def box(p: sh.Attrib3f) -> sh.Attrib1f:
    q = sh.abs(p) - sh.vec3(1, 0.5, 0.25)
    return sh.length(sh.max(q, 0)) + sh.min(sh.max(q.x, sh.max(q.y, q.z)), 0)


@sh.program
def phong(p: sh.Attrib3f) -> sh.Attrib1f:
    normal, eye = sh.vec3(0, 0, 1), sh.normalize(sh.vec3(0.5, 0.25, 1))
    light = sh.normalize(p - sh.vec3(0.1, 0.2, 0.3))
    shine = sh.max(sh.dot(sh.reflect(-light, normal), eye), 0)
    return 0.1 + 0.6 * sh.max(sh.dot(normal, light), 0) + 0.3 * sh.pow(shine, 20)


@sh.program
def ggx(p: sh.Attrib3f) -> sh.Attrib1f:
    rough, facing, metal = (sh.mix(0.05, 1, sh.fract(sh.abs(c))) for c in (p.x, p.y, p.z))
    square = rough * rough * rough * rough
    around = facing * facing * (square - 1) + 1
    masked = facing + sh.sqrt(square + (1 - square) * facing * facing)
    fresnel = metal + (1 - metal) * sh.pow(1 - facing, 5)
    return square * fresnel / (np.pi * around * around * masked * masked)


@sh.program
def nbody(p: sh.Attrib3f) -> sh.Attrib1f:
    energy = sh.Attrib1f(0)
    with SH_FOR(0, 12) as k:
        way = BODIES[k] - p
        energy -= sh.rsqrt(sh.dot(way, way) + 1e-4)
    return energy


PROGRAMS = {"box": box, "Phong": phong, "GGX": ggx, "n-body, 12 bodies": nbody}


# The same by components, for peers; `m` has their functions


def box_of(m: Any, x: Any, y: Any, z: Any) -> Any:
    a, b, c = m.abs(x) - 1, m.abs(y) - 0.5, m.abs(z) - 0.25
    outside = sum(q * q for q in (m.maximum(a, 0), m.maximum(b, 0), m.maximum(c, 0)))
    return m.sqrt(outside) + m.minimum(m.maximum(a, m.maximum(b, c)), 0)


def phong_of(m: Any, x: Any, y: Any, z: Any) -> Any:
    x, y, z = x - 0.1, y - 0.2, z - 0.3
    scale, eye = m.rsqrt(x * x + y * y + z * z), np.float32([0.5, 0.25, 1]) / np.float32(np.sqrt(1.3125))
    shine = m.maximum(scale * (z * float(eye[2]) - x * float(eye[0]) - y * float(eye[1])), 0)
    return 0.1 + 0.6 * m.maximum(scale * z, 0) + 0.3 * m.power(shine, 20)


def ggx_of(m: Any, *p: Any) -> Any:
    parts = [m.abs(c) - m.floor(m.abs(c)) for c in p]
    rough, facing, metal = (0.05 + 0.95 * c for c in parts)
    square = rough * rough * rough * rough
    around = facing * facing * (square - 1) + 1
    masked = facing + m.sqrt(square + (1 - square) * facing * facing)
    fresnel = metal + (1 - metal) * m.power(1 - facing, 5)
    return square * fresnel / (np.pi * around * around * masked * masked)


def nbody_of(m: Any, *p: Any) -> Any:
    squares = (sum((b - c) * (b - c) for b, c in zip(body, p, strict=True)) for body in PLACES.tolist())
    return -sum(m.rsqrt(square + 1e-4) for square in squares)


def misfit_of(m: Any, sheet: Any, u: Any, v: Any, target: Any) -> Any:
    """Return the squares of the differences between a texture of 64 x 64, which is a flat array, and the target."""
    x, y = (m.minimum(m.maximum(c * 64 - 0.5, 0), 63) for c in (u, v))
    left, top = (m.minimum(m.floor(c), 62) for c in (x, y))
    a, b, corner = x - left, y - top, m.int(top * 64 + left)
    rows = (m.take(sheet, corner + k) * (1 - a) + m.take(sheet, corner + k + 1) * a for k in (0, 64))
    d = next(rows) * (1 - b) + next(rows) * b - target
    return d * d


OF_PEERS = {"box": box_of, "Phong": phong_of, "GGX": ggx_of, "n-body, 12 bodies": nbody_of}


def with_jax(f: Any, wrt: slice, arrays: Any) -> Callable[[], Any]:
    """Return the run of JAX that gives the values of f and the derivatives of their sum by some arguments."""
    import jax
    import jax.numpy as jnp

    names = ("abs", "floor", "maximum", "minimum", "sqrt", "power", "take")
    functions = {n: getattr(jnp, n) for n in names}
    m = SimpleNamespace(**functions, rsqrt=jax.lax.rsqrt, int=lambda x: x.astype(jnp.int32))
    arguments = [jnp.asarray(a) for a in arrays]

    @jax.jit
    def both(*p: Any) -> Any:
        values, back = jax.vjp(partial(f, m), *p)
        return values, back(jnp.ones_like(values))[wrt]

    return lambda: jax.block_until_ready(both(*arguments))


def with_drjit(f: Any, wrt: slice, arrays: Any) -> Callable[[], Any]:
    """Return the run of Dr.Jit that gives the values of f and the derivatives of their sum by some arguments."""
    import drjit as dr
    from drjit.llvm.ad import Float, Int

    names = ("abs", "floor", "maximum", "minimum", "sqrt", "power", "rsqrt")
    functions = {n: getattr(dr, n) for n in names}
    m = SimpleNamespace(**functions, take=lambda a, index: dr.gather(Float, a, index), int=Int)
    arguments = [Float(np.ascontiguousarray(a)) for a in arrays]

    def both() -> Any:
        p = [Float(a) for a in arguments]
        dr.enable_grad(p[wrt])
        values = f(m, *p)
        dr.backward(values)
        slopes = [dr.grad(x) for x in p[wrt]]
        dr.eval(values, slopes)
        dr.sync_thread()
        return values, slopes

    return both


def runs_of_peers(setup: Setup, ending: ExitStack, f: Any, wrt: slice, arrays: Any) -> dict[str, Apart]:
    """Return the runs of the setup's peers, by their labels, in processes that end with a block."""
    makers = {"jax": with_jax, "drjit": with_drjit}
    return {
        peers.PEERS[name].label: ending.enter_context(peer_run(name, makers[name], f, wrt, arrays))
        for name in setup.installed(*makers)
    }


def check(way: str, numbers: Sequence[np.ndarray], own: Sequence[np.ndarray]) -> None:
    """Raise ArithmeticError where a peer's finite numbers are others than ours: another program was timed."""
    for a, b in zip(numbers, own, strict=True):
        with np.errstate(invalid="ignore"):
            off = np.abs(a - b) > 1e-3 * (1 + np.abs(b))
        if off.mean() > 1e-3:
            raise ArithmeticError(f"{way} computes other numbers: {a[off][:3]}, and shpy {b[off][:3]}")


def differences(program: sh.Program) -> sh.Program:
    """Return the program of the value and of its central differences along each axis."""

    @sh.program
    def sloped(p: sh.Attrib3f) -> tuple[sh.Attrib1f, sh.Attrib3f]:
        axes = np.eye(3) * STEP
        slopes = [(program(p + sh.vec3(*axis)) - program(p - sh.vec3(*axis))) / (2 * STEP) for axis in axes]
        return program(p), sh.vec3(*slopes)

    return sloped


def waiting(kernel: Any, streams: list[sh.Stream], out: Any) -> None:
    """Run a kernel, and wait until its device has finished."""
    kernel.run(*streams, out=out)
    streams[0].place.space.finish()


def timed(
    ways: dict[str, sh.Program],
    streams: list[sh.Stream],
    target: str,
    quick: bool,
    others: Mapping[str, Apart] = MappingProxyType({}),
) -> dict[str, list[float]]:
    """Return the seconds of each round of programs over the same streams, and of other runs."""
    kernels = {way: program.compile(target) for way, program in ways.items()}
    runs = {way: partial(waiting, kernel, streams, kernel(*streams)) for way, kernel in kernels.items()}
    every: dict[str, Run | Apart] = {**runs, **others}
    return {way: times.seconds for way, times in in_turns(every, 2 if quick else ROUNDS).items()}


def gradients(setup: Setup) -> Table:
    """Measure each program, and its value with a gradient in three ways and by peers, in turns."""
    count, target = (1_000 if setup.quick else ELEMENTS), backend()
    array = np.random.default_rng(3).normal(size=(count, 3)).astype(np.float32)
    points = sh.Stream(array, sh.Attrib3f, target)
    rows, rounds, others = [], {}, dict[str, Apart]()
    for name, program in PROGRAMS.items():
        ways = {
            "value": program,
            "forward": program.gradient("p", value=True),
            "reverse": program.gradient("p", value=True, mode="reverse"),
            "differences": differences(program),
        }
        value, slope = ways["forward"].compile(target)(array)
        with ExitStack() as ending:
            others = runs_of_peers(setup, ending, OF_PEERS[name], slice(0, 3), array.T)
            for peer, run in others.items():
                check(f"{peer}, {name},", run(0), [value, *slope.T])
            seconds = {way: np.array(each) for way, each in timed(ways, [points], target, setup.quick, others).items()}
        whole, forward = seconds["value"], seconds["forward"]
        cells = [f"{np.median(seconds[way] / whole):.2f}" for way in list(ways)[1:]]
        for peer in others:
            cells += [f"{1e9 * np.median(seconds[peer]) / count:.2f}", f"{np.median(seconds[peer] / forward):.2f}"]
        rows.append([name, f"{1e9 * np.median(whole) / count:.2f}", *cells])
        rounds |= {f"{name}, {way}": each.tolist() for way, each in seconds.items()}
    note = f"A value and its gradient by three inputs, {count:,} elements on {target}: medians of ratios to the value."
    heads = [h for peer in others for h in (f"{peer}, ns", "of forward")]
    return Table("gradients", note, ["program", "value, ns", *list(ways)[1:], *heads], rows, rounds)


def chained(count: int) -> sh.Program:
    """Return a program of `count` numbers in vectors of four, whose last statements depend on all of them."""
    names = [f"x{k}" for k in range(count // 4)]

    def mixed(*vectors: Any) -> Any:
        total = sh.Attrib1f(0)
        for x in (x for v in vectors for x in v):
            total = total * 0.9 + x * x
        for _ in range(24):
            total = total * total * 0.01 + total * 0.5
        return total

    space: dict[str, Any] = {"sh": sh, "mixed": mixed}
    inputs = ", ".join(f"{n}: sh.Attrib4f" for n in names)
    exec(f"@sh.program\ndef chain({inputs}) -> sh.Attrib1f:\n    return mixed({', '.join(names)})\n", space)
    program: sh.Program = space["chain"]
    return program


def components(setup: Setup) -> Table:
    """Measure forward and reverse mode by the number of components."""
    count, target = (1_000 if setup.quick else ELEMENTS), backend()
    rows, rounds = [], {}
    for size in (8, 16) if setup.quick else (4, 8, 16, 32, 64):
        program = chained(size)
        streams = [sh.Stream(np.full((count, 4), 0.5, np.float32), sh.Attrib4f, target) for _ in program.inputs]
        ways = {
            "value": program,
            **{m: program.gradient(*program.inputs, value=True, mode=m) for m in ("forward", "reverse")},
        }
        seconds = timed(ways, streams, target, setup.quick)
        whole, *others = map(np.array, seconds.values())
        rows.append([str(size), *(f"{np.median(other / whole):.1f}" for other in others)])
        rounds |= {f"{size}, {way}": each for way, each in seconds.items()}
    note = f"A value and its gradient by n numbers, each statement of all of them, {count:,} elements on {target}."
    return Table("components", note, ["n", "forward", "reverse"], rows, rounds)


SHEET = sh.Texture2D(np.zeros((64, 64)), name="sheet")


@sh.program
def add(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a + b


@sh.program
def misfit(uv: sh.TexCoord2f, target: sh.Attrib1f) -> sh.Attrib1f:
    d = SHEET(uv) - target
    return d * d


FIELD = sh.Table(np.random.default_rng(1).random((16, 16, 16)), sh.Attrib1f, name="field")


def filtered(p: Any) -> Any:
    """Return the linear interpolation of the eight elements of FIELD around a place."""
    corner, part = sh.Attrib3i(sh.floor(p * 15)), sh.fract(p * 15)
    shares = sh.vec3(1, 1, 1) - part, part
    total = sh.Attrib1f(0)
    for k, j, i in np.ndindex(2, 2, 2):
        total += shares[i].x * shares[j].y * shares[k].z * FIELD[corner.z + k, corner.y + j, corner.x + i]
    return total


@sh.program
def through(uv: sh.TexCoord2f, target: sh.Attrib1f) -> sh.Attrib1f:
    total = sh.Attrib1f(0)
    with SH_FOR(0, 32) as k:
        total += filtered(sh.vec3(uv, (k + 0.5) / 32)) * 0.03
    return (total - target) * (total - target)


def fitting(setup: Setup) -> Table:
    """Measure a step of fitting a texture of 64 x 64 to 256 x 256 places, its parts, and one with reads in a loop."""
    size, target = (16 if setup.quick else 256), backend()
    random = np.random.default_rng(9)
    arrays = random.random((size, size, 2), np.float32), random.random((size, size), np.float32)
    streams = [sh.Stream(x, cls, target) for x, cls in zip(arrays, misfit.inputs.values(), strict=True)]
    step, step_through = sh.value_and_gradient(misfit, SHEET), sh.value_and_gradient(through, FIELD)
    index = sh.Stream(random.integers(0, 64 * 64, (size, size)), sh.Attrib1i, target)
    kernel = misfit.compile(target)
    runs: dict[str, Run | Apart] = {
        "value, streams": lambda: kernel(*streams).sum(),
        "four scatters, streams": lambda: [sh.scatter(streams[1], index, 4096, combine=add).numpy() for _ in range(4)],
        "step, streams": lambda: step(*streams),
        "step, arrays": lambda: step(*arrays, backend=target),
        "step of 256 reads in a loop, streams": lambda: step_through(*streams),
    }
    value, slopes = step(*streams)
    of_peers = (SHEET.table.host_array().ravel(), *np.moveaxis(arrays[0], -1, 0), arrays[1])
    with ExitStack() as ending:
        for peer, run in runs_of_peers(setup, ending, misfit_of, slice(0, 1), [a.ravel() for a in of_peers]).items():
            errors, by_sheet = run(0)
            check(peer, [np.sum(errors), by_sheet], [value, slopes.ravel()])
            runs[f"step, {peer}"] = run
        in_turns(runs, 1)
        times = in_turns(runs, 2 if setup.quick else ROUNDS)
    rows = [[way, f"{1e3 * np.median(t.seconds):.2f}", f"{1e3 * np.median(t.cpu):.2f}"] for way, t in times.items()]
    note = f"A texture of 64 x 64, filtered linearly, and {size} x {size} places on {target}: medians."
    return Table("fitting", note, ["", "ms", "ms of CPU"], rows, {way: t.seconds for way, t in times.items()})
