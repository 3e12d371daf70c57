"""In-place stores of every form, as numpy has them: each program against the same steps in numpy."""

import functools

import numpy as np
import pytest

import shpy as sh
from shpy import SH_BREAK, SH_DO, SH_ELIF, SH_ELSE, SH_FOR, SH_IF, SH_RETURN, SH_UNTIL, SH_WHILE


@sh.struct
class Ray:
    o: sh.Point3f
    d: sh.Vector3f


def test_parts_written_back():
    @sh.program
    def f(v: sh.Attrib3f):
        v.xy += 1
        v[2] *= 3
        v.zx -= (1, 2)
        t = v.xy
        t += 100
        return v, t

    v, t = f((1, 2, 3))
    assert v.tolist() == [0, 3, 8]
    assert t.tolist() == [100, 103]


def test_arrays_of_values_and_structs():
    @sh.program
    def f(x: sh.Attrib1f, i: sh.Attrib1i):
        a = sh.Array(sh.Attrib1f, [x, x + 1, x + 2])
        a[i] += 10
        a[i + 1] = 5
        rays = sh.Array(Ray, 2)
        ray = Ray((x, 0, 0), (0, 1, 0))
        ray.o.y = 7
        rays[1] = ray
        ray.o[:] = (9, 9, 9)
        b = a.copy()
        b[0] = -1
        return a[0], a[1], a[2], rays[i].o, rays[1].o, len(a), b[0], a[-1]

    out = f(1, [0, 2, 7])
    assert out[0].tolist() == [11, 1, 1]
    assert out[1].tolist() == [5, 2, 2]
    assert out[2].tolist() == [3, 13, 3]
    assert out[3].tolist() == [[0, 0, 0], [1, 7, 0], [1, 7, 0]]
    assert out[4].tolist() == [[1, 7, 0]] * 3
    assert out[5].tolist() == [3] * 3
    assert out[6].tolist() == [-1] * 3
    assert out[7].tolist() == [3, 13, 3]


def test_an_array_in_a_loop_is_fresh_in_each_iteration():
    @sh.program
    def f(x: sh.Attrib1f):
        total = sh.Attrib1f(0)
        with SH_FOR(3) as i:
            a = sh.Array(sh.Attrib1f, 4)
            total += a[1]
            a[1] = x + i
        return total

    assert f(5) == 0


def test_a_value_in_a_loop_is_fresh_in_each_iteration():
    @sh.program
    def f(x: sh.Attrib1f):
        total = sh.Attrib1f(0)
        with SH_FOR(3) as i:
            v = sh.Attrib2f()
            with SH_IF(i == 0):
                v.x = x
            total += v.x
        return total

    assert f(5) == 5


def test_matrix_and_struct_stores():
    @sh.program
    def f(m: sh.Matrix2f, ray: Ray):
        m[0, 1] = 5
        m[1] = (7, 8)
        m *= 2
        n = sh.Matrix2f(m)
        n[0] += 1
        other = ray.copy()
        other.d += 1
        other.o.x -= 1
        ray[:] = other
        other.d = (0, 0, 0)
        sh.swap(m, n)
        return m, n, ray

    m, n, ray = f([[1, 2], [3, 4]], {"o": (1, 1, 1), "d": (0, 0, 0)})
    assert m.tolist() == [[3, 11], [14, 16]]
    assert n.tolist() == [[2, 10], [14, 16]]
    assert ray.o.tolist() == [0, 1, 1]
    assert ray.d.tolist() == [1, 1, 1]


def test_swap_and_rotation():
    @sh.program
    def f(x: sh.Attrib2f, y: sh.Attrib2f):
        sh.swap(x, y)
        x[:] = x.yx
        return x, y

    x, y = f((1, 2), (3, 4))
    assert x.tolist() == [4, 3]
    assert y.tolist() == [1, 2]


def test_inputs_come_by_value_and_helpers_take_references():
    def helper(p):
        p += 1

    @sh.program
    def inner(x: sh.Attrib1f) -> sh.Attrib1f:
        x += 10
        return x

    @sh.program
    def f(x: sh.Attrib1f):
        y = sh.Attrib1f(x)
        z = inner(y)
        helper(y)
        return y, z

    assert [float(v) for v in f(1)] == [2, 11]


def test_what_was_recorded_before_sees_later_stores_of_the_loop():
    @sh.program
    def f(x: sh.Attrib1f):
        y = x + 1
        total = sh.Attrib1f(0)
        with SH_FOR(3):
            total += y
            y += 1
        return total

    assert f(0) == 1 + 2 + 3


def test_expressions_keep_the_moment():
    @sh.program
    def f(x: sh.Attrib1f):
        y = x * 2
        x += 100
        return y, x

    assert [float(v) for v in f(1)] == [2, 101]


@pytest.mark.parametrize("links", [3, 12, 13, 40, 70])
def test_long_chains(links):
    @sh.program
    def f(x: sh.Attrib1f):
        y = sh.Attrib1f(-1)
        with SH_IF(x < 0):
            y[:] = -2
        for k in range(links):
            with SH_ELIF(x < k + 1):
                y[:] = k
        with SH_ELSE():
            y[:] = 1000
        return y

    x = np.array([-1, 0.5, links - 0.5, links + 5])
    assert f(x).tolist() == [-2, 0, links - 1, 1000]


def test_early_returns_from_loops():
    @sh.program
    def f(x: sh.Attrib1f) -> sh.Attrib1f:
        with SH_FOR(10) as i:
            with SH_DO():
                SH_RETURN(100 + i, x < 0)
                with SH_WHILE(lambda: x > 50):
                    SH_RETURN(x)
                x += 1
                SH_BREAK(x > 20)
                SH_UNTIL(x > 7)
        return x

    def reference(x):
        for i in range(10):
            while True:
                if x < 0:
                    return 100 + i
                if x > 50:
                    return x
                x += 1
                if x > 20 or x > 7:
                    break
        return x

    values = [-1, 0, 3, 15, 60]
    assert f(values).tolist() == [reference(v) for v in values]


def test_host_conditions_and_metaprogramming():
    def power(x, n):
        result = sh.Attrib1f(1)
        for _ in range(n):
            result = result * x
        return result

    def make(n):
        @sh.program
        def f(x: sh.Attrib1f):
            with SH_IF(n > 2):
                x += 1000
            return power(x, n)

        return f

    assert make(2)(3) == 9
    assert make(3)(1) == 1001.0**3


def test_methods_and_partials():
    import functools

    class Gain:
        factor = 3

        def apply(self, x: sh.Attrib1f) -> sh.Attrib1f:
            return x * self.factor

    def scaled(x: sh.Attrib1f, by):
        return x * by

    assert sh.program(Gain().apply)(2) == 6
    assert sh.program(functools.partial(scaled, by=5))(2) == 10


def test_an_array_is_stored_whole():
    @sh.program
    def f(x: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f, sh.Attrib1f]:
        a, b = sh.Array(sh.Attrib1f, 3), sh.Array(sh.Attrib1f, [x, 2 * x, 3 * x])
        a[:] = b
        b[:] = (b[2], b[0], b[1])
        a[1] += b[0]
        return a[0], a[1], b[2]

    assert f(1) == (1, 5, 2)


def test_an_array_takes_as_many_elements_as_it_has():
    def f(x: sh.Attrib1f) -> sh.Attrib1f:
        a = sh.Array(sh.Attrib1f, 3)
        a[:] = [x, x]
        return a[0]

    with pytest.raises(sh.ShpyTypeError, match=r"a\[:\] of an Array of 3 takes as many elements, not 2 elements"):
        sh.program(f)


GRID = sh.Table(np.ones((2, 2, 2)), sh.Matrix2f, name="GRID")
TURN = sh.Param(sh.Matrix2f, np.eye(2), name="TURN")


def copied(m: sh.Matrix2f, v: sh.Vector3f, i: sh.Attrib1i, how: str = "") -> sh.Attrib1f:
    rays = sh.Array(Ray, 2)
    lens = Ray((0, 0, 0), (0, 0, 1))
    if how == "entry":
        m[0][1] = 5
    if how == "row":
        m[1][:] = 5
    if how == "component of a row":
        m[0].x += 5
    if how == "row of an element":
        GRID[i][0][1] = 5
    if how == "row of a Param":
        TURN[1][0] = 5
    if how == "row of an element with a name":
        element = GRID[i]
        element[1][0] = 5
    if how == "varying component":
        v[i][:] = 5
    if how == "varying row":
        m[i][1] = 5
    if how == "whole":
        v[:].x = 5
    if how == "field of an element":
        rays[i].o += 5
    if how == "field":
        lens.o.zx[1] = 5
    if how == "entry given":
        doubled(m[0, 1])
    if how == "element given":
        doubled(GRID[i][1])
    if how == "whole matrix":
        m[:][1] += v.xy
    return v.x


@sh.subroutine
def doubled(x):
    x *= 2


@pytest.mark.parametrize(
    ("how", "line", "message"),
    [
        ("entry", 4, "m[0] is a copy, so a store into m[0][1] would be lost\n  write instead: m[0, 1] = …"),
        (
            "row",
            6,
            "m[1] is a copy, so a store into m[1][:] would be lost\n  write instead: m[1] = …, with the whole value",
        ),
        (
            "component of a row",
            8,
            "m[0] is a copy, so a store into m[0].x would be lost\n  write instead: m[0] = …, with the whole value",
        ),
        (
            "row of an element",
            10,
            "GRID[…][0] is a copy, so a store into GRID[…][0][1] would be lost\n"
            "  write instead: y = GRID[…][0], and y[1] = …",
        ),
        (
            "row of a Param",
            12,
            "m[1] is a copy, so a store into m[1][0] would be lost\n  write instead: y = m[1], and y[0] = …",
        ),
        (
            "row of an element with a name",
            15,
            "m[1] is a copy, so a store into m[1][0] would be lost\n  write instead: m[1, 0] = …",
        ),
        (
            "varying component",
            17,
            "v[i] is a copy, so a store into v[i][:] would be lost\n  write instead: v[i] = …, with the whole value",
        ),
        ("varying row", 19, "m[i] is a copy, so a store into m[i][1] would be lost\n  write instead: m[i, 1] = …"),
        ("whole", 21, "v[:] is a copy, so a store into v[:].x would be lost\n  write instead: v.x = …"),
        (
            "field of an element",
            23,
            "rays[i] is a copy, so a store into rays[i][:] would be lost\n"
            "  write instead: rays[i] = …, with the whole value",
        ),
        ("field", 25, "lens.o.zx is a copy, so a store into lens.o.zx[1] would be lost\n  write instead: lens.o.x = …"),
        (
            "entry given",
            27,
            "doubled stores into x, which is given m[0, 1], a copy\n"
            "  write instead: x = m[0, 1] first, and m[0, 1] = x after the call",
        ),
        (
            "element given",
            29,
            "doubled stores into x, which is given GRID[…][1], a copy\n  write instead: x = GRID[…][1]",
        ),
        (
            "whole matrix",
            31,
            "m[1] is a copy, so a store into m[1][:] would be lost\n  write instead: m[1] = …, with the whole value",
        ),
    ],
)
def test_a_store_into_a_copy_is_an_error(how, line, message):
    with pytest.raises(sh.RecordError) as caught:
        sh.program(functools.partial(copied, how=how))
    assert str(caught.value) == f"{__file__}:{copied.__code__.co_firstlineno + line}: {message}"


def test_a_copy_with_a_name_is_stored_into():
    @sh.program
    def f(m: sh.Matrix2f, v: sh.Vector3f, i: sh.Attrib1i):
        row = m[0]
        row[1] = 5
        rows = [m[r] for r in range(2)]
        rows[0].x = 7
        rows[1] *= 2
        entry = v[i]
        entry[:] = 8
        m[1] += row
        m[0, 0] -= 1
        v[i] += 1
        whole = v[:]
        whole.z = 9
        element = GRID[0]
        element[1] = 0
        element[0, 0] += 1
        return m, rows[0], rows[1], v, entry, whole, element

    m, first, second, v, entry, whole, element = f(np.eye(2), (1, 2, 3), 1)
    assert m.tolist() == [[0, 0], [1, 6]]
    assert first.tolist() == [7, 0]
    assert second.tolist() == [0, 2]
    assert v.tolist() == [1, 3, 3]
    assert entry == 8
    assert whole.tolist() == [1, 3, 9]
    assert element.tolist() == [[2, 1], [0, 0]]


def test_matrices_are_stored_into_at_varying_rows():
    @sh.program
    def f(m: sh.Matrix3f, i: sh.Attrib1i, j: sh.Attrib1u):
        rows, entries, sums = sh.Matrix3f(m), sh.Matrix3f(m), sh.Matrix3f(m)
        rows[i] = (7, 8, 9)
        entries[i, j] = 7
        sums[j] += m[i]
        sums[i, 0] *= 2
        return rows, entries, sums

    m = np.arange(9.0).reshape(3, 3)
    rows, entries, sums = f(m, [0, 2, 1, 3, -1], [1, 2, 3, 0, 1])
    for element, (i, j) in enumerate([(0, 1), (2, 2), (1, None), (None, 0), (None, 1)]):
        row, entry, total = m.copy(), m.copy(), m.copy()
        read = m[i] if i is not None else m[2 if element == 3 else 0]  # the nearest one
        if i is not None:
            row[i] = (7, 8, 9)
        if i is not None and j is not None:
            entry[i, j] = 7
        if j is not None:
            total[j] += read
        if i is not None:
            total[i, 0] *= 2
        assert [rows[element].tolist(), entries[element].tolist(), sums[element].tolist()] == [
            row.tolist(),
            entry.tolist(),
            total.tolist(),
        ]


@pytest.mark.parametrize(
    "use",
    [
        lambda m, v, x: m[x],
        lambda m, v, x: m.__setitem__(x, 1),
        lambda m, v, x: m.__setitem__((x, 0), 1),
        lambda m, v, x: v.__setitem__(x, 1),
        lambda m, v, x: v[x],
        lambda m, v, x: sh.Array(sh.Attrib1f, 3)[x],
    ],
)
def test_an_index_is_one_int(use):
    for wrong in (sh.Attrib1f, sh.Attrib2i, sh.Attrib1b):

        def f(m: sh.Matrix3f, v: sh.Attrib3f, x: wrong) -> sh.Attrib1f:
            use(m, v, x)
            return v.x

        with pytest.raises(sh.ShpyTypeError, match="an index is one int") as caught:
            sh.program(f)
        made = "sh.Attrib1i(x) makes an int of a float"
        assert caught.value.cure == ("one component of a vector of ints" if wrong is sh.Attrib2i else made)


def test_products_in_place():
    def turn(a, b):
        a @= b

    @sh.program
    def f(m: sh.Matrix2f, n: sh.Matrix2f, p: sh.Point2f, v: sh.Attrib3f, count: sh.Attrib1i):
        turned, kept = sh.Matrix2f(m), m[1]
        with SH_FOR(count):
            m @= n
            p @= n
            v.xz @= n
            with SH_IF(count > 2):
                turn(turned, n)
        return m, p, v, turned, kept

    n = np.array([[2, 3], [0, 1]])
    m, p, v, turned, kept = f(np.ones((2, 2)), n, (1, 2), (1, 2, 3), [0, 2, 3])
    for element, count in enumerate([0, 2, 3]):
        power = np.linalg.matrix_power(n, count)
        assert m[element].tolist() == (np.ones((2, 2)) @ power).tolist()
        assert p[element].tolist() == ((1, 2) @ power).tolist()
        assert v[element, [0, 2]].tolist() == ((1, 3) @ power).tolist()
        assert turned[element].tolist() == (np.ones((2, 2)) @ (power if count > 2 else np.eye(2))).tolist()
    assert kept.tolist() == [[1, 1]] * 3


def test_a_matrix_of_a_block_is_made_before_it():
    def f(m: sh.Matrix2f, c: sh.Attrib1b) -> sh.Matrix2f:
        made = []
        with SH_IF(c):
            made.append(m @ m)
        return made[0]

    with pytest.raises(sh.RecordError, match=r"x\[0\] was made inside the SH_IF block") as caught:
        sh.program(f)
    cure = "make the whole matrix or struct before the block, and store inside it, as in x[:] = …"
    assert caught.value.cure == cure
