"""Types, literals, mixing and kinds, on constants: outside a program everything evaluates at once."""

import numpy as np
import pytest

import shpy as sh


def value(x):
    return np.asarray(x).tolist()


def test_aliases_are_the_same_types():
    assert sh.vec3 is sh.Attrib3f
    assert sh.ivec2 is sh.Attrib2i
    assert sh.uvec4 is sh.Attrib4u
    assert sh.bvec2 is sh.Attrib2b
    assert not hasattr(sh, "mat3")


@pytest.mark.parametrize("kind", ["Attrib", "Point", "Vector", "Normal", "Color", "TexCoord"])
@pytest.mark.parametrize("base", ["f", "d", "h"])
@pytest.mark.parametrize("size", [1, 2, 3, 4])
def test_every_float_type_exists(kind, base, size):
    cls = getattr(sh, f"{kind}{size}{base}")
    made = cls(0.5)
    assert np.asarray(made).shape == (() if size == 1 else (size,))
    assert np.asarray(made).dtype == {"f": np.float32, "d": np.float64, "h": np.float16}[base]
    assert type(made) is cls


def test_star_import_shadows_no_builtin():
    import builtins

    assert not set(sh.__all__) & set(dir(builtins))
    for name in ("abs", "min", "max", "round", "pow", "any", "all", "hash"):
        assert name not in sh.__all__
        assert hasattr(sh, name)


@pytest.mark.parametrize(
    ("result", "expected", "type_"),
    [
        (lambda: sh.Attrib1i(7) + 1, 8, sh.Attrib1i),
        (lambda: sh.Attrib1i(7) + 1.5, 8.5, sh.Attrib1f),
        (lambda: 2 * sh.Attrib1u(3), 6, sh.Attrib1u),
        (lambda: sh.Attrib1h(1) + sh.Attrib1f(2), 3.0, sh.Attrib1f),
        (lambda: sh.Attrib1f(1) + sh.Attrib1d(2), 3.0, sh.Attrib1d),
        (lambda: sh.Attrib1h(1) + sh.Attrib1i(2), 3.0, sh.Attrib1f),
        (lambda: sh.Attrib1i(7) / 2, 3.5, sh.Attrib1f),
        (lambda: sh.Attrib1i(-7) // 2, -4, sh.Attrib1i),
        (lambda: sh.Attrib1i(-7) % 3, 2, sh.Attrib1i),
        (lambda: sh.Attrib1f(-7) % 3, 2.0, sh.Attrib1f),
        (lambda: sh.Attrib1f(-7) // 2, -4.0, sh.Attrib1f),
        (lambda: sh.Attrib1f(3) ** 2, 9.0, sh.Attrib1f),
        (lambda: sh.Attrib1i(2) ** 0.5, pytest.approx(2**0.5), sh.Attrib1f),
        (lambda: sh.Attrib1i(5) & 3, 1, sh.Attrib1i),
        (lambda: ~sh.Attrib1i(5), -6, sh.Attrib1i),
        (lambda: sh.Attrib1i(1) << 33, 2, sh.Attrib1i),
        (lambda: sh.Attrib1i(-8) >> 1, -4, sh.Attrib1i),
        (lambda: 1 << sh.Attrib1u(31), 2**31, sh.Attrib1u),
        (lambda: (2**32 - 1) >> sh.Attrib1u(4), 2**28 - 1, sh.Attrib1u),
        (lambda: 1 << sh.Attrib1i(31), -(2**31), sh.Attrib1i),
        (lambda: sh.Attrib1b(True) & False, False, sh.Attrib1b),
        (lambda: ~sh.Attrib1b(True), False, sh.Attrib1b),
        (lambda: sh.Attrib1f(1) < 2, True, sh.Attrib1b),
        (lambda: sh.Attrib1i(2.9), 2, sh.Attrib1i),
        (lambda: sh.Attrib1i(sh.Attrib1f(float("nan"))), 0, sh.Attrib1i),
        (lambda: sh.Attrib1i(sh.Attrib1f(1e20)), 2**31 - 1, sh.Attrib1i),
        (lambda: sh.Attrib1u(sh.Attrib1f(-5)), 0, sh.Attrib1u),
        (lambda: sh.Attrib1u(sh.Attrib1i(-1)), 2**32 - 1, sh.Attrib1u),
        (lambda: sh.sin(sh.Attrib1i(0)), 0.0, sh.Attrib1f),
        (lambda: sh.min(3, sh.Attrib1i(2), 5), 2, sh.Attrib1i),
        (lambda: sh.Attrib1f(np.float32(0.1)), pytest.approx(0.1), sh.Attrib1f),
        (lambda: sh.Attrib1i(np.int64(4)), 4, sh.Attrib1i),
    ],
)
def test_literals_and_mixing(result, expected, type_):
    made = result()
    assert type(made) is type_
    assert value(made) == expected


@pytest.mark.parametrize("name", ["length", "normalize", "popcount", "float_from_bits", "bits_from_float", "isnan"])
@pytest.mark.parametrize("wrong", [sh.Attrib1b(True), sh.Attrib3b(True), True])
def test_functions_of_constants_refuse_types_that_they_do_not_take(name, wrong):
    with pytest.raises(sh.ShpyTypeError, match=f"sh.{name} does not take b"):
        getattr(sh, name)(wrong)


def test_bits_of_another_width_are_refused():
    for wrong in (sh.Attrib1d(1), sh.Attrib3h(1)):
        for function in (sh.popcount, sh.float_from_bits, sh.count_leading_zeros):
            with pytest.raises(sh.ShpyTypeError, match=r"does not take [dh]"):
                function(wrong)


def test_sequences_stand_for_vectors():
    v = sh.Attrib3f(1, 2, 3)
    assert value(v + (1, 1, 1)) == [2, 3, 4]
    assert value([1, 1, 1] + v) == [2, 3, 4]
    assert value(np.ones(3) + v) == [2, 3, 4]
    assert value(v * sh.Attrib1f(2)) == [2, 4, 6]
    assert value(sh.Attrib4f(sh.Attrib2f(1, 2), 3, 4)) == [1, 2, 3, 4]
    assert value(sh.Point3f(sh.Attrib2f(1, 2), 0)) == [1, 2, 0]
    assert value(sh.Color3f(0.5)) == [0.5, 0.5, 0.5]


def test_kinds():
    p, q, v, a = sh.Point3f(1, 2, 3), sh.Point3f(0, 1, 1), sh.Vector3f(1, 0, 0), sh.Attrib3f(2)
    assert type(p - q) is sh.Vector3f
    assert type(p + v) is sh.Point3f
    assert type(v + p) is sh.Point3f
    assert type(p - v) is sh.Point3f
    assert type(v * a) is sh.Vector3f
    assert type(a * v) is sh.Vector3f
    assert type(2 * v) is sh.Vector3f
    assert type(sh.Normal3f(v) * v) is sh.Normal3f
    assert type(v.xy) is sh.Attrib2f
    assert type(sh.normalize(v)) is sh.Vector3f
    assert type(-sh.Color3f(1)) is sh.Color3f
    assert type(sh.cond(True, v, v)) is sh.Vector3f
    assert type(sh.dot(v, v)) is sh.Attrib1f
    assert type(v > 0) is sh.Attrib3b


def test_components():
    v = sh.Attrib4f(1, 2, 3, 4)
    assert value(v.x) == 1
    assert value(v.bgr) == [3, 2, 1]
    assert value(v.stpq) == [1, 2, 3, 4]
    assert value(v[-1]) == 4
    assert value(v[1:3]) == [2, 3]
    assert value(v[0, 2]) == [1, 3]
    assert value(v[sh.Attrib1i(9)]) == 4
    assert value(sh.Attrib1f(5).xxx) == [5, 5, 5]
    assert value(sh.Attrib1f(5)[0]) == 5
    assert len(v) == 4
    assert [value(c) for c in v] == [1, 2, 3, 4]
    x, y, _, _ = v
    assert value(x + y) == 3
    for wrong in ("xg", "xyzwx", "z", "foo"):
        with pytest.raises(AttributeError):
            getattr(v.xy, wrong)
    with pytest.raises(IndexError):
        v[4]
    with pytest.raises(TypeError):
        len(v.x)


def test_constants_are_numbers_to_python():
    c = sh.Attrib1f(0.5)
    assert float(c) == 0.5
    assert int(sh.Attrib1i(3)) == 3
    assert [10, 11][sh.Attrib1i(1)] == 11
    assert bool(sh.Attrib1b(True))
    with pytest.raises(TypeError, match="unhashable"):
        hash(c)
    assert sh.Attrib1f.__array_ufunc__ is None
    assert repr(sh.Attrib2f(1, 2)) == "Attrib2f(1.0, 2.0)"


def test_matrices():
    m = sh.Matrix3f((1, 2, 3), (0, 1, 4), (5, 6, 0))
    host = np.array([[1, 2, 3], [0, 1, 4], [5, 6, 0]], float)
    assert value(m) == host.tolist()
    assert value(sh.Matrix3f()) == np.eye(3).tolist()
    assert value(m @ sh.Attrib3f(1, 2, 3)) == (host @ [1, 2, 3]).tolist()
    assert value(sh.Attrib3f(1, 2, 3) @ m) == ([1, 2, 3] @ host).tolist()
    assert value(m @ m) == (host @ host).tolist()
    assert value(sh.transpose(m)) == host.T.tolist()
    assert value(sh.determinant(m)) == pytest.approx(np.linalg.det(host))
    assert np.allclose(sh.inverse(m), np.linalg.inv(host))
    assert value(m[1]) == [0, 1, 4]
    assert value(m[1, 2]) == 4
    assert value(sh.Matrix2f.from_columns((1, 2), (3, 4))) == [[1, 3], [2, 4]]
    assert value(m * 2) == (host * 2).tolist()
    four = np.random.default_rng(1).normal(size=(4, 4))
    assert np.allclose(sh.inverse(sh.Matrix4f(*four)), np.linalg.inv(four), rtol=1e-4, atol=1e-5)
    assert np.allclose(sh.determinant(sh.Matrix4f(*four)), np.linalg.det(four), rtol=1e-4)


@pytest.mark.parametrize("base", "hfdiu")
def test_the_product_of_a_matrix_and_a_vector_narrows_neither(base):
    """The entries are binary32: ints and halves widen, and a product with binary64 is of binary64."""
    wide = "d" if base == "d" else "f"
    half = sh.Matrix3f() * 0.5
    vectors = [getattr(sh, f"Attrib3{base}")(3)]
    vectors += [getattr(sh, f"{kind}3{base}")(3) for kind in ("Point", "Vector", "Normal") if base in "hfd"]
    for v in vectors:
        product = half @ v
        assert type(product) is getattr(sh, f"{type(v).kind}3{wide}")
        assert value(product) == ([6.0] * 3 if type(v).kind == "Normal" else [1.5] * 3)
    if base in "hfd":
        assert type(sh.Matrix4f() @ getattr(sh, f"Point3{base}")(1)) is getattr(sh, f"Point3{wide}")


@pytest.mark.parametrize("operate", [lambda m, d: m * d, lambda m, d: d * m, lambda m, d: m - d, lambda m, d: m / d])
def test_a_matrix_of_binary32_takes_no_number_of_binary64(operate):
    with pytest.raises(sh.ShpyTypeError, match="Matrix2f of type f would narrow d") as caught:
        operate(sh.Matrix2f(), sh.Attrib1d(1 / 3))
    assert caught.value.cure == "the conversion written out, sh.Attrib1f(…)"


@sh.struct
class Turned:
    by: sh.Matrix2f
    times: sh.Attrib1f


@pytest.mark.parametrize(
    "store",
    [
        lambda rows: sh.Matrix2f().__setitem__(slice(None), rows),
        lambda rows: sh.Array(sh.Matrix2f, 2).__setitem__(0, rows),
        lambda rows: setattr(Turned(sh.Matrix2f(), 1), "by", rows),
        lambda rows: Turned(rows, 1),
    ],
)
@pytest.mark.parametrize("whole", [False, True])
def test_no_store_into_a_matrix_narrows_binary64(store, whole):
    def f(x: sh.Attrib1d, row: sh.Attrib2d) -> sh.Attrib1f:
        store((row, row) if whole else ((x, 1), (0, x)))

    with pytest.raises(sh.ShpyTypeError, match=r"of type f2? would narrow d"):
        sh.program(f)


def test_a_matrix_that_is_returned_narrows_no_binary64():
    def f(x: sh.Attrib1d) -> sh.Matrix2f:
        return ((x, 1), (0, x))

    with pytest.raises(sh.ShpyTypeError, match="f gives back of type f would narrow d"):
        sh.program(f)


MATRIX_MISTAKES = {
    "Matrix3f == Matrix3f has no meaning": (sh.ShpyTypeError, lambda m: m == m, "sh.all(m[0] == n[0])"),
    "Matrix3f != Matrix3f has no meaning": (sh.ShpyTypeError, lambda m: m != sh.Matrix3f(), "sh.any(m[0] != n[0])"),
    "Matrix3f == int has no meaning": (sh.ShpyTypeError, lambda m: m == 1, "sh.all(m[0] == n[0])"),
    "row 3 of 3": (sh.ShpyIndexError, lambda m: m[3], "0 to 2"),
    "row -4 of 3": (sh.ShpyIndexError, lambda m: m[-4, 0], "0 to 2"),
    "row 4 of 3": (sh.ShpyIndexError, lambda m: m.__setitem__((4, 0), 1.0), "0 to 2"),
    "row 5 of 3": (sh.ShpyIndexError, lambda m: m.__setitem__(5, (1, 2, 3)), "0 to 2"),
    "'a' is no row of a Matrix3f": (sh.ShpyTypeError, lambda m: m["a"], "m[r, c]"),
    "a matrix has 2 axes, not 3": (sh.ShpyTypeError, lambda m: m[0, 1, 2], "m[r, c]"),
    "no slices": (sh.ShpyTypeError, lambda m: m[:, 0], "sh.transpose(m)[c]"),
    "and no slices": (sh.ShpyTypeError, lambda m: m.__setitem__((np.s_[:], 0), 1.0), "m[0, c], m[1, c], m[2, c] = v"),
}


@pytest.mark.parametrize("said", MATRIX_MISTAKES)
def test_mistakes_with_matrices_have_cures(said):
    kind, mistake, cure = MATRIX_MISTAKES[said]
    with pytest.raises(kind) as error:
        mistake(sh.Matrix3f())
    assert said in str(error.value)
    assert cure in error.value.cure
    assert __file__ in str(error.value)


def test_matrices_and_other_objects_are_not_equal():
    m = sh.Matrix2f()
    assert (m == None, m != None, m[-1].y) == (False, True, 1)  # noqa: E711


def test_a_table_of_an_array_with_a_channel_more_names_the_slice():
    for shape, cure in (((5, 4), "array[..., :3]"), ((6, 2), "array.reshape(-1, 3)"), (12, "array.reshape(-1, 3)")):
        with pytest.raises(sh.ShpyTypeError) as error:
            sh.Table(np.zeros(shape), sh.Attrib3f)
        assert error.value.cure == cure


def test_a_matrix_moves_points_turns_vectors_and_keeps_normals_normal():
    m = sh.Matrix4f((2, 0, 0, 1), (0, 1, 0, 2), (0, 0, 1, 3), (0, 0, 0, 1))
    assert value(m @ sh.Point3f(1, 1, 1)) == [3, 3, 4]
    assert value(m @ sh.Vector3f(1, 1, 1)) == [2, 1, 1]
    assert value(m @ sh.Normal3f(1, 1, 1)) == [0.5, 1, 1]
    assert type(m @ sh.Normal3f(1, 1, 1)) is sh.Normal3f
    with pytest.raises(sh.ShpyTypeError, match="is it a place or a direction"):
        m @ sh.Attrib3f(1, 1, 1)


@pytest.mark.parametrize("wrong", [2.5, 2.0, np.float32(3), True, float("nan"), sh.Attrib1f(2), sh.Attrib1b(True)])
def test_words_are_ints(wrong):
    for function in (sh.hash, lambda x: sh.hash(1, x), lambda x: sh.hash(sh.Attrib1u(1), 2, x)):
        with pytest.raises(sh.ShpyTypeError, match=r"sh.hash takes one to three u, or i"):
            function(wrong)
    with pytest.raises(sh.ShpyTypeError, match=r"sh.unit_float takes u"):
        sh.unit_float(wrong)


def test_noise_takes_no_bools():
    for wrong in (True, sh.Attrib1b(True), sh.Attrib3b(True), (True, False)):
        with pytest.raises(sh.ShpyTypeError, match=r"sh.noise does not take b"):
            sh.noise(wrong)
    assert value(sh.noise(2)) == value(sh.noise((1, 2.0))) == 0


def test_hash_is_pcg():
    def pcg(x):
        state = (x * 747796405 + 2891336453) % 2**32
        word = (((state >> ((state >> 28) + 4)) ^ state) * 277803737) % 2**32
        return (word >> 22) ^ word

    assert value(sh.hash(7)) == pcg(7)
    assert value(sh.hash(7, 8)) == pcg((7 + pcg(8)) % 2**32)
    assert value(sh.hash(7, 8, 9)) == pcg((7 + pcg((8 + pcg(9)) % 2**32)) % 2**32)
    assert value(sh.unit_float(sh.Attrib1u(2**32 - 1))) == 1 - 2**-24
    assert value(sh.unit_float(sh.Attrib1u(0))) == 0
