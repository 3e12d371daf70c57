"""Params, and the uniforms that follow them: the bits that the program itself would compute, on every target."""

import operator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import shpy as sh
from shpy.run.kernel import forget_data
from shpy.testing.arrays import differing

KERNELS = {
    "numpy": {"backend": "numpy"},
    "opencl": {"backend": "opencl", "lanes": 1},
    "packets": {"backend": "opencl", "lanes": 8},
    "glsl": {"backend": "glsl"},
    "numpy-f64": {"backend": "numpy", "precision": "f64"},
    "opencl-f64": {"backend": "opencl", "lanes": 1, "precision": "f64"},
    "packets-f64": {"backend": "opencl", "lanes": 8, "precision": "f64"},
}
everywhere = pytest.mark.parametrize("options", KERNELS.values(), ids=KERNELS)
X = np.linspace(-2, 3, 19)


def assert_same(found, expected):
    """Bit for bit; every NaN is the same one."""
    for one, other in zip(*(a if isinstance(a, tuple) else (a,) for a in (found, expected)), strict=True):
        assert one.dtype == other.dtype
        assert one.shape == other.shape
        assert not differing(one, other).any()


@sh.struct
class Lens:
    at: sh.Point3f
    turn: sh.Matrix3f
    wide: sh.Attrib1f
    count: sh.Attrib1i


# Dependent uniforms: each case is a function of uniforms, which a program can compute as well

CASES = {
    "operators": lambda f, c, n: (f * 2 - c.x / 3) ** 2.5 // 0.7 % 3 + -f,
    "transcendentals": lambda f, c, n: sh.sin(f) * sh.exp(f / 10) + sh.pow(sh.abs(c), f).zyx + sh.log(sh.abs(c)),
    "mixed": lambda f, c, n: (
        sh.sin(f * 3) / 7 * sh.normalize(c).zxy + sh.cond(n % 3 == 2, sh.unit_float(sh.hash(sh.Attrib1u(n))), f)
    ),
    "vectors": lambda f, c, n: sh.cross(sh.normalize(c), c.zxy * f) + sh.reflect(sh.Vector3f(c), sh.Vector3f(0, 1, 0)),
    "construct": lambda f, c, n: sh.Color3f(c.yx, f) + sh.Attrib3f(n) + sh.Point3f(f),
    "components": lambda f, c, n: sh.Color3f(*reversed(list(c))) * c[n % 3] * c[1:].y,
    "choice": lambda f, c, n: sh.cond((f > 1) & sh.any(c > 4), sh.max(f, c), sh.mix(c, sh.Attrib3f(f), 0.25)),
    "ints": lambda f, c, n: sh.Attrib3f(sh.Attrib1f(sh.hash(sh.Attrib1u(n)) >> 8), sh.popcount(n), (n << 3) // 7),
    "noise": lambda f, c, n: sh.noise(sh.Point3f(c * 1.3)) + sh.noise(f) + sh.Attrib3f(0),
    "matrix": lambda f, c, n: sh.inverse(sh.Matrix3f((f, 1, 0), c, (0, 1, f)) @ sh.Matrix3f()) @ sh.Vector3f(c),
    "edges": lambda f, c, n: sh.Attrib3f(f / 0, sh.sqrt(-f), sh.min(f * 1e30 * 1e30, sh.atan2(f, -0.0))),
}


@pytest.mark.sampled(6)
@pytest.mark.parametrize(
    ("name", "options"),
    [(name, KERNELS[kernel]) for name in CASES for kernel in KERNELS if name == "mixed" or "numpy" in kernel],
)
def test_a_dependent_uniform_has_the_bits_that_the_program_computes(name, options):
    f = sh.Param(sh.Attrib1f, 0.1)
    c = sh.Param(sh.Color3f, (0.5, 0.25, 2))
    n = sh.Param(sh.Attrib1i, 5)
    outside = CASES[name](f, c, n)

    @sh.program
    def used(x: sh.Attrib1f):
        return x + outside, sh.Attrib3f(0) + outside

    @sh.program
    def computed(x: sh.Attrib1f):
        inside = CASES[name](f, c, n)
        return x + inside, sh.Attrib3f(0) + inside

    assert len(used.ir.params) == 1
    seen = set()
    for values in ((0.1, (0.5, 0.25, 2), 5), (1.7, (-3.3, 5, 0.01), 77), (-2.3, (1e-3, 7e5, 3), -8)):
        f.value, c.value, n.value = values
        found = used.compile(**options)(X)
        assert_same(found, computed.compile(**options)(X))
        seen.add(found[1].tobytes())
    assert len(seen) > 1


@pytest.mark.sampled(2)
@pytest.mark.parametrize("math", ["strict", "relaxed", "fast"])
@pytest.mark.parametrize("precision", ["f16", "f32", "f64"])
def test_a_dependent_uniform_is_computed_as_the_kernel_is(precision, math):
    f = sh.Param(sh.Attrib1f, 0.1)
    follows = sh.exp(f) * sh.sin(f * 3) / 7

    @sh.program
    def used(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * follows

    @sh.program
    def computed(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * (sh.exp(f) * sh.sin(f * 3) / 7)

    found = used.compile("numpy", precision=precision, math=math)([1.0])
    assert_same(found, computed.compile("numpy", precision=precision, math=math)([1.0]))


def test_what_was_frozen_follows():
    freq = sh.Param(sh.Attrib1f, 3.0)
    freq2 = freq * 2

    @sh.program
    def wave(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * freq2

    freq.value = 5
    assert wave(1) == 10
    assert np.asarray(freq2) == 10
    assert float(freq2) == freq2.value == 10
    assert repr(freq2) == "Attrib1f(10.0)"
    assert isinstance(freq2, sh.Attrib1f)


def test_dependent_uniforms_show_among_the_params_with_what_they_follow():
    freq = sh.Param(sh.Attrib1f, 3.0)
    shift = freq + 1
    both = shift * freq

    @sh.program
    def wave(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * both + shift

    assert list(wave.params) == ["both", "shift", "freq"]
    assert wave.params["freq"] is freq
    assert wave.params["both"] is both
    assert [p.name for p in wave.ir.params] == ["both", "shift"]
    assert both.name == "both"


def test_two_of_one_name_are_two_uniforms():
    gain = sh.Param(sh.Attrib1f, 3.0)
    pair = [gain * 2, gain * 5]

    @sh.program
    def both(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * pair[0] + pair[1]

    assert list(both.params) == ["pair", "pair_2", "gain"]
    gain.value = 1
    assert both(10) == 25


CHANGES = {
    "set": lambda uniform: setattr(uniform, "value", (1, 1, 1)),
    "stored into": lambda uniform: operator.imul(uniform, 2),
    "stored into, in part": lambda uniform: setattr(uniform, "x", 5),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_dependent_uniform_cannot_be_set(change):
    gain = sh.Param(sh.Color3f, (1, 2, 3))
    twice = gain * 2
    with pytest.raises(sh.RecordError) as caught:
        CHANGES[change](twice)
    what = change.partition(",")[0]
    assert caught.value.message == f"twice cannot be {what}: it is a dependent uniform, which follows gain"
    assert caught.value.cure == "gain.value = … between runs, or an sh.Param of its own"
    assert caught.value.loc.file == __file__


def test_a_row_of_a_matrix_is_set_by_its_matrix():
    turn = sh.Param(sh.Matrix2f, np.eye(2))
    with pytest.raises(sh.RecordError, match=r"write instead: turn\.value = … between runs"):
        turn[0].value = (1, 2)

    def turned(x: sh.Attrib2f) -> sh.Attrib2f:
        turn[0] += x
        return turn[0]

    with pytest.raises(sh.RecordError, match=r"write instead: turn\.value = … between runs"):
        sh.program(turned)
    turn.value = [[1, 2], [3, 4]]
    assert np.asarray(turn[0]).tolist() == [1, 2]


def test_bind_and_specialize_take_dependent_uniforms():
    gain = sh.Param(sh.Attrib1f, 3.0)
    twice = gain * 2

    @sh.program
    def scale(x: sh.Attrib1f, by: sh.Attrib1f) -> sh.Attrib1f:
        return x * by + gain

    bound = scale.bind(by=twice)
    assert bound.params == {"twice": twice, "gain": gain}
    gain.value = 5
    assert bound(1) == 15
    assert bound.specialize(twice=4)(1) == 9
    fixed = bound.specialize(gain=2)
    gain.value = 100
    assert fixed.params == {}
    assert fixed(1) == 6


def test_a_dependent_uniform_as_an_input_or_a_default():
    gain = sh.Param(sh.Attrib1f, 0.1)
    third = gain / 3

    @sh.program
    def scale(x: sh.Attrib1f, by: sh.Attrib1f = third) -> sh.Attrib1f:
        return x * by

    kernel = scale.compile("numpy", precision="f64")
    assert kernel(3) == 3 * (0.1 / 3)
    gain.value = 6
    assert (kernel(3), scale(3), scale(1, third * 5), scale(third)) == (6, 6, 10, 4)


def test_specialize_keeps_what_else_is_followed():
    a, b = sh.Param(sh.Attrib1f, 2.0, name="a"), sh.Param(sh.Attrib1f, 3.0, name="b")
    total = sh.sqrt(a) + b

    @sh.subroutine
    def deep(x: sh.Attrib1f) -> sh.Attrib1f:
        y = x * total
        return y + x * total * 2

    @sh.program
    def f(x: sh.Attrib1f) -> sh.Attrib1f:
        return deep(x) + total

    fixed = f.specialize(a=4.0)
    assert list(fixed.params) == ["b"]
    b.value = 5
    assert fixed(1) == 28


def test_a_text_has_a_plain_uniform():
    gain = sh.Param(sh.Attrib1f, 3.0)
    twice = gain * 2

    @sh.program
    def scale(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * twice

    again = sh.Program.from_ir(sh.parse(str(scale.ir)))
    gain.value = 7
    assert (scale(1), again(1)) == (14, 6)
    again.params["twice"].value = 1
    assert again(1) == 1
    assert [s.value for s in scale.trace(x=1)][-1] == 14


def test_a_table_can_be_read_at_a_param():
    where = sh.Param(sh.Attrib1i, 1)
    data = sh.Table([1.0, 10.0, 100.0], sh.Attrib1f)
    found = data[where] + 1

    @sh.program
    def f(x: sh.Attrib1f) -> sh.Attrib1f:
        return x + found

    assert f(0) == 11
    where.value = 7
    assert f(0) == 101
    data.update([1, 2, 3])
    assert f(0) == 4


def test_a_long_chain_is_no_recursion():
    gain = sh.Param(sh.Attrib1f, 1.0)
    total = gain
    for _ in range(3000):
        total = total + gain
    gain.value = 2
    assert np.asarray(total) == 6002


def test_computed_once_as_long_as_nothing_changes(monkeypatch):
    gain = sh.Param(sh.Attrib1f, 1.0)
    twice = gain * 2

    @sh.program
    def f(x: sh.Attrib1f) -> sh.Attrib1f:
        return x + twice

    runs = []
    run = sh.Kernel.__call__
    monkeypatch.setattr(sh.Kernel, "__call__", lambda self, *a, **k: runs.append(str(self)) or run(self, *a, **k))
    for value in (1.0, 1.0, 4.0):
        gain.value = value
        f(1)
        f(1)
    assert len([r for r in runs if "twice" in r]) == 1  # the first was computed when f was recorded
    assert f(1) == 9


def test_threads_see_one_value():
    gain = sh.Param(sh.Attrib1f, 1.0)
    twice = gain * 2

    @sh.program
    def f(x: sh.Attrib1f) -> sh.Attrib1f:
        return x + twice

    kernel = f.compile("numpy")
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: float(kernel(1)), range(40)))
        gain.value = 3
        found += pool.map(lambda _: float(kernel(1)), range(40))
    assert found == [3] * 40 + [7] * 40


# Matrices and structs


def lens_value(k):
    return {"at": (k, 2, 3), "turn": np.eye(3) * k, "wide": k / 3, "count": k}


@pytest.mark.sampled(4)
@everywhere
def test_params_of_structs_and_matrices(options):
    lens = sh.Param(Lens, lens_value(1))
    world = sh.Param(sh.Matrix4f, np.arange(16.0).reshape(4, 4))
    moved = world @ world

    @sh.program
    def seen(p: sh.Point3f):
        q = moved @ (lens.turn @ (p - lens.at))
        return q * lens.wide, lens.count, lens.at

    @sh.program
    def told(p: sh.Point3f, lens: Lens, world: sh.Matrix4f):
        q = (world @ world) @ (lens.turn @ (p - lens.at))
        return q * lens.wide, lens.count, lens.at

    p = np.stack([X, X + 1, X * 2], -1)
    for k in (1, 5):
        lens.value = lens_value(k)
        world.value = np.arange(16).reshape(4, 4) / k
        expected = told.compile(**options)(p, lens_value(k), np.arange(16).reshape(4, 4) / k)
        assert_same(seen.compile(**options)(p), expected)


def test_a_param_of_a_struct_is_one_param():
    lens = sh.Param(Lens, Lens((1, 2, 3), sh.Matrix3f(), 0.5, 7), title="Lens")
    assert isinstance(lens, Lens)
    assert isinstance(lens, sh.Param)
    assert lens.value.at.tolist() == [1, 2, 3]
    assert lens.value.turn.tolist() == np.eye(3).tolist()
    lens.wide.value = 2
    assert lens.value.wide == 2

    @sh.program
    def seen(x: sh.Attrib1f) -> Lens:
        mine = lens.copy()
        mine.at = mine.at * x
        mine.wide += lens.turn[0, 0]
        return mine

    assert seen.params == {"lens": lens}
    assert [p.name for p in seen.ir.params] == ["lens.at", "lens.turn[0]", "lens.turn[1]", "lens.turn[2]",
                                               "lens.wide", "lens.count"]  # fmt: skip
    found = seen(2)
    assert (found.at.tolist(), found.wide, found.count) == ([2, 4, 6], 3, 7)
    fixed = seen.specialize(lens=lens_value(3))
    assert fixed.params == {}
    assert fixed(2).count == 3
    assert "lens_at" in seen.compile("glsl").source

    with pytest.raises(sh.ShpyTypeError, match="the Param lens has the parts at, turn, wide, count"):
        lens.value = {"at": (1, 2, 3)}
    with pytest.raises(sh.ShpyTypeError, match=r"the Param lens.turn is a Matrix3f and takes an array \(3, 3\)"):
        lens.value = lens_value(1) | {"turn": np.eye(2)}
    with pytest.raises(sh.ShpyTypeError, match=r"the Param lens.count: it takes ints, not 1.5"):
        lens.value = lens_value(9) | {"count": 1.5}
    assert lens.value.at.tolist() == [1, 2, 3]


def test_bind_makes_one_param_of_a_struct():
    @sh.program
    def wide(lens: Lens, x: sh.Attrib1f) -> sh.Attrib1f:
        return lens.wide * x

    bound = wide.bind(lens=lens_value(3))
    bound.params["lens"].value = lens_value(6)
    assert bound(10) == 20
    mine = sh.Param(Lens, lens_value(9))
    assert wide.bind(lens=mine).params == {"mine": mine}


def test_a_field_named_like_something_that_a_param_has():
    @sh.struct
    class Lamp:
        range: sh.Attrib1f
        name: sh.Attrib1i

    lamp = sh.Param(Lamp, (3.0, 4))

    @sh.program
    def f(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * lamp.range + lamp.name

    assert f(2) == 10
    assert f.params == {"lamp": lamp}

    @sh.struct
    class Bad:
        value: sh.Attrib1f

    with pytest.raises(sh.ShpyTypeError, match="Bad has a field named value"):
        sh.Param(Bad, (1,))


# What pages and viewers show


def test_metadata():
    gain = sh.Param(sh.Attrib1f, 0.5, range=(0, 1), step=0.1, title="Gain", description="How loud it is.")
    assert (gain.name, gain.range, gain.step) == ("gain", (0, 1), 0.1)
    assert (gain.title, gain.description) == ("Gain", "How loud it is.")
    plain = sh.Param(sh.Attrib1f, 0.5)
    assert (plain.range, plain.step, plain.title, plain.description) == (None, None, None, None)


def test_a_value_out_of_range_is_an_error_that_names_the_param():
    color = sh.Param(sh.Color3f, (0, 0.5, 1), range=(0, 1))
    for bad in ((0, 0, 1.5), (0, -1e-9, 0), float("nan")):
        with pytest.raises(sh.ShpyTypeError) as caught:
            color.value = bad
        assert "the Param color: " in caught.value.message
        assert "is outside of its range, 0 to 1" in caught.value.message
    assert color.value.tolist() == [0, 0.5, 1]
    with pytest.raises(sh.ShpyTypeError, match="the Param late: 7 is outside of its range, 0 to 5"):
        sh.Param(sh.Attrib1i, 7, range=(0, 5), name="late")

    @sh.program
    def f(x: sh.Attrib1f) -> sh.Color3f:
        return x * color

    with pytest.raises(sh.ShpyTypeError, match=r"the Param color: 2.0 is outside"):
        f.specialize(color=2.0)


def test_metadata_stands_in_the_text_of_a_program_and_compiles_nothing_anew():
    gain = sh.Param(sh.Attrib1f, 0.5, range=(0, 0.75), step=np.float32(0.25), title="Gain", description='"How"\nloud.')

    @sh.program
    def louder(x: sh.Attrib1f) -> sh.Attrib1f:
        return gain * x

    assert 'f = 0x1p-1 range (0, 0x1.8p-1) step 0x1p-2 title "Gain" description "' in str(louder.ir)
    again = sh.Program.from_ir(sh.parse(str(louder.ir))).params["gain"]
    assert (again.range, again.step, again.title, again.description) == ((0, 0.75), 0.25, "Gain", '"How"\nloud.')
    with pytest.raises(sh.ShpyTypeError, match=r"the Param gain: 1.0 is outside of its range, 0 to 0.75"):
        again.value = 1
    plain = sh.parse(str(louder.ir).replace('title "Gain"', 'title "Loudness"'))
    assert plain == louder.ir
    assert forget_data(plain).params[0].about == forget_data(louder.ir).params[0].about


@pytest.mark.parametrize("wrong", [{"range": (1, 0)}, {"range": 1}, {"range": (0, "a")}, {"step": 0}, {"step": "x"},
                                   {"range": (0, float("nan"))}, {"range": (True, False)}, {"range": (0, 10**400)},
                                   {"title": 5}, {"description": b"x"}])  # fmt: skip
def test_metadata_that_is_none(wrong):
    with pytest.raises(sh.ShpyTypeError, match=f"the Param gain: {next(iter(wrong))}="):
        sh.Param(sh.Attrib1f, 0.5, name="gain", **wrong)


@pytest.mark.parametrize("type_", [sh.Matrix2f, Lens, sh.Attrib1b])
def test_a_range_is_for_numbers(type_):
    value = {sh.Matrix2f: np.eye(2), Lens: lens_value(1), sh.Attrib1b: True}[type_]
    with pytest.raises(sh.ShpyTypeError, match="a range or step is for numbers"):
        sh.Param(type_, value, range=(0, 1))
