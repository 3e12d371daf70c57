"""dFdx and dFdy: the bits of differences of the neighbours' own values, and errors where there is no neighbour."""

import numpy as np
import pytest
from backends.running import covering

import shpy as sh
from shpy import SH_DISCARD, SH_ELSE, SH_FOR, SH_IF, SH_RETURN

on_every_backend = pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
gain = sh.Param(sh.Attrib1f, 0.75, name="gain")
image = sh.Texture2D(np.random.default_rng(8).random((7, 9)), wrap="mirror", name="image")


@sh.subroutine
def add(total: sh.Attrib1f, x: sh.Attrib1f):
    with SH_IF(x > 0.1):
        total += x
    with SH_ELSE():
        total -= 0.25 * x


@sh.program
def early(x: sh.Attrib1f) -> sh.Attrib1f:
    SH_RETURN(-x, x < 0)
    return sh.sqrt(x)


def place():
    row, column = sh.grid_index(2)
    return sh.vec2(column, row) * 0.37


def of_noise():
    return gain * sh.noise(place())


def of_texture():
    return image(place())


def of_loops_and_calls():
    p = place()
    total = sh.Attrib1f(0)
    unused = sh.Attrib1f(1)
    with SH_FOR(0, 4) as k:
        add(total, sh.noise(p * (k + 1)))
        unused += total
    return total


def of_an_array():
    p = place()
    numbers = sh.Array(sh.Attrib1f, 3)
    numbers[sh.grid_index(2).x % 3] = p.y
    numbers[1] += p.x
    with SH_IF(p.x > 1):
        numbers[0] = numbers[1] * 2
    return numbers[sh.grid_index(2).y % 3]


def of_a_program():
    return early(sh.noise(place()))


def of_stores():
    v = sh.vec3(place(), 1)
    v.z = v.x * v.y
    v.xy += v.z
    v *= sh.grid_index(2).x
    return v


def of_a_derivative():
    return sh.dFdy(sh.sqrt(place().x) * place().y)


VALUES = [of_noise, of_texture, of_loops_and_calls, of_an_array, of_a_program, of_stores, of_a_derivative]


def differences(f):
    @sh.program
    def program():
        x = f()
        return x, sh.dFdx(x), sh.dFdy(x)

    return program


@pytest.mark.sampled(2)
@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("shape", [(4, 6), (5, 7), (1, 1)])
def test_differences_are_those_of_the_neighbours(value, shape):
    """The derivatives are differences in whole quads: those of a grid extended to even sides, on numpy."""
    even = tuple(n + n % 2 for n in shape)
    program = differences(value)
    kernel = program.compile("numpy")
    own, dx, dy = kernel(shape=shape)
    whole = kernel(shape=even)[0]
    across = np.repeat(whole[:, 1::2] - whole[:, ::2], 2, axis=1)
    down = np.repeat(whole[1::2] - whole[::2], 2, axis=0)
    np.testing.assert_array_equal(own, whole[: shape[0], : shape[1]])
    np.testing.assert_array_equal(dx, across[: shape[0], : shape[1]])
    np.testing.assert_array_equal(dy, down[: shape[0], : shape[1]])
    assert shape == (1, 1) or np.ptp(dx) > 0


@pytest.mark.sampled(9)
@pytest.mark.parametrize("value", VALUES)
def test_all_backends_give_the_same_bits(value):
    sh.testing.assert_equivalent(differences(value), shape=(7, 9), backends=covering(VALUES.index(value)))


@on_every_backend
def test_a_table_gives_its_nearest_element_past_the_edge(backend):
    @sh.program
    def edges(heights: sh.Table[sh.Attrib1f, 2]):
        return sh.dFdx(heights[sh.grid_index(2)]), sh.dFdy(heights[sh.grid_index(2)])

    heights = np.float32([[1, 4, 9], [2, 8, 32], [0, 5, 7]])
    dx, dy = edges.compile(backend)(heights, shape=(3, 3))
    assert dx.tolist() == [[3, 3, 0], [6, 6, 0], [5, 5, 0]]
    assert dy.tolist() == [[1, 4, 23], [1, 4, 23], [0, 0, 0]]


@on_every_backend
def test_an_element_that_ended_before_counts_as_if_it_had_not(backend):
    @sh.program
    def ending():
        x = sh.Attrib1f(sh.grid_index(2).y) ** 2
        SH_DISCARD(x == 1)
        SH_RETURN(-1.0, x == 4)
        return sh.dFdx(x)

    result = ending.compile(backend).run(shape=(1, 6), out=np.full((1, 6), 7, np.float32))
    assert result.outputs.tolist() == [[1, 7, -1, 5, 9, 9]]


@pytest.mark.sampled(3)
@on_every_backend
def test_ranks_and_kinds(backend):
    @sh.program
    def line():
        return sh.dFdx(sh.grid_index(1) * 3)

    @sh.program
    def space() -> tuple[sh.Vector3f, sh.Attrib1f]:
        k, j, i = sh.grid_index(3)
        return sh.dFdx(sh.Point3f(i, 2 * j, 4 * k)), sh.dFdy(i + 2 * j + 4 * k)

    assert line.compile(backend)(shape=(4,)).tolist() == [3, 3, 3, 3]
    dx, dy = space.compile(backend)(shape=(2, 3, 4))
    assert np.unique(dx.reshape(-1, 3), axis=0).tolist() == [[1, 0, 0]]
    assert np.unique(dy).tolist() == [2]


def test_a_program_with_a_derivative_may_be_part_of_others():
    @sh.program
    def slope(scale: sh.Attrib1f) -> sh.Attrib1f:
        return scale * sh.dFdx(sh.noise(place()))

    @sh.program
    def both() -> sh.Attrib1f:
        s = slope(2.0)
        with SH_IF(s > 0):
            s[:] = slope(4.0)
        return s

    alone = slope.compile("numpy")(1, shape=(4, 6))
    expected = np.where(alone > 0, 4 * alone, 2 * alone)
    np.testing.assert_array_equal(both.compile("numpy")(shape=(4, 6)), expected)
    np.testing.assert_array_equal((early << slope)(1.0, shape=(4, 6)), early(alone))
    double = slope.compile("numpy", precision="f64")(1.0, shape=(4, 6))
    np.testing.assert_allclose(alone, double, atol=1e-6)


def refused():
    @sh.subroutine
    def where():
        return sh.grid_index(2) * 0.5

    @sh.subroutine
    def inside(x: sh.Attrib1f):
        return sh.dFdx(x)

    def ended():
        x = sh.Attrib1f(sh.grid_index(2).x)
        with SH_IF(x > 1):
            x *= 2
            SH_DISCARD(x > 4)
        return sh.dFdx(x)

    def in_block():
        x = place()
        with SH_IF(x.x > 1):
            x.x = sh.dFdx(x.x)
        return x

    yield "depends on the input uv, which", lambda uv: sh.dFdx(2 * uv.x + sh.grid_index(2).x)
    yield "does not depend on sh.grid_index", lambda uv: sh.dFdx(gain * 2)
    yield "of a constant", lambda uv: sh.dFdx(3.0)
    yield "one axis", lambda uv: sh.dFdy(sh.grid_index(1))
    yield "inside a block, SH_IF", lambda uv: in_block()
    yield "inside the subroutine inside", lambda uv: inside(place().x)
    yield "where computes, which asks for the index", lambda uv: sh.dFdx(where())
    yield "where the element may end", lambda uv: ended()
    yield "not bools", lambda uv: sh.cond(sh.dFdx(place().x > 1), 1.0, 2.0)


@pytest.mark.parametrize(("said", "wrong"), list(refused()))
def test_what_has_no_neighbour_is_refused(said, wrong):
    def program(uv: sh.Attrib2f):
        return wrong(uv)

    with pytest.raises(sh.ShpyError, match=said) as error:
        sh.program(program)
    assert error.value.loc.file == __file__
    assert error.value.cure


def test_a_derivative_outside_of_a_program_is_an_error():
    with pytest.raises(sh.RecordError, match="dFdx works only while a program is recorded"):
        sh.dFdx(1.0)
