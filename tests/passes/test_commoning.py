"""Values that an iteration shares with the next one: computed once, and only where every iteration computes them."""

import numpy as np
import pytest
from backends.test_packets import same

import shpy as sh
from shpy import SH_BREAK, SH_CONTINUE, SH_DISCARD, SH_DO, SH_FOR, SH_IF, SH_UNTIL, SH_WHILE
from shpy.backend.opencl.packets import module as packets
from shpy.ir.nodes import Let, Loop
from shpy.ir.traverse import walk
from shpy.passes import commoning
from shpy.passes.commoning import _shared, keep_for_next
from shpy.passes.pipeline import optimise

MOST = 24


@sh.subroutine
def cubic(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * x * x - 2 * x - 5


@sh.subroutine
def branching(x: sh.Attrib1f) -> sh.Attrib1f:
    """A function that a statement calls, since it has a loop."""
    y = sh.Attrib1f(x)
    with SH_FOR(2):
        with SH_IF(y < 0.75):
            y[:] = y * 0.5 + 1
    return y


def shared_operations(program):
    """Return the operations that each loop of a program shares with its next iteration, outer loops first."""
    module = optimise(program.ir)
    functions = {f.name: f for f in module.functions}
    operations = []
    for function in module.functions:
        for loop in walk(function.body):
            if isinstance(loop, Loop):
                lets = {s.value.id: s for s in (*loop.body, *loop.continuing) if isinstance(s, Let)}
                operations.append([lets[start].op for start in _shared(loop, functions)])
    return operations


def test_products_of_the_test_are_those_of_the_next_iteration():
    @sh.program
    def escapes(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
        x, y, n = sh.Attrib1f(a), sh.Attrib1f(b), sh.Attrib1f(0)
        with SH_DO():
            product = x * y
            x[:] = x * x - y * y + a
            y[:] = product + product + b
            n += 1
            SH_UNTIL((x * x + y * y > 4) | (n >= MOST))
        return n

    assert shared_operations(escapes) == [["mul", "mul"]]


def test_a_function_of_the_test_is_called_once_in_an_iteration():
    @sh.program
    def root(start: sh.Attrib1f) -> sh.Attrib1f:
        x = sh.Attrib1f(start)
        with SH_DO():
            x -= cubic(x) / (3 * x * x - 2)
            SH_UNTIL(sh.abs(cubic(x)) < 1e-3)
        return x

    (operations,) = shared_operations(root)
    assert operations in (["call"], ["sub"])
    x = np.linspace(2, 3, 50, dtype=np.float32)
    np.testing.assert_allclose(root.compile("opencl")(x), 2.0945514815, rtol=2e-4)


def test_nothing_is_shared_where_an_iteration_may_leave_it_out():
    @sh.program
    def branch(a: sh.Attrib1f) -> sh.Attrib1f:
        x, n = sh.Attrib1f(a), sh.Attrib1f(0)
        with SH_DO():
            y = x * x
            with SH_IF(y > 2):
                x[:] = y / 3
            n += y
            SH_UNTIL((x * x > 3) | (n > MOST))
        return x

    @sh.program
    def continued(a: sh.Attrib1f) -> sh.Attrib1f:
        x, n = sh.Attrib1f(a), sh.Attrib1f(0)
        with SH_DO():
            n += 1
            y = x * x
            x[:] = x + 1
            SH_CONTINUE(y > 2)
            x[:] = x * 0.5
            n += x * x
            SH_UNTIL(lambda: n > MOST)
        return x

    @sh.program
    def again(a: sh.Attrib1f) -> sh.Attrib1f:
        """The variable changes once more after the test's product."""
        x, n = sh.Attrib1f(a), sh.Attrib1f(0)
        with SH_DO():
            y = x * x
            x[:] = y - 1
            n += x * x
            x += 1
            SH_UNTIL(n > MOST)
        return x

    @sh.program
    def tested_first(a: sh.Attrib1f) -> sh.Attrib1f:
        x = sh.Attrib1f(a)
        with SH_WHILE(lambda: x * x < 9):
            x[:] = x * x + 1
        return x

    @sh.program
    def read_late(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
        """The end's product comes before the start's."""
        x, n = sh.Attrib1f(a), sh.Attrib1f(0)
        with SH_DO():
            before = sh.Attrib1f(x)
            x[:] = sh.clamp(x + b, -2, 2)
            n += x * x
            n += before * before * 3
            SH_UNTIL(n > MOST)
        return n

    for program in (branch, continued, again, tested_first, read_late):
        assert shared_operations(program) == [[]]


def expression(k, x):
    a, b, c = x
    vector = sh.Attrib2f(a, b)
    return [
        a * a,
        a * b,
        a * b + c,
        sh.dot(vector, vector),
        cubic(b),
        a * 0.5,
        c * c,
        b + a,
        1 / a,
        a,
        a * branching(b),
        branching(a),
    ][k]


def test_two_values_that_become_one_are_kept_apart():
    @sh.program
    def merging(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
        x, y, n = sh.Attrib1f(a), sh.Attrib1f(b), sh.Attrib1f(0)
        with SH_DO():
            n += x * x + 3 * (y * y)
            z = sh.clamp(x + y, -1, 1) + 0.125
            x[:] = z
            y[:] = z
            SH_UNTIL(z * z + n > MOST)
        return n

    assert shared_operations(merging) == [["mul", "mul"]]
    inputs = np.linspace(-2, 2, 99, dtype=np.float32), np.linspace(1, -1, 99, dtype=np.float32)
    assert merging.compile("opencl")(*inputs).tobytes() == merging.compile("numpy")(*inputs).tobytes()


def test_a_value_of_a_call_is_another_one_in_each_iteration():
    @sh.program
    def called(a: sh.Attrib1f) -> sh.Attrib1f:
        x, n = sh.Attrib1f(a), sh.Attrib1f(0)
        with SH_DO():
            r = branching(x)
            n += r * x
            x[:] = x * 0.5 + 0.25
            n += r * x
            SH_UNTIL(n > MOST)
        return n

    assert [] in shared_operations(called)
    x = np.linspace(0.1, 2, 99, dtype=np.float32)
    assert called.compile("opencl")(x).tobytes() == called.compile("numpy")(x).tobytes()


def random_orbit(seed, *, discards=True):
    """Return a function of two floats that computes few expressions often, so that iterations have some in common."""

    def orbit(a, b):
        rng = np.random.default_rng(seed)
        few = rng.integers(12, size=3)

        def some(x):
            return expression(rng.choice(few), x)

        def update(x, n):
            for _ in range(rng.integers(3)):
                value = some(x)
                match rng.integers(10):
                    case 0:
                        with SH_IF(value > 1):
                            x[rng.integers(3)][:] = value * 0.25
                    case 1:
                        SH_BREAK(value > 30)
                    case 2 | 4:
                        SH_CONTINUE(n == float(rng.integers(MOST)))
                    case 3 if discards and rng.integers(4) == 0:
                        SH_DISCARD(value > 60)
                    case 5:
                        x[0][:] = x[rng.integers(1, 3)][:] = value * 0.5
                    case _:
                        x[rng.integers(3)][:] = sh.clamp(value, -3, 3) if rng.integers(2) else value * 0.5

        x, n = [sh.Attrib1f(a), sh.Attrib1f(b), sh.Attrib1f(1)], sh.Attrib1f(0)
        with SH_DO():
            n += 1
            x[rng.integers(3)][:] = sh.clamp(some(x) + some(x), -2, 2)
            update(x, n)
            if rng.integers(3) == 0:
                with SH_FOR(3):
                    update(x, n)
            limit = float(rng.integers(1, 5))
            SH_UNTIL(lambda: (some(x) > limit) | (some(x) < -1) | (n >= MOST))
        return sh.Attrib3f(x[0], x[1], x[2])

    return orbit


def random_program(seed):
    orbit = random_orbit(seed)

    @sh.program
    def program(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib3f:
        return orbit(a, b)

    return program


def random_inputs(seed, *shape):
    rng = np.random.default_rng(1000 + seed)
    inputs = [rng.normal(0, 1.5, shape).astype(np.float32) for _ in range(2)]
    inputs[0].flat[:4] = 0, -0.0, np.inf, np.nan
    return inputs


@pytest.mark.sampled(20)
@pytest.mark.parametrize("seed", range(200))
def test_random_loops_have_the_bits_of_numpy(seed):
    inputs = random_inputs(seed, 333)
    program = random_program(seed)
    expected = program.compile("numpy")(*inputs)
    for lanes in (4, 16):
        assert program.compile("opencl", lanes=lanes)(*inputs).tobytes() == expected.tobytes()
    # GLSL has no pass of this kind, but drivers optimize such loops, too: with a second end, at the limit, or without.
    result = program.compile("glsl", loop_limit=(None, 1000)[seed % 2])(*inputs)
    same(*(np.where(np.abs(a) < np.finfo(np.float32).tiny, np.float32(0), a) for a in (result, expected)))


@pytest.mark.sampled(10)
@pytest.mark.parametrize("seed", range(60))
def test_random_loops_in_lines_have_the_bits_of_numpy(seed, monkeypatch):
    monkeypatch.setattr(packets, "_stay_together", lambda module: True)
    orbit, by_line = random_orbit(seed), seed % 2 == 0

    @sh.program
    def program(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib3f:
        row, column = sh.grid_index(2)
        # An orbit that starts from the line alone is one of scalars.
        return orbit(row * 0.25 - 1, row * 0.125) * a if by_line else orbit(a + row * 0.25, b * column)

    inputs = random_inputs(seed, 9, 37)
    expected = program.compile("numpy")(*inputs)
    for lanes in (4, 16):
        assert program.compile("opencl", lanes=lanes)(*inputs).tobytes() == expected.tobytes()


@pytest.mark.sampled(20)
@pytest.mark.parametrize("seed", range(60))
def test_derivatives_of_random_loops_have_the_bits_of_numpy(seed):
    orbit = random_orbit(seed, discards=False)

    def total(a, b):
        return sh.dot(orbit(a, b), sh.vec3(1, 0.5, 0.25))

    @sh.program
    def program(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib4f:
        value, slopes = sh.gradient(total, wrt=(0, 1), value=True)(a, b)
        _, along = sh.jvp(total, [a, b], [1.0, b])
        return sh.Attrib4f(value, *slopes, along)

    inputs = random_inputs(seed, 131)
    same(program.compile("opencl")(*inputs), program.compile("numpy")(*inputs))


@pytest.mark.sampled(20)
@pytest.mark.parametrize("seed", range(60))
def test_trees_of_random_loops_have_the_bits_of_numpy(seed):
    orbit = random_orbit(seed, discards=False)

    @sh.program
    def program(a: sh.Attrib2f, b: sh.Attrib2f) -> sh.Attrib2f:
        return orbit(a.x + b.y, b.x).xy

    elements = np.stack(random_inputs(seed, 700), -1)
    results = []
    for backend in ("opencl", "numpy"):
        stream = sh.Stream(elements, sh.Attrib2f, backend)
        results.append((np.asarray(sh.reduce(program, stream)), sh.scan(program, stream).numpy()))
    for one, other in zip(*results, strict=True):
        same(one, other)


def newton(a, b):
    x, n = sh.Attrib1f(a), sh.Attrib1f(0)
    with SH_DO():
        x -= cubic(x) / (3 * x * x - 2)
        n += 1
        SH_UNTIL(lambda: (sh.abs(cubic(x)) < 1e-3) | (n >= MOST))
    return x + b


@sh.program
def roots(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return newton(2 + sh.fract(a), b * 0.5)


def test_a_tree_shares_values(monkeypatch):
    shares = []

    def noted(module):
        result = keep_for_next(module)
        shares.append(result != module)
        return result

    monkeypatch.setattr(packets, "keep_for_next", noted)
    streams = [sh.Stream(np.linspace(2, 3, 500), sh.Attrib1f, backend) for backend in ("opencl", "numpy")]
    same(*(np.append(sh.scan(roots, stream).numpy(), sh.reduce(roots, stream)) for stream in streams))
    assert any(shares)


def test_random_loops_share_values():
    """Otherwise the test above would say nothing."""
    counts = [len(operations) for seed in range(60) for operations in shared_operations(random_program(seed))]
    assert sum(count > 0 for count in counts) >= 10


def test_a_module_without_shared_values_stays_as_it_is():
    @sh.program
    def plain(a: sh.Attrib1f) -> sh.Attrib1f:
        x = sh.Attrib1f(a)
        with SH_FOR(5):
            x[:] = x * x + a
        return x

    module = optimise(plain.ir)
    assert keep_for_next(module) == module
    assert commoning._TIED >= {"any_lane", "table"}
