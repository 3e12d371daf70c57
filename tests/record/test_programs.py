"""Programs as values, and what a run does with arrays: on numpy, which is always there."""

from typing import NamedTuple

import numpy as np
import pytest

import shpy as sh
from shpy import SH_BREAK, SH_CONTINUE, SH_DISCARD, SH_DO, SH_ELSE, SH_FOR, SH_IF, SH_RETURN, SH_UNTIL, SH_WHILE


class Polar(NamedTuple):
    radius: sh.Attrib1f
    angle: sh.Attrib1f


@sh.struct
class Ray:
    o: sh.Point3f
    d: sh.Vector3f


@sh.program
def scale(x: sh.Attrib1f, by: sh.Attrib1f) -> sh.Attrib1f:
    return x * by


@sh.program
def shift(x: sh.Attrib1f) -> sh.Attrib1f:
    return x + 1


def test_a_program_describes_itself():
    sky = sh.Param(sh.Color3f, (1, 2, 3))
    data = sh.Table(np.arange(4.0), sh.Attrib1f)

    @sh.program
    def shade(i: sh.Attrib1i) -> sh.Color3f:
        return sky * data[i]

    assert shade.inputs == {"i": sh.Attrib1i}
    assert shade.outputs == {"0": sh.Color3f}
    assert list(shade.params) == ["sky"]
    assert shade.params["sky"] is sky
    assert shade.tables["data"] is data
    assert repr(shade) == "<Program shade(i: Attrib1i) -> Color3f>"
    assert shade(2).tolist() == [2, 4, 6]
    sky.value = (0, 0, 1)
    assert shade(2).tolist() == [0, 0, 2]
    data.update(np.arange(4.0) * 10)
    assert shade(2).tolist() == [0, 0, 20]


def test_text_and_back():
    again = sh.Program.from_ir(sh.parse(str(scale.ir)))
    assert again.ir == scale.ir
    assert again([1, 2], 3).tolist() == [3, 6]


def test_composition_by_position_and_by_name():
    @sh.program
    def polar(p: sh.Point2f) -> Polar:
        return Polar(sh.length(p), sh.atan2(p.y, p.x))

    @sh.program
    def wave(angle: sh.Attrib1f, radius: sh.Attrib1f, k: sh.Attrib1f) -> sh.Attrib1f:
        return radius * 10 + angle * 0 + k

    joined = wave << polar
    assert list(joined.inputs) == ["p", "k"]
    assert joined((3, 4), 7) == 57
    assert (shift << scale)(2, 5) == 11
    both = scale & shift
    assert list(both.inputs) == ["x", "by", "x_2"]
    assert [float(v) for v in both(2, 5, 1)] == [10, 2]
    merged = scale.merge(shift)
    assert list(merged.inputs) == ["x", "by"]
    assert [float(v) for v in merged(2, 5)] == [10, 3]


def test_extra_outputs_follow():
    @sh.program
    def pair(x: sh.Attrib1f):
        return x, x + 10

    joined = shift << pair
    assert [float(v) for v in joined(1)] == [2, 11]


def test_rename_bind_specialize():
    renamed = scale.rename(x="a")
    assert list(renamed.inputs) == ["a", "by"]
    bound = scale.bind(by=3)
    assert list(bound.inputs) == ["x"]
    assert bound(2) == 6
    bound.params["by"].value = 4
    assert bound(2) == 8
    fixed = scale.specialize(by=3)
    assert fixed.inputs == {"x": sh.Attrib1f}
    assert fixed.params == {}
    assert fixed(2) == 6
    with pytest.raises(sh.ShpyTypeError, match="z is no input of scale"):
        scale.bind(z=1)


@pytest.mark.parametrize("precision", ["f32", "f16", "f64"])
def test_specialize_folds_functions_of_doubles_and_halves_to_the_bits_of_a_run(precision):
    @sh.program
    def each(x: sh.Attrib4d, y: sh.Attrib4h) -> tuple[sh.Attrib4d, sh.Attrib4d, sh.Attrib4h]:
        return sh.tanh(x), sh.cosh(x), sh.pow(y, 2.3)

    for x in np.linspace(0.1, 2, 16).reshape(-1, 4):
        run = each.compile("numpy", precision=precision)(x, x.astype(np.float16))
        fixed = each.specialize(x=x, y=x.astype(np.float16)).compile("numpy", precision=precision)(shape=())
        assert [a.tolist() for a in fixed] == [a.tolist() for a in run]


def test_specialising_folds():
    @sh.program
    def choose(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
        y = sh.Attrib1f(x)
        with SH_IF(n > 3):
            y *= 2
        return y

    assert "if" in str(choose.ir)
    assert "if" not in str(choose.specialize(n=8).ir)
    assert choose.specialize(n=8)(5) == 10


def test_a_program_inside_a_program_gets_values():
    @sh.program
    def twice(x: sh.Attrib1f) -> sh.Attrib1f:
        y = sh.Attrib1f(x)
        with SH_FOR(2):
            y[:] = shift(y)
        return y + x * 0

    assert twice([1, 2]).tolist() == [3, 4]


def test_subroutines_take_references():
    @sh.subroutine
    def advance(p: sh.Point3f, v: sh.Vector3f):
        p += v
        with SH_IF(p.x > 2):
            SH_RETURN(sh.Attrib1f(1))
        return 0.0

    @sh.program
    def move(p: sh.Point3f, v: sh.Vector3f):
        far = advance(p, v)
        far += advance(p, v)
        return p, far

    p, far = move((0, 0, 0), [(1, 0, 0), (2, 0, 0)])
    assert p.tolist() == [[2, 0, 0], [4, 0, 0]]
    assert far.tolist() == [0, 1]
    text = str(move.ir)
    assert text.count("function advance(") == 1


def test_structs_and_named_tuples_on_the_host():
    @sh.program
    def turn(ray: Ray) -> Ray:
        ray.d = -ray.d
        ray.o += ray.d
        return ray

    back = turn({"o": [(1, 1, 1)], "d": (1, 0, 0)})
    assert back.o.tolist() == [[0, 1, 1]]
    assert back.d.tolist() == [[-1, 0, 0]]


def test_in_place_stores_reach_every_name():
    @sh.program
    def stores(x: sh.Attrib3f):
        y = sh.Attrib3f(x)
        y.xy += 1
        y[2] = 7
        y[0, 1] = y.yx
        return y

    assert stores((1, 2, 3)).tolist() == [3, 2, 7]


def test_symbolic_component_store():
    @sh.program
    def put(v: sh.Attrib3f, i: sh.Attrib1i):
        v[i] = 9
        return v

    assert put((1, 2, 3), [0, 2, 5]).tolist() == [[9, 2, 3], [1, 2, 9], [1, 2, 3]]


def test_shapes_broadcast():
    assert scale(np.ones((3, 1)) * 2, np.ones((3, 4))).shape == (3, 4)
    assert scale(2, 3) == np.float32(6)
    assert isinstance(scale(2, 3), np.float32)
    assert scale([], []).shape == (0,)
    assert scale(by=2, x=[1, 2]).tolist() == [2, 4]


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ((np.zeros(3, complex), 1), "x takes floats, not complex128"),
        ((["a"], 1), "x takes floats, not <U1"),
        ((True, 1), "x takes floats, not bool"),
        ((np.zeros(3), np.zeros(4)), r"do not broadcast: x \(3,\), by \(4,\)"),
        ((1,), "scale lacks its input by"),
        ((1, 2, 3), "scale takes 2 inputs, not 3"),
        (([[1], [2, 3]], 1), "x is not an array"),
    ],
)
def test_wrong_arrays_are_named(args, message):
    with pytest.raises(sh.ShpyTypeError, match=message) as caught:
        scale(*args)
    assert isinstance(caught.value, TypeError)


def test_integers_in_range_only():
    @sh.program
    def same(i: sh.Attrib1i):
        return i

    assert same(np.array([2**31 - 1], np.int64)).dtype == np.int32
    with pytest.raises(sh.ShpyTypeError, match="i holds 2147483648, out of the range"):
        same(np.array([2**31]))
    with pytest.raises(sh.ShpyTypeError, match="i takes ints, not float64"):
        same(1.5)


def test_run_writes_where_it_is_told():
    @sh.program
    def keep(x: sh.Attrib1f):
        SH_DISCARD(x < 0)
        return x * 2

    x = np.array([-1, 2, -3, 4], np.float32)
    out = np.full(4, 7, np.float32)
    result = keep.compile().run(x, out=out)
    assert result.outputs is out
    assert out.tolist() == [7, 4, 7, 8]
    assert result.written.tolist() == [False, True, False, True]
    assert result.count == 2
    assert keep(x).tolist() == [0, 4, 0, 8]
    shift.compile().run(x, out=x)
    assert x.tolist() == [0, 3, -2, 5]
    with pytest.raises(sh.ShpyTypeError, match="out is float64"):
        keep.compile().run(x, out=np.zeros(4))


def test_loop_limit_names_the_loop_and_keeps_the_rest():
    @sh.program
    def spin(x: sh.Attrib1f):
        with SH_WHILE(lambda: x > 0):
            x += 1
        return x

    with pytest.raises(sh.LoopLimitExceeded, match="more than 100 iterations in 2 elements") as caught:
        spin.compile(loop_limit=100)([-1, 1, 2])
    assert caught.value.count == 2
    assert caught.value.loc.file == __file__
    assert caught.value.result.written.tolist() == [True, False, False]
    assert caught.value.result.outputs[0] == -1


def test_grid():
    @sh.program
    def place():
        i = sh.grid_index(2)
        return i[0] * 10 + i[1], sh.grid_shape(2)

    index, shape = place.compile()(shape=(2, 3))
    assert index.tolist() == [[0, 1, 2], [10, 11, 12]]
    assert shape[0, 0].tolist() == [2, 3]
    with pytest.raises(sh.ShpyTypeError, match="uses grid_index"):
        place.compile()(shape=(2,))


def test_table_arguments_and_texture_arguments():
    @sh.program
    def read(i: sh.Attrib1i, t: sh.Table[sh.Attrib2f], uv: sh.TexCoord2f, image: sh.Texture2D[sh.Color1f]):
        return t[i], t.shape[0], image(uv)

    pixels = np.arange(6, dtype=np.float32).reshape(2, 3)
    t = sh.Table(np.arange(8.0).reshape(4, 2), sh.Attrib2f)
    for texture, expected in (
        (sh.Texture2D(pixels), 0.5),
        (sh.Texture2D(pixels, filter="nearest"), 1),
        (sh.Texture2D(pixels, wrap="repeat"), 0.5),
    ):
        entry, count, colour = read(9, t, (1 / 3, 0.25), texture)
        assert entry.tolist() == [6, 7]
        assert count == 4
        assert colour == pytest.approx(expected)


def test_texture_wraps():
    pixels = np.arange(6, dtype=np.float32).reshape(2, 3)
    clamped, repeated = sh.Texture2D(pixels), sh.Texture2D(pixels, wrap="repeat")

    @sh.program
    def sample(uv: sh.TexCoord2f):
        return clamped(uv), repeated(uv)

    rows, columns = np.mgrid[0:2, 0:3]
    uv = np.stack([(columns + 0.5) / 3, (rows + 0.5) / 2], axis=-1)
    a, b = sample(uv)
    assert np.allclose(a, pixels, atol=1e-5)
    assert np.allclose(b, pixels, atol=1e-5)
    a, b = sample(uv + (1, -2))
    assert np.allclose(a, np.broadcast_to(pixels[0, 2], (2, 3)), atol=1e-5)
    assert np.allclose(b, pixels, atol=1e-5)
    assert np.isfinite(sample((1e30, float("nan")))[0])


def test_noise_is_zero_on_the_lattice_and_signed():
    @sh.program
    def field(p: sh.Point3f):
        return sh.noise(p.x), sh.noise(p.xy), sh.noise(p)

    whole = np.stack(np.meshgrid(*[np.arange(-2.0, 3)] * 3), axis=-1)
    for values in field(whole):
        assert np.all(values == 0)
    points = np.random.default_rng(0).uniform(-50, 50, (20_000, 3))
    for values in field(points):
        assert -1.05 < values.min() < -0.4
        assert 0.4 < values.max() < 1.05
        assert abs(values.mean()) < 0.02


def test_trace_tells_every_step():
    @sh.program
    def grow(x: sh.Attrib1f):
        y = x * 2
        with SH_FOR(2):
            y += 1
        return y

    steps = [(s.name, float(s.value)) for s in grow.trace(x=3) if s.name == "y"]
    assert steps == [("y", 6), ("y", 7), ("y", 8)]
    assert all(s.loc.file == __file__ for s in grow.trace(x=3))


def test_control_flow_reads_like_python():
    @sh.program
    def count(x: sh.Attrib1i):
        n = sh.Attrib1i(0)
        with SH_DO():
            with SH_IF(x % 2 == 0):
                x[:] = x // 2
            with SH_ELSE():
                x[:] = 3 * x + 1
            n += 1
            SH_CONTINUE(x > 1000)
            SH_BREAK(n > 200)
            SH_UNTIL(lambda: x == 1)
        return n

    def collatz(x):
        n = 0
        while True:
            x = x // 2 if x % 2 == 0 else 3 * x + 1
            n += 1
            if x <= 1000 and n > 200:
                return n
            if x == 1:
                return n

    assert count(np.arange(1, 60)).tolist() == [collatz(x) for x in range(1, 60)]


@pytest.mark.parametrize("bounds", [(5,), (2, 9), (9, 2), (0, 10, 3), (10, 0, -3), (2147483640, 2147483647, 5)])
def test_for_counts_like_range(bounds):
    @sh.program
    def constant():
        n = sh.Attrib1i(0)
        last = sh.Attrib1i(-1)
        with SH_FOR(*bounds) as i:
            n += 1
            last[:] = i
        return n, last

    @sh.program
    def symbolic(a: sh.Attrib1i, b: sh.Attrib1i, c: sh.Attrib1i):
        n = sh.Attrib1i(0)
        last = sh.Attrib1i(-1)
        with SH_FOR(a, b, c) as i:
            n += 1
            last[:] = i
        return n, last

    indices = list(range(*bounds))
    expected = [len(indices), indices[-1] if indices else -1]
    assert [int(v) for v in constant()] == expected
    start, stop, step = (0, *bounds, 1) if len(bounds) == 1 else (*bounds, 1)[:3]
    assert [int(v) for v in symbolic(start, stop, step)] == expected


def test_choosing_a_backend(monkeypatch):
    assert sh.default_backend() in ("numpy", "opencl", "glsl")
    monkeypatch.setenv("SHPY_BACKEND", "numpy")
    assert shift.compile().backend == "numpy"
    with pytest.raises(sh.BackendUnavailable, match="no backend 'cuda'") as caught:
        shift.compile("cuda")
    assert (caught.value.loc.file, caught.value.loc.line) == (__file__, caught.tb.tb_lineno)
    assert [b.name for b in sh.backends()] == ["numpy", "opencl", "glsl"]
    with pytest.raises(TypeError):
        shift.compile(mode="fast")


def test_kernels_are_kept():
    assert shift.compile("numpy") is shift.compile("numpy")
    assert shift.compile("numpy", loop_limit=5) is not shift.compile("numpy")


def test_params_have_the_working_precision():
    gain = sh.Param(sh.Attrib1f, 0.1)

    @sh.program
    def scaled(x: sh.Attrib1f):
        return x * gain

    assert scaled.compile("numpy", precision="f64")(3.0) == 3.0 * 0.1
    assert scaled.compile("numpy")(3.0) == np.float32(3) * np.float32(0.1)


def test_precision():

    @sh.program
    def divide(x: sh.Attrib1f):
        return x / 3 + 0.1

    assert divide.compile("numpy", precision="f64")(1.0) == 1 / 3 + 0.1
    assert divide.compile("numpy", precision="f64")(1.0).dtype == np.float64
    half = divide.compile("numpy", precision="f16")([1.0])
    assert half.dtype == np.float16
    assert half[0] == np.float16(np.float16(1) / np.float16(3)) + np.float16(0.1)


def test_given_names_are_those_of_params_and_tables_whatever_is_read_first():
    gain = sh.Param(sh.Attrib1f, 2)
    given = sh.Param(sh.Attrib1f, 3, name="gain")
    steps = sh.Table([1, 2], sh.Attrib1f)
    named = sh.Table([5, 6], sh.Attrib1f, name="steps")

    @sh.subroutine
    def both(x):
        return x * gain + given

    @sh.program
    def f(x: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f, sh.Attrib1f]:
        return both(x), steps[0] * 10 + named[1], gain * 10 + given

    assert f.params == {"gain_2": gain, "gain": given}
    assert f.recorded.tables == {"steps_2": steps, "steps": named}
    assert [float(found) for found in f(1)] == [5, 16, 23]
    given.value, gain.value = 7, 4
    assert [float(found) for found in f(1)] == [11, 16, 47]
    assert sh.parse(str(f.ir)) == f.ir


def test_two_given_names_are_an_error():
    gain, first, second = sh.Param(sh.Attrib1f, 1), *(sh.Param(sh.Attrib1f, 1, name="gain") for _ in range(2))
    with pytest.raises(sh.RecordError, match="two params are named 'gain'\n  write instead: give one another name"):

        @sh.program
        def f(x: sh.Attrib1f) -> sh.Attrib1f:
            return x * gain + first + second


def test_a_program_that_returns_a_matrix_becomes_text_and_back():
    @sh.program
    def squared(m: sh.Matrix2f) -> sh.Matrix2f:
        return m @ m

    assert list(squared.outputs) == ["[0]", "[1]"]
    again = sh.Program.from_ir(sh.parse(str(squared.ir)))
    assert again.ir == squared.ir
    assert again([[1, 2], [3, 4]]).tolist() == squared([[1, 2], [3, 4]]).tolist() == [[7, 10], [15, 22]]


def test_a_recording_can_be_told_from_a_plain_call():
    recording = []

    def doubled(x):
        recording.append(sh.is_recording())
        return 2 * x

    @sh.program
    def twice(x: sh.Attrib1f) -> sh.Attrib1f:
        return doubled(x)

    assert twice.ir.entry.name == "twice"
    doubled(sh.Attrib1f(3))
    assert recording == [True, False]
