"""Tables of structs and matrices, and tables as arguments, whose shape a run brings."""

import numpy as np
import pytest
from backends.test_uniforms import assert_same, everywhere

import shpy as sh
from shpy import SH_FOR

RNG = np.random.default_rng(9)


@sh.struct
class Ball:
    center: sh.Point3f
    radius: sh.Attrib1f
    color: sh.Attrib1i


@sh.struct
class Placed:
    ball: Ball
    turn: sh.Matrix2f


def balls(n, *more):
    shape = (n, *more)
    return {
        "center": RNG.uniform(-1, 1, (*shape, 3)),
        "radius": RNG.uniform(0, 1, shape),
        "color": RNG.integers(-5, 5, shape),
    }


def structured(fields):
    dtype = [("radius", "f8"), ("color", "i4"), ("center", "f8", 3)]
    made = np.zeros(fields["radius"].shape, dtype)
    for name in fields:
        made[name] = fields[name]
    return made


INDICES = np.array([-3, 0, 1, 2, 3, 4, 90])


@pytest.mark.sampled(9)
@everywhere
def test_elements_are_structs_and_matrices(options):
    fields = balls(5)
    turns = RNG.uniform(-1, 1, (5, 3, 3))
    table = sh.Table(fields, Ball)
    matrices = sh.Table(turns, sh.Matrix3f, name="turns")

    @sh.program
    def looked_up(i: sh.Attrib1i):
        ball = table[i]
        return matrices[i] @ ball.center, ball.radius, ball.color, ball

    @sh.program
    def given(ball: Ball, turn: sh.Matrix3f):
        return turn @ ball.center, ball.radius, ball.color, ball

    @sh.program
    def passed(table: sh.Table[Ball], turns: sh.Table[sh.Matrix3f], i: sh.Attrib1i):
        ball = table[i]
        return turns[i] @ ball.center, ball.radius, ball.color, ball

    nearest = np.clip(INDICES, 0, 4)
    for scale in (1, 3):
        fields = {name: array * scale for name, array in fields.items()}
        table.update(structured(fields) if scale == 3 else fields)
        expected = given.compile(**options)({n: a[nearest] for n, a in fields.items()}, turns[nearest])
        for found in (
            looked_up.compile(**options)(INDICES),
            passed.compile(**options)(fields, matrices, INDICES),
            passed.compile(**options)(table, turns, INDICES),
        ):
            assert_same(found[:3], expected[:3])
            assert_same(tuple(found[3]), tuple(expected[3]))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_a_table_that_is_an_argument_has_the_shape_of_its_data(backend):
    @sh.program
    def total(rows: sh.Table[Ball, 2], x: sh.Attrib1f):
        height, width = rows.shape
        result = sh.Attrib1f(x)
        with SH_FOR(0, height) as r, SH_FOR(0, width) as c:
            result += rows[r, c].radius
        return result, height * 10 + width

    kernel = total.compile(backend)
    for shape in ((2, 3), (4, 1), (1, 7)):
        fields = balls(*shape)
        expected = np.float32(0)
        for radius in fields["radius"].ravel():
            expected += np.float32(radius)
        found = kernel(fields, [0.0])
        assert (found[0][0], found[1].ravel()[0]) == (expected, shape[0] * 10 + shape[1])


@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_the_shape_of_a_table_that_is_never_read(backend):
    @sh.program
    def size(t: sh.Table[sh.Attrib1f, 2], x: sh.Attrib1i):
        height, width = t.shape
        return height * 10 + width + x

    assert size.compile(backend)(np.zeros((3, 4)), [0, 1]).tolist() == [34, 35]


def test_a_table_of_structs_is_one_table():
    table = sh.Table(balls(4), Ball)
    assert isinstance(table, sh.Table)
    assert (table.shape, table.rank, len(table)) == ((4,), 1, 4)

    @sh.program
    def f(i: sh.Attrib1i) -> sh.Attrib1f:
        return table[i].radius * table[i].center.x

    assert f.tables == {"table": table}
    assert [t.name for t in f.ir.tables] == ["table.center", "table.radius", "table.color"]
    assert "table_radius" in f.compile("opencl").source
    assert f.trace(i=1)


def test_structs_in_structs_and_constant_reads():
    data = {"ball": balls(3), "turn": RNG.uniform(-1, 1, (3, 2, 2))}
    table = sh.Table(data, Placed, name="placed")
    assert np.asarray(table[1].turn).tolist() == data["turn"][1].astype(np.float32).tolist()
    assert np.asarray(table[2].ball.color) == data["ball"]["color"][2]
    with pytest.raises(sh.ShpyError, match="index 3 on axis 0"):
        table[3]
    which = sh.Param(sh.Attrib1i, 1)
    radius = table[which].ball.radius * 2

    @sh.program
    def f(x: sh.Attrib1f) -> sh.Attrib1f:
        return x + radius

    which.value = 2
    assert f(0) == np.float32(data["ball"]["radius"][2]) * 2


def test_structured_arrays_are_structs():
    @sh.program
    def moved(ball: Ball) -> Ball:
        ball.center.x += ball.radius
        return ball

    fields = balls(6)
    out = structured(balls(6)).astype([("radius", "f4"), ("color", "i4"), ("center", "f4", 3)])
    found = moved(structured(fields))
    moved.compile().run(fields, out=out)
    for name in fields:
        assert np.array_equal(getattr(found, name), out[name])
    expected = fields["center"][:, 0].astype(np.float32) + fields["radius"].astype(np.float32)
    assert np.array_equal(found.center[:, 0], expected)


def test_programs_hand_tables_of_structs_on():
    @sh.program
    def radius(balls: sh.Table[Ball], i: sh.Attrib1i) -> sh.Attrib1f:
        return balls[i].radius

    @sh.program
    def twice(these: sh.Table[Ball], i: sh.Attrib1i) -> sh.Attrib1f:
        return radius(these, i) * 2

    fields = balls(4)
    assert twice(fields, 2) == np.float32(fields["radius"][2]) * 2
    bound = twice.bind(these=fields)
    assert list(bound.tables) == ["these"]
    assert bound(1) == np.float32(fields["radius"][1]) * 2
    again = sh.Program.from_ir(sh.parse(str(bound.ir)))
    parts = {f"these.{name}": array for name, array in fields.items()}
    assert again(1, **parts) == bound(1)
    with pytest.raises(sh.ShpyTypeError, match=r"these is a Table\[Ball, 1\], and this one a Table\[Attrib1f, 1\]"):
        twice(sh.Table([1.0], sh.Attrib1f), 0)


def test_what_does_not_fit_is_named_and_nothing_changes():
    fields = balls(4)
    table = sh.Table(fields, Ball)
    before = np.asarray(table[1].center)
    wrong = {
        r"the Table table has the parts center, radius, color": {"center": fields["center"]},
        r"update of the Table table.radius keeps the shape: \(4,\), not \(3,\)": fields | {"radius": [1, 2, 3]},
        r"the Table table.color takes ints": balls(4) | {"color": [0.5] * 4},
        r"the Table table.center of Point3f takes an array \(\*shape, 3\)": balls(4) | {"center": np.zeros((4, 2))},
    }
    for message, data in wrong.items():
        with pytest.raises(sh.ShpyTypeError, match=message):
            table.update(data)
    assert np.array_equal(np.asarray(table[1].center), before)
    with pytest.raises(sh.ShpyTypeError, match=r"the Table late has fields of several shapes: late.center \(4,\), "):
        sh.Table(fields | {"radius": [1, 2]}, Ball, name="late")
    with pytest.raises(sh.ShpyTypeError, match=r"takes an array \(\*S, 3, 3\)"):
        sh.Table(np.zeros((4, 2, 2)), sh.Matrix3f)
    with pytest.raises(sh.ShpyTypeError, match="a Table holds values of the language"):
        sh.Table([1], int)

    with pytest.raises(sh.RecordError, match="copy"):

        @sh.program
        def store(i: sh.Attrib1i) -> sh.Attrib1i:
            table[i].center = sh.Point3f(0)
            return i


def test_update_keeps_the_shape():
    heights = sh.Table(np.zeros((3, 4)), sh.Attrib1f)
    with pytest.raises(sh.ShpyTypeError, match=r"update of the Table heights keeps the shape: \(3, 4\), not \(4, 3\)"):
        heights.update(np.zeros((4, 3)))
