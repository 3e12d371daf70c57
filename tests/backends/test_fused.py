"""`fuse=True`: the same bits on every backend, and what the rule says they are."""

import pickle
import threading
from fractions import Fraction

import dask.array as da
import numpy as np
import pytest
from backends.running import covering, kernel
from rational import each

import shpy as sh
from shpy.backend.device.probe import EMULATED
from shpy.testing.observers import Setting, observer

PRECISIONS = {"f16": np.float16, "f32": np.float32, "f64": np.float64}
RNG = np.random.default_rng(5)


def numbers(count=400, seed=0, dtype=np.float32):
    """Random numbers of several sizes, and those at the edges."""
    rng, info = np.random.default_rng(seed), np.finfo(dtype)
    edges = [0.0, -0.0, 1, -1, np.inf, -np.inf, np.nan, info.max, info.tiny, info.smallest_subnormal, 1 + info.eps]
    drawn = rng.normal(size=count - 2 * len(edges)) * 2.0 ** rng.integers(-6, 6, count - 2 * len(edges))
    return rng.permutation(np.concatenate([edges, rng.permutation(edges), drawn])).astype(dtype)


@sh.program
def horner(x: sh.Attrib1f) -> sh.Attrib1f:
    return ((0.1 * x + 0.7) * x - 0.3) * x + 1.9


@sh.program
def complex_product(a: sh.Attrib2f, b: sh.Attrib2f) -> sh.Attrib2f:
    return sh.Attrib2f(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x)


@sh.program
def composites(v: sh.Attrib3f, w: sh.Attrib3f, t: sh.Attrib1f):
    product = sh.Matrix3f(v, w, sh.cross(v, w)) @ w
    return sh.mix(v, w, t), sh.dot(v, w) + t, sh.mad(t, t, 0.25), sh.reflect(v, w), sh.normalize(v), product


@sh.program
def others(v: sh.Attrib3f, w: sh.Attrib3f, t: sh.Attrib1f):
    return (
        sh.length(v),
        sh.distance(v, w),
        sh.smoothstep(-1.0, 2.0, t),
        sh.refract(v, w, t),
        sh.mod(t, 0.7),
        v + w.x * t,
    )


@sh.subroutine
def blend(total: sh.Attrib1f, x: sh.Attrib1f) -> sh.Attrib1f:
    total += x * x
    return total * x


@sh.program
def control(x: sh.Attrib1f, n: sh.Attrib1i):
    total = sh.Attrib1f(0.5)
    with sh.SH_FOR(0, n & 7) as k:
        step = x * 0.25
        with sh.SH_IF(k == 3):
            step += 1
        total[:] = total * step - x
        total += blend(total, x)
    return total, sh.sin(x * total - 1)


PROGRAMS = {p.name: p for p in (horner, complex_product, composites, others, control)}


def inputs_of(program, precision="f32", count=400):
    """Arrays for the inputs of a program, each of its own."""
    arrays = []
    for seed, type in enumerate(program.inputs.values()):
        of_floats = numbers(count * type.type.size, seed, PRECISIONS[precision])
        array = of_floats if type.type.is_float else RNG.integers(0, 100, count).astype(np.int32)
        arrays.append(array.reshape(count, -1) if type.type.size > 1 else array)
    return arrays


@pytest.mark.sampled(6)
@pytest.mark.parametrize("name", PROGRAMS)
def test_every_backend_gives_the_bits_of_the_interpreter(name):
    backends = ["interpreter", *covering(list(PROGRAMS).index(name))]
    sh.testing.assert_equivalent(PROGRAMS[name], *inputs_of(PROGRAMS[name]), backends=backends, fuse=True)


def having(precision):
    """Backends that have a precision: GLSL 3.30 has no binary64."""
    return ["interpreter", "numpy", "opencl-1", "opencl-8", *["glsl"] * (precision != "f64")]


@pytest.mark.sampled(12)
@pytest.mark.parametrize("precision", ["f16", "f64"])
@pytest.mark.parametrize("name", PROGRAMS)
def test_other_precisions(name, precision):
    arrays = inputs_of(PROGRAMS[name], precision, 200)
    sh.testing.assert_equivalent(PROGRAMS[name], *arrays, backends=having(precision), precision=precision, fuse=True)


def test_portable_mode():
    sh.testing.assert_equivalent(control, *inputs_of(control), math="portable", fuse=True, backends=covering(2))


def finite(*shape, precision="f32"):
    return (RNG.normal(size=shape) * 2.0 ** RNG.integers(-4, 4, shape)).astype(PRECISIONS[precision])


@pytest.mark.sampled(4)
@pytest.mark.parametrize("backend", ["interpreter", "prepared", "numpy", "numpy-5", "opencl-1", "opencl-16", "glsl"])
def test_closed_forms(backend):
    x, (a, b) = finite(200), finite(2, 200, 2)
    t, s, r, q = (np.float32(v) for v in (0.1, 0.7, -0.3, 1.9))
    right = each(each(each(t, x, s), x, r), x, q)
    assert np.array_equal(kernel(horner, backend, fuse=True)(x), right)
    real = each(a[:, 0], b[:, 0], -(a[:, 1] * b[:, 1]))
    imaginary = each(a[:, 0], b[:, 1], a[:, 1] * b[:, 0])
    assert np.array_equal(kernel(complex_product, backend, fuse=True)(a, b), np.stack([real, imaginary], 1))


def dot_of(v, w):
    """The sum from the first component on, of which each product but the first is contracted."""
    total = each(v[:, 0], w[:, 0], v[:, 1] * w[:, 1])
    return each(v[:, 2], w[:, 2], total)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("backend", ["interpreter", "numpy", "opencl-1", "opencl-8", "glsl"])
def test_closed_forms_of_composites(backend):
    (v, w), t = finite(2, 120, 3), finite(120)
    mixed, dotted, summed, mirrored, _, product = kernel(composites, backend, fuse=True)(v, w, t)
    wide = t[:, None]
    assert np.array_equal(mixed, each(v, 1 - wide, w * wide))
    assert np.array_equal(dotted, dot_of(v, w) + t)
    assert np.array_equal(summed, each(t, t, np.float32(0.25)))
    assert np.array_equal(mirrored, each(-(2 * dot_of(w, v))[:, None], w, v))
    across = each(v[:, [1, 2, 0]], w[:, [2, 0, 1]], -(v[:, [2, 0, 1]] * w[:, [1, 2, 0]]))
    assert np.array_equal(product, np.stack([dot_of(row, w) for row in (v, w, across)], 1))


@sh.program
def residual(a: sh.Attrib1f, b: sh.Attrib1f):
    p = a * b
    return a * b - p, p - a * b, a * b + -p


@pytest.mark.sampled(6)
@pytest.mark.parametrize(("backend", "precision"), [(b, p) for p in PRECISIONS for b in having(p)])
def test_the_error_of_a_product(backend, precision):
    a, b = finite(2, 200, precision=precision)
    plain = kernel(residual, backend, precision=precision)(a, b)
    assert not np.any(plain)
    error = np.array(
        [Fraction(float(x)) * Fraction(float(y)) - Fraction(float(x * y)) for x, y in zip(a, b, strict=True)], float
    )
    assert error.any()
    for result in kernel(residual, backend, precision=precision, fuse=True)(a, b):
        assert np.array_equal(result, error.astype(a.dtype))


# Where it meets other parts


STEPPED = {"numpy": {}, "opencl": {"lanes": 8}, "glsl": {}}


@sh.program
def decay(x: sh.Attrib1f, v: sh.Attrib1f):
    return {"x": x + v * 0.1, "v": v - x * 0.1}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", STEPPED)
def test_streams_and_chains(backend):
    x, v = finite(2, 500)
    step = decay.compile(backend, fuse=True, **STEPPED[backend])
    streams = step(*(sh.Stream(a, sh.Attrib1f, backend=backend) for a in (x, v)))
    chained = sh.repeat(step, 5).run(x=x, v=v)
    dt = np.float32(0.1)
    for k in range(5):
        x, v = each(v, dt, x), each(-x, dt, v)
        if k == 0:
            assert np.array_equal(streams["x"].numpy(), x)
    assert np.array_equal(chained.streams["x"].numpy(), x)
    assert np.array_equal(chained.streams["v"].numpy(), v)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", STEPPED)
def test_textures_and_tables(backend):
    texture, table = sh.Texture2D(finite(4, 5), filter="linear"), sh.Table(finite(8), sh.Attrib1f)

    @sh.program
    def sampled(uv: sh.TexCoord2f, n: sh.Attrib1i) -> sh.Attrib1f:
        return texture(uv) * table[n] + table[n + 1]

    uv, n = RNG.random((100, 2)).astype(np.float32), RNG.integers(0, 6, 100).astype(np.int32)
    sh.testing.assert_equivalent(sampled, uv, n, backends=["interpreter", backend], fuse=True)


def test_blocks_of_dask_arrays():
    x = finite(64)
    blocks = sh.map_blocks(horner.compile("numpy", fuse=True), da.from_array(x, chunks=20))
    assert np.array_equal(blocks.compute(scheduler="synchronous"), horner.compile("numpy", fuse=True)(x))


def test_elements_that_are_left_out():
    x = finite(300)
    where = x > 0
    for backend in STEPPED:
        result = horner.compile(backend, fuse=True).run(x, where=where)
        assert np.array_equal(result.outputs[where], horner.compile("numpy", fuse=True)(x)[where])
        assert not result.outputs[~where].any()


def test_discarded_elements_are_decided_by_contracted_sums():
    """A shorter program finds the few elements that go on first: it has to contract the same sums."""

    @sh.program
    def rare(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
        p = a * b
        sh.SH_DISCARD(a * b - p <= 0)
        return a + b

    a, b = finite(2, 200_000)
    sparse = np.where(np.arange(a.size) % 97 == 0, a, 1).astype(np.float32)  # products with 1 have no error
    results = [rare.compile(backend, fuse=True).run(sparse, b) for backend in STEPPED]
    assert 0 < np.count_nonzero(results[0].written) < 2000
    for other in results[1:]:
        assert np.array_equal(other.written, results[0].written)
        assert np.array_equal(other.outputs, results[0].outputs)


def test_kernels_are_kept_apart_pickled_and_run_in_threads():
    a, b = finite(2, 100)
    plain, fused = residual.compile("numpy"), residual.compile("numpy", fuse=True)
    assert plain is not fused
    assert residual.compile("numpy", fuse=True) is fused
    again = pickle.loads(pickle.dumps(fused))
    assert again.options.fuse
    assert np.array_equal(again(a, b), fused(a, b))
    results = {}

    def run(fuse):
        results[fuse] = residual.compile("opencl", fuse=fuse)(a, b)

    threads = [threading.Thread(target=run, args=(fuse,)) for fuse in (True, False)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert np.array_equal(results[True], fused(a, b))
    assert not np.any(results[False])


def test_the_backend_that_changes_on_its_own():
    x = finite(3_000_000)
    kernel = horner.compile("auto", fuse=True)
    assert np.array_equal(kernel(x), horner.compile("opencl", fuse=True)(x))
    assert np.array_equal(kernel(x), horner.compile("numpy", fuse=True)(x))


def test_uniforms_outside_of_a_program_are_rounded_at_each_step():
    a, b = sh.Param(sh.Attrib1f, 1 + 2**-12, name="a"), sh.Param(sh.Attrib1f, 1 - 2**-13, name="b")
    outside = a * b - 1

    @sh.program
    def both(x: sh.Attrib1f):
        return x + outside, x + (a * b - 1)

    one, other = both.compile("numpy", fuse=True)(np.float32(0))
    assert one == np.float32(np.float32(a.value) * np.float32(b.value)) - 1
    assert other == float(np.float32(1 + 2**-12)) * float(np.float32(1 - 2**-13)) - 1
    assert one != other


def test_notes_say_where_it_is_slower():
    assert EMULATED in horner.compile("numpy", fuse=True).notes
    assert EMULATED not in horner.compile("numpy").notes
    assert EMULATED in horner.compile("opencl", precision="f16", fuse=True).notes
    machine = horner.compile("opencl", fuse=True)
    assert (EMULATED in machine.notes) == any("gets fma" in note for note in machine.notes)


def test_a_product_through_fma_is_rounded():
    @sh.program
    def guarded(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
        return sh.fma(a, b, -0.0) - a * b

    a, b = finite(2, 50)
    assert np.array_equal(guarded.compile("opencl", fuse=True)(a, b), each(-a, b, a * b))


def test_elementary_functions_keep_their_formulas():
    @sh.program
    def waves(x: sh.Attrib1f):
        return sh.sin(x), sh.exp(x), sh.pow(x, 1.7), sh.hypot(x, 2.0), sh.atan2(x, 0.3)

    x = finite(500)
    for backend in STEPPED:
        for one, other in zip(waves.compile(backend)(x), waves.compile(backend, fuse=True)(x), strict=True):
            assert np.array_equal(one, other, equal_nan=True)


@pytest.mark.parametrize("math", ["relaxed", "fast"])
def test_modes_that_contract_by_themselves_refuse_it(math):
    with pytest.raises(sh.ShpyTypeError) as error:
        horner.compile("numpy", math=math, fuse=True)
    assert error.value.message == f"math='{math}' contracts products and sums already, as each target likes"
    assert error.value.cure == 'math="strict", fuse=True, or math="portable", fuse=True: the same bits everywhere'


def test_anything_but_a_bool_is_refused():
    with pytest.raises(sh.ShpyTypeError, match="compile does not take fuse='yes'"):
        horner.compile("numpy", fuse="yes")


@pytest.mark.sampled(3)
@pytest.mark.parametrize("target", ["numpy", "opencl-8", "interpreter"])
def test_a_program_that_is_watched_computes_the_same(target):
    a, b = finite(2, 20)
    seen = observer(Setting(residual, (a, b), {}, None, {"fuse": True}), target, 7)
    events = range(seen.count)
    looked = seen.look(frozenset(seen.site(event) for event in events))
    values = [looked.seen(event).value for event in events]
    assert residual.compile("numpy", fuse=True)(a, b)[0][7] in values
