"""Structs and their bases: fields, methods and super(); copies of structs and of other values."""

import copy
import pickle
from abc import ABC
from typing import ClassVar, Protocol

import numpy as np
import pytest

import shpy as sh


def test_a_struct_has_the_fields_of_its_base_first():
    @sh.struct
    class Base:
        a: sh.Attrib1f
        b: sh.Attrib3f

        def total(self):
            return self.a + self.b.x

    @sh.struct
    class Derived(Base):
        c: sh.Attrib1i

    @sh.program
    def made(x: sh.Attrib1f, v: sh.Attrib3f) -> Derived:
        found = Derived(x, v, 1)
        assert isinstance(found, Base)
        found.a = found.total()
        return found

    found = made(np.float32([2]), np.float32([[3, 4, 5]]))
    assert found._fields == ("a", "b", "c")
    assert (found.a.tolist(), found.b.tolist(), found.c.tolist()) == ([5], [[3, 4, 5]], [1])
    with pytest.raises(sh.ShpyError, match="takes the fields a, b, c"):
        Derived(1, 2, 3, 4)


class Sized:
    """A base that is no struct. It says which field its methods read."""

    size: sh.Attrib1f

    def area(self):
        return self.size * self.size


@sh.struct
class Square(Sized, ABC):
    """A square."""

    size: sh.Attrib1f
    name = "square"

    @property
    def twice(self):
        return 2 * super().area()


@sh.struct
class Box(Square):
    height: sh.Attrib1f

    def __init__(self, size, height):
        super().__init__(size, height)

    def area(self):
        return 4 * self.size * self.height + 2 * super().area()


def test_a_struct_has_the_methods_of_bases_that_are_no_structs():
    @sh.program
    def areas(square: Square, height: sh.Attrib1f):
        assert isinstance(square, Sized)
        box = Box(square.size, height)
        box.height += 1
        return square.area(), square.twice, box.area(), box.copy().twice

    assert [float(found) for found in areas({"size": 3}, 1)] == [9, 18, 42, 18]
    assert (Square.__doc__, Square.name, Square.__qualname__) == ("A square.", "square", "Square")
    assert type(pickle.loads(pickle.dumps(Box(1, 2)))) is Box


def test_a_base_that_has_fields_or_a_constructor_but_is_no_struct_is_an_error():
    class Constructed:
        def __init__(self):
            self.o = 1

    class Named(Protocol):
        def called(self): ...

    class Placed:
        at: sh.Point3f
        count: ClassVar[int] = 3

    needs = "which structs need"
    for base, says, cure in (
        (
            dict,
            f"its base dict has __init__ of its own, {needs}",
            "a base with other methods alone, or @sh.struct above",
        ),
        (Constructed, f"its base Constructed has __init__ of its own, {needs}", "@sh.struct above class Constructed"),
        (Named, f"its base Named has __init__ of its own, {needs}", "no protocol among the bases"),
        (Placed, "its base Placed with the field at is not a struct", "@sh.struct above class Placed"),
    ):
        with pytest.raises(sh.ShpyTypeError, match=f"Ball is a struct, and {says}") as caught:

            @sh.struct
            class Ball(base):
                radius: sh.Attrib1f

        assert caught.value.loc.file == __file__
        assert cure in caught.value.cure


def test_what_belongs_to_the_class_is_no_field():
    @sh.struct
    class Die:
        value: sh.Attrib1i
        faces: ClassVar[int] = 6

        def wrapped(self):
            return (self.value - 1) % Die.faces + 1

    @sh.program
    def rolled(die: Die):
        return die.wrapped()

    assert rolled({"value": [0, 6, 7]}).tolist() == [6, 6, 1]


def test_defaults_of_fields_are_parameters_of_a_constructor():
    with pytest.raises(sh.ShpyTypeError) as caught:

        @sh.struct
        class Spot:
            size: sh.Attrib1f = 2.0
            at: sh.Attrib2f
            turn: sh.Matrix2f = sh.Matrix2f()

    assert caught.value.message == "Spot is a struct, and its field size has a default, which structs do not take"
    assert caught.value.cure == (
        "def __init__(self, at, size=2.0, turn=[[1.0, 0.0], [0.0, 1.0]]): super().__init__(size, at, turn)"
    )

    @sh.struct
    class Cured:
        size: sh.Attrib1f
        at: sh.Attrib2f
        turn: sh.Matrix2f

        def __init__(self, at, size=2.0, turn=((1.0, 0.0), (0.0, 1.0))):
            super().__init__(size, at, turn)

    assert str(Cured((3, 4)).size + Cured((3, 4), 5).size) == "Attrib1f(7.0)"


@sh.struct
class Pair:
    a: sh.Attrib2f
    b: sh.Attrib2f

    def exchange(self):
        self.a, self.b = self.b, self.a


def together(p, q):
    p.a, q.b = q.b, p.a


def by_three(p, q):
    (
        p.a,
        p.b,
        q.a,
    ) = (
        p.b,
        q.a,
        p.a,
    )


EXCHANGES = {
    "method": (
        lambda p, q: p.exchange(),
        "`self.a, self.b = self.b, self.a` stores into `self.a` before `self.b` is stored from it\n"
        "  write instead: copy first, or `sh.swap(self.a, self.b)`",
    ),
    "two structs": (
        together,
        "`p.a, q.b = q.b, p.a` stores into `p.a` before `q.b` is stored from it\n"
        "  write instead: copy first, or `sh.swap(p.a, q.b)`",
    ),
    "several lines": (
        by_three,
        "`p.a, p.b, q.a = (p.b, q.a, p.a)` stores into `p.a` before `q.a` is stored from it\n"
        "  write instead: copy first: `old = p.a.copy()`, and `old` for `p.a` on the right",
    ),
}


@pytest.mark.parametrize("case", EXCHANGES)
def test_fields_that_change_places_are_copied_first(case):
    exchange, message = EXCHANGES[case]

    def f(p: Pair, q: Pair) -> Pair:
        exchange(p, q)
        return p

    with pytest.raises(sh.RecordError) as caught:
        sh.program(f)
    assert str(caught.value).split(": ", 1)[1] == message


def test_fields_that_are_stored_in_order_do_not_change_places():
    @sh.program
    def f(p: Pair, q: Pair):
        for _ in range(2):
            p.a, p.b = p.b, p.a + p.b
        q.a, q.b = q.b.copy(), sh.Attrib2f(q.a)
        q.a = q.b
        q.b = q.a
        return p, q

    p, q = f({"a": (1, 2), "b": (3, 4)}, {"a": (5, 6), "b": (7, 8)})
    assert [p.a.tolist(), p.b.tolist()] == [[4, 6], [7, 10]]
    assert [q.a.tolist(), q.b.tolist()] == [[5, 6], [5, 6]]


def test_a_field_without_a_value_is_named_as_users_do():
    def f(x: sh.Attrib2f) -> Pair:
        made = Pair()
        made.b += x
        return made

    with pytest.raises(sh.RecordError, match=r"made\.b is read here, but nothing can have been stored") as caught:
        sh.program(f)
    assert caught.value.cure == "made.b[:] = … first, or make it with a value"


@sh.struct
class Lens:
    rim: Pair
    turn: sh.Matrix2f
    count: sh.Attrib1i

    def __init__(self, rim, count):
        super().__init__(rim, ((0, 1), (1, 0)), count)


@sh.struct
class Camera:
    lens: Lens


PARTS = {
    "tuple": lambda x: ((x, 2 * x), ((1, 2), (3, 4)), 5),
    "dict": lambda x: {"turn": ((1, 2), (3, 4)), "rim": {"a": x, "b": 2 * x}, "count": 5},
    "list": lambda x: [Pair(x, 2 * x), sh.Matrix2f((1, 2), (3, 4)), 5],
}


@pytest.mark.parametrize("parts", PARTS)
def test_a_field_that_is_a_struct_takes_its_parts(parts):
    @sh.program
    def f(x: sh.Attrib2f):
        made = Camera(PARTS[parts](x))
        stored, whole = Camera(Lens((x, x), 1)), Camera(Lens((x, x), 1))
        stored.lens = PARTS[parts](x)
        whole[:] = [PARTS[parts](x)]
        return made, stored, whole

    for camera in f((1, 2)):
        assert camera.lens.rim.a.tolist() == [1, 2]
        assert camera.lens.rim.b.tolist() == [2, 4]
        assert camera.lens.turn.tolist() == [[1, 2], [3, 4]]
        assert camera.lens.count == 5


@sh.struct
class Assigned:
    rim: Pair
    count: sh.Attrib1i

    def __init__(self, rim, count):
        self.rim, self.count = rim, count


def test_a_constructor_that_assigns_fields_calls_that_of_structs_first():
    for make in (lambda: Assigned((1, 2), 3), lambda: sh.program(lambda: Assigned((1, 2), 3))):
        with pytest.raises(sh.ShpyAttributeError) as caught:
            make()
        assert caught.value.message == "this Assigned has no fields yet: super().__init__ makes them"
        assert caught.value.cure == "super().__init__(rim, count) first"
        assert caught.value.loc.line == Assigned.__init__.__code__.co_firstlineno + 1


def test_parts_of_a_struct_are_read_before_one_is_stored():
    @sh.program
    def f(x: sh.Attrib1f):
        made = Pair((x, 2 * x), (3 * x, 4 * x))
        made[:] = {"a": made.b, "b": (made.a.y, made.a.x)}
        return made

    made = f(1)
    assert [made.a.tolist(), made.b.tolist()] == [[3, 4], [2, 1]]


@pytest.mark.parametrize("stored", [False, True])
@pytest.mark.parametrize("value", [5, None, "ab", ((1, 2),), {"a": 1}])
def test_a_field_that_is_a_struct_takes_nothing_else(value, stored):
    def f(x: sh.Attrib2f) -> sh.Attrib2f:
        camera = Camera(Lens((x, x), 1) if stored else value)
        camera.lens = value
        return x

    with pytest.raises(sh.ShpyTypeError) as caught:
        sh.program(f)
    name, given = "Lens" if stored else "Camera.lens", type(value).__name__
    assert caught.value.message == f"{name} has the parts rim, turn, count, and {given} does not give just these"


@sh.struct
class Held:
    copy: sh.Attrib1f


COPIED = {
    "value": (lambda x: x, lambda v: v),
    "matrix": (lambda x: sh.Matrix2f((x, 0), (0, 1)), lambda m: m[0, 0]),
    "struct": (lambda x: Held(x), lambda s: s.copy),
    "array": (lambda x: sh.Array(sh.Attrib1f, [x]), lambda a: a[0]),
}


@pytest.mark.parametrize("name", COPIED)
@pytest.mark.parametrize("function", [copy.copy, copy.deepcopy])
def test_copies_by_the_module_copy_are_variables_of_their_own(function, name):
    make, part = COPIED[name]

    @sh.program
    def f(x: sh.Attrib1f):
        old = make(x)
        new = function(old)
        if name == "struct":
            new.copy += 10
        else:
            new[:] = make(x + 10)
        return part(old), part(new)

    assert f(1) == (1, 11)


def test_a_deep_copy_of_the_state_of_a_program_has_values_of_its_own():
    gain = sh.Param(sh.Attrib1f, 3.0)

    @sh.program
    def f(x: sh.Attrib1f):
        old = {"at": x, "both": [x, x + 1], "gain": gain}
        new = copy.deepcopy(old)
        new["at"] += 10
        new["both"][1] += 10
        new["gain"] += 1
        return old["at"], *old["both"], *new["both"], new["gain"]

    other = copy.deepcopy(gain)
    gain.value = 5
    assert other.value == 3
    assert f(1) == (1, 1, 2, 11, 12, 6)


def test_operators_in_place_reach_matrices_wherever_they_are_held():
    @sh.struct
    class Pose:
        turn: sh.Matrix2f

    @sh.program
    def f(x: sh.Attrib1f) -> sh.Matrix2f:
        many = sh.Array(sh.Matrix2f, 2)
        many[1] += 1
        many[1] *= x
        one = Pose(many[1])
        one.turn -= 2
        one.turn[:] /= 4
        return one.turn

    assert f(10).tolist() == [[2, 2], [2, 2]]
    with pytest.raises(sh.RecordError, match=r"a store into poses\[i\]\[:\] would be lost"):

        @sh.program
        def lost(x: sh.Attrib1f) -> sh.Matrix2f:
            poses = sh.Array(Pose, 2)
            poses[0].turn *= x
            return poses[0].turn


@pytest.mark.parametrize("number", [1.5, True, sh.Attrib1f(1), sh.Attrib1u(1)])
def test_a_constructor_narrows_no_field_as_no_store_does(number):
    @sh.struct
    class Item:
        count: sh.Attrib1i
        weight: sh.Attrib1f

    with pytest.raises(sh.ShpyTypeError, match=r"field Item\.count (of type i would narrow|mixes i with u)"):
        Item(number, 1)
    assert np.asarray(Item(2, 1).weight) == 1


@pytest.mark.parametrize(
    "line",
    [
        "pair = pairs[i]; pair.a.x += 1; pairs[i] = pair",
        "pair = pairs[i]; pair.a = pair.a + sh.Attrib2f(1, 0); pairs[i] = pair",
        "a = pairs[i].a; a.x = 1; pairs[i] = Pair(a, pairs[i].b)",
    ],
)
def test_a_copy_may_be_named_and_stored_into_on_one_line(line, tmp_path):
    file = tmp_path / "case.py"
    file.write_text(f"def f(i: sh.Attrib1i):\n    pairs = sh.Array(Pair, 2)\n    {line}\n    return pairs[1]\n")
    names = {"sh": sh, "Pair": Pair}
    exec(compile(file.read_text(), str(file), "exec"), names)
    assert sh.program(names["f"])(1).a.tolist() == [1, 0]


@sh.struct
class Placed:
    turn: sh.Matrix2f
    at: sh.Attrib2f


def test_rows_of_values_make_a_matrix_in_every_store():
    @sh.program
    def rows(x: sh.Attrib1f) -> sh.Matrix2f:
        whole, parts = sh.Array(sh.Matrix2f, 2), sh.Array(Placed, 1)
        whole[1] = ((x, 2), (3, x))
        whole[0] = (sh.Attrib2f(x, 5), (6, 7))
        parts[0] = {"turn": ((x, 0), whole[0][1]), "at": (x, 1)}
        sh.SH_RETURN(((x, parts[0].turn[1, 0]), (whole[1][1, 0], 4)), x > 1)
        return [(x, 0), (0, x)]

    assert rows([1, 2]).tolist() == [[[1, 0], [0, 1]], [[2, 6], [3, 4]]]
