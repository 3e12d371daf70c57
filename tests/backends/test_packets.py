"""OpenCL packets: the same bits as one element a work item, for every width, size, shape and way through a program."""

import re
from typing import Any

import numpy as np
import pytest
from passes.random_ir import LOOP_LIMIT, random_module

import shpy as sh
from shpy import SH_BREAK, SH_CONTINUE, SH_DISCARD, SH_ELSE, SH_FOR, SH_IF, SH_RETURN, SH_WHILE
from shpy.backend.base import Array, Call, Options
from shpy.backend.opencl.device import building as runtime
from shpy.backend.opencl.device.building import backend
from shpy.backend.opencl.device.driver import machine_of
from shpy.backend.opencl.packets.widen import WIDTHS
from shpy.ir.builder import Builder
from shpy.ir.constants import DTYPES
from shpy.ir.nodes import Module, Port
from shpy.ir.tabledata import TableData
from shpy.ir.types import Base, vec

SIZES = (1, 7, 16, 33, 1000)
each_width = pytest.mark.parametrize("lanes", WIDTHS)


def same(found: Any, expected: Any, what: object = "") -> None:
    """Equal bits, but for those of NaNs."""
    found, expected = np.asarray(found), np.asarray(expected)
    assert (found.dtype, found.shape) == (expected.dtype, expected.shape)
    equal = found == expected
    if found.dtype.kind == "f":
        equal = equal & (np.signbit(found) == np.signbit(expected)) | np.isnan(found) & np.isnan(expected)
    assert equal.all(), (what, np.argwhere(~equal)[:5], found[~equal][:5], expected[~equal][:5])


def both(program: sh.Program, lanes: int, *arrays: Any, **options: Any) -> tuple[Any, Any]:
    """Return the results of packets, and those of single elements."""
    shape = options.pop("shape", None)
    results = [program.compile("opencl", lanes=n, **options).run(*arrays, shape=shape) for n in (lanes, 1)]
    assert np.array_equal(results[0].written, results[1].written)
    return results[0].outputs, results[1].outputs


def test_lanes_are_as_many_as_a_cpu_holds_or_as_asked_for() -> None:
    x = np.arange(5, dtype=np.float32)

    @sh.program
    def twice(x: sh.Attrib1f) -> sh.Attrib1f:
        return 2 * x

    machine = machine_of(None)
    assert machine.lanes in (1, *WIDTHS)
    is_cpu = bool(machine.device.type & machine.cl.device_type.CPU)
    assert ("sh_packet" in twice.compile("opencl").source) == (machine.lanes > 1)
    assert machine.lanes == 1 or is_cpu
    for lanes in WIDTHS:
        assert f"float{lanes} " in twice.compile("opencl", lanes=lanes).source
        assert np.array_equal(twice.compile("opencl", lanes=lanes)(x), 2 * x)
    with pytest.raises(sh.ShpyTypeError, match="lanes=3"):
        twice.compile("opencl", lanes=3)
    for backend_name in ("numpy", "glsl"):
        with pytest.raises(sh.CompileError, match=r"test_packets.py:\d+: lanes=16 is for OpenCL"):
            twice.compile(backend_name, lanes=16)


def test_what_no_packet_can_run_is_run_one_element_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: Any, **options: Any) -> Any:
        raise sh.CompileError("nested too deeply")

    monkeypatch.setattr(runtime, "print_packets", refuse)
    monkeypatch.setattr(machine_of(None).__class__, "lanes", 16)
    b = Builder("triple")
    x = b.input(vec("f"), "x")
    b.store(b.output(vec("f"), "y"), b.let("mul", x, b.const(vec("f"), [3])))
    module = Module("triple", (Port("x", ""),), (Port("y", ""),), (), (), (b.finish(),))
    with pytest.warns(sh.ShpyWarning, match="triple is slower on OpenCL, one element at a time, not 16: nested too"):
        executable = backend.compile(module, Options())
    assert executable.notes[-1] == "one element at a time, not 16: nested too deeply"
    assert executable.kernel.lanes == 1
    with pytest.raises(sh.CompileError, match="nested too deeply"):
        backend.compile(module, Options(lanes=16))


# Programs of every form


@sh.program
def escape(c: sh.Attrib2f) -> sh.Attrib1f:
    z = sh.Attrib2f(0, 0)
    n = sh.Attrib1f(0)
    with SH_FOR(0, 50):
        SH_BREAK(sh.dot(z, z) > 4)
        z[:] = sh.Attrib2f(z.x * z.x - z.y * z.y, 2 * z.x * z.y) + c
        n += 1
    return n


def plane(*shape: int) -> Array:
    """Points of the complex plane."""
    rng = np.random.default_rng(1)
    return rng.uniform(-2, 1, (*shape, 2)).astype(np.float32)


@pytest.mark.sampled(2)
@each_width
@pytest.mark.parametrize("size", SIZES)
def test_every_size(lanes: int, size: int) -> None:
    same(*both(escape, lanes, plane(size)))


@each_width
@pytest.mark.parametrize("shape", [(), (1, 1), (3, 5), (5, 32), (33, 37), (4, 40), (2, 3, 33), (2, 40, 41), (1, 64)])
def test_every_shape(lanes: int, shape: tuple[int, ...]) -> None:
    same(*both(escape, lanes, plane(*shape)))


@pytest.mark.sampled(2)
@each_width
def test_nothing_beside_the_outputs_is_written(lanes: int) -> None:
    b = Builder("doubled")
    x = b.input(vec("f", 3), "x")
    b.store(b.output(vec("f", 3), "y"), b.let("add", x, x))
    module = Module("doubled", (Port("x", ""),), (Port("y", ""),), (), (), (b.finish(),))
    executable = backend.compile(module, Options(lanes=lanes))
    for shape in ((5,), (35, 37)):
        count = int(np.prod(shape))
        memory = np.full((count + 64, 3), -1, np.float32)
        given = np.arange(3 * count, dtype=np.float32).reshape(count, 3)
        assert executable.run(Call(shape, (given,), (memory[:count],), {}, {})) is None
        assert np.array_equal(memory[:count], 2 * given)
        assert np.all(memory[count:] == -1)


@sh.program
def forms(x: sh.Attrib1f, k: sh.Attrib1i) -> tuple[sh.Attrib1f, sh.Attrib3i, sh.Attrib1b]:
    total = sh.Attrib1f(0)
    seen = sh.Attrib3i(0)
    n = sh.Attrib1i(0)
    with SH_WHILE(lambda: n < k):
        n += 1
        with SH_IF(x < 0):
            total -= x * sh.Attrib1f(n)
            SH_CONTINUE(n > 3)
        with SH_ELSE():
            with SH_FOR(0, n) as i:
                SH_BREAK(sh.Attrib1f(i) > x)
                total += 1
                seen.y += i
        seen.x += n
    with SH_IF((x > 3) & (k > 4)):
        SH_DISCARD()
    seen.z = n
    return total, seen, total > x


@pytest.mark.sampled(3)
@each_width
def test_loops_branches_and_exits_that_differ(lanes: int) -> None:
    rng = np.random.default_rng(3)
    x, k = rng.normal(0, 3, 1000).astype(np.float32), rng.integers(0, 9, 1000).astype(np.int32)
    for found, expected in zip(*both(forms, lanes, x, k), strict=True):
        same(found, expected)


@pytest.mark.sampled(3)
@each_width
def test_a_loop_that_runs_out_of_iterations_names_its_elements(lanes: int) -> None:
    @sh.program
    def count(k: sh.Attrib1i) -> sh.Attrib1i:
        n = sh.Attrib1i(0)
        with SH_WHILE(lambda: n < k):
            n += 1
        return n

    k = np.arange(40, dtype=np.int32)
    with pytest.raises(sh.LoopLimitExceeded) as error:
        count.compile("opencl", lanes=lanes, loop_limit=30)(k)
    assert error.value.count == 9
    assert np.array_equal(error.value.result.written, k <= 30)
    assert np.array_equal(error.value.result.outputs[:31], k[:31])


@pytest.mark.sampled(3)
@each_width
def test_inputs_that_are_the_same_for_all(lanes: int) -> None:
    @sh.program
    def add(a: sh.Attrib3f, b: sh.Attrib3f, flag: sh.Attrib1b) -> sh.Attrib3f:
        return sh.cond(flag, a + b, a)

    rng = np.random.default_rng(0)
    same(*both(add, lanes, rng.normal(size=(37, 3)).astype(np.float32), [1.0, 2.0, 3.0], True))
    same(*both(add, lanes, rng.normal(size=(37, 3)).astype(np.float32), [1.0, 2.0, 3.0], rng.random(37) < 0.5))


@pytest.mark.sampled(3)
@each_width
def test_memory_of_every_type(lanes: int) -> None:
    check_memory(lanes, "fdiub")


def check_memory(lanes: int, kinds: str) -> None:
    """Vectors of these types and of every size are read, reversed and written by one kernel."""
    b = Builder("turn")
    types = [vec(kind, size) for kind in kinds for size in (1, 2, 3, 4)]
    for type_ in types:
        x = b.input(type_)
        b.store(b.output(type_), x if type_.size == 1 else b.swizzle(x, tuple(range(type_.size))[::-1]))
    ports = tuple(Port(f"p{k}", "") for k in range(len(types)))
    executable = backend.compile(Module("turn", ports, ports, (), (), (b.finish(),)), Options(lanes=lanes))
    rng = np.random.default_rng(0)
    for shape in ((23,), (9, 36)):
        count = int(np.prod(shape))
        given = [
            rng.integers(0, 2 if t.base is Base.B else 100, (count, t.size)[: min(t.size, 2)]).astype(DTYPES[t.base])
            for t in types
        ]
        out = [np.zeros_like(a) for a in given]
        assert executable.run(Call(shape, tuple(given), tuple(out), {}, {})) is None
        for found, a in zip(out, given, strict=True):
            same(found, a if a.ndim == 1 else a[:, ::-1], shape)


# Grids, tables, arrays


@pytest.mark.sampled(6)
@each_width
@pytest.mark.parametrize("shape", [(50,), (5, 7), (33, 40), (3, 5, 35), (2, 3, 4, 5)])
def test_each_lane_knows_its_place(lanes: int, shape: tuple[int, ...]) -> None:
    rank = len(shape)
    kind = {1: sh.Attrib1i, 2: sh.Attrib2i, 3: sh.Attrib3i, 4: sh.Attrib4i}[rank]

    def place() -> Any:
        return sh.grid_index(rank) + 100 * sh.grid_shape(rank)

    place.__annotations__["return"] = kind
    found = sh.program(place).compile("opencl", lanes=lanes)(shape=shape)
    index = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1)
    expected = index + 100 * np.array(shape)
    same(found, (expected[..., 0] if rank == 1 else expected).astype(np.int32))


@pytest.mark.sampled(12)
@pytest.mark.parametrize("kind", ["f", "i", "u", "b"])
@each_width
def test_tables_are_read_at_places_that_differ(lanes: int, kind: str) -> None:
    """Elements of every size, at an index for each lane and at one for all, out of range too."""
    rng = np.random.default_rng(5)
    shapes = [(5,), (4, 5), (3, 4, 5)]
    data: list[list[Array]] = []
    tables: list[list[sh.Table]] = []
    types = [getattr(sh, f"Attrib{size}{kind}") for size in (1, 2, 3, 4)]
    for type_ in types:
        rows = [s if type_.size == 1 else (*s, type_.size) for s in shapes]
        data.append([rng.integers(0, 2 if kind == "b" else 100, s).astype(DTYPES[Base(kind)]) for s in rows])
        tables.append([sh.Table(a.copy(), type_) for a in data[-1]])

    def reads(i: Any) -> Any:
        found: list[Any] = []
        for line, sheet, block in tables:
            found += [line[i], sheet[i, i + 1], block[i, 2 * i, i - 1], line[2], sheet[1, 1]]
        return tuple(found)

    reads.__annotations__ = {"i": sh.Attrib1i, "return": tuple[tuple(t for t in types for _ in range(5))]}
    i = rng.integers(-3, 9, 50).astype(np.int32)
    found = iter(sh.program(reads).compile("opencl", lanes=lanes)(i))
    at = lambda k, n: np.clip(k, 0, n - 1)  # noqa: E731
    for line, sheet, block in data:
        same(next(found), line[at(i, 5)])
        same(next(found), sheet[at(i, 4), at(i + 1, 5)])
        same(next(found), block[at(i, 3), at(2 * i, 4), at(i - 1, 5)])
        for element in (line[2], sheet[1, 1]):
            same(next(found), np.broadcast_to(element, (50, *element.shape)))


@pytest.mark.sampled(12)
@pytest.mark.parametrize("kind", [sh.Attrib1f, sh.Attrib2i, sh.Attrib1b, sh.Attrib1d])
@each_width
def test_arrays_of_a_lane_of_its_own(lanes: int, kind: Any) -> None:
    """Stores and loads at places that differ, in branches, in and out of range, and at one for all; short and long."""
    lengths = (3, 8, 9, 20)

    def program(k: Any, x: Any) -> Any:
        found: list[Any] = []
        for length in lengths:
            a = sh.Array(kind, length)
            with SH_FOR(0, 4) as i:
                a[k + i] = x
                with SH_IF(k > 2):
                    a[2 * k - i] = a[k]
            a[1] = a[sh.cond(k > 1, k, 0)]
            found += [a[k], a[2], a[k - 5], a[length - 1]]
        return tuple(found)

    program.__annotations__ = {"k": sh.Attrib1i, "x": kind, "return": tuple[(kind,) * 4 * len(lengths)]}
    rng = np.random.default_rng(6)
    k = rng.integers(-4, 24, 100).astype(np.int32)
    shape = (100, kind.size) if kind.size > 1 else (100,)
    x = rng.integers(0, 2 if kind.base is Base.B else 50, shape).astype(DTYPES[kind.base])
    for n, (found, expected) in enumerate(zip(*both(sh.program(program), lanes, k, x), strict=True)):
        same(found, expected, n)


@pytest.mark.sampled(3)
@each_width
def test_an_array_that_is_the_same_for_all_is_read_at_places_that_differ(lanes: int) -> None:
    @sh.program
    def program(k: sh.Attrib1i) -> tuple[sh.Attrib1f, sh.Attrib1b, sh.Attrib1f]:
        short, long = sh.Array(sh.Attrib1f, 4), sh.Array(sh.Attrib1f, 30)
        flags = sh.Array(sh.Attrib1b, 30)
        with SH_FOR(0, 30) as i:
            short[i] = 0.5 * sh.Attrib1f(i)
            long[i] = 0.5 * sh.Attrib1f(i)
            flags[i] = i % 3 == 0
        return long[k], flags[k], short[k]

    k = np.arange(-5, 35, dtype=np.int32)
    at = np.clip(k, 0, 29)
    found = program.compile("opencl", lanes=lanes)(k)
    same(found[0], (0.5 * at).astype(np.float32))
    same(found[1], at % 3 == 0)
    same(found[2], (0.5 * np.clip(k, 0, 3)).astype(np.float32))


# Lanes


@pytest.mark.sampled(4)
@each_width
@pytest.mark.parametrize("shape", [(1,), (5,), (16,), (21,), (5, 7), (3, 21)])
def test_a_lane_that_holds_no_element_is_never_asked(lanes: int, shape: tuple[int, ...]) -> None:
    """A lane without an element has the data of its packet's first one, and a place beyond the end of its row."""

    @sh.program
    def ask(x: sh.Attrib1f) -> tuple[sh.Attrib1b, sh.Attrib1b, sh.Attrib1b, sh.Attrib1b]:
        ends = sh.grid_shape(len(shape))
        place = sh.grid_index(len(shape))
        beyond = sh.any(place >= ends)
        return sh.any_lane(x == 0), sh.all_lanes(x != 0), sh.any_lane(beyond), sh.all_lanes(~beyond)

    none, every, other, inside = ask.compile("opencl", lanes=lanes)(np.arange(1, np.prod(shape) + 1).reshape(shape))
    assert not none.any()
    assert every.all()
    assert not other.any()
    assert inside.all()


@pytest.mark.sampled(3)
@each_width
def test_only_active_lanes_are_asked(lanes: int) -> None:
    @sh.program
    def ask(x: sh.Attrib1f) -> tuple[sh.Attrib1b, sh.Attrib1b]:
        some, every = sh.Attrib1b(False), sh.Attrib1b(False)
        with SH_IF(x < 2):
            some[:] = sh.any_lane(x >= 2)
            every[:] = sh.all_lanes(x < 2)
        return some, every

    x = np.arange(64, dtype=np.float32) % 4
    some, every = ask.compile("opencl", lanes=lanes)(x)
    assert not some.any()
    assert np.array_equal(every, x < 2)


# Programs at random


@pytest.mark.sampled(12)
@pytest.mark.parametrize("seed", range(24))
def test_random_programs(seed: int) -> None:
    lanes, count = WIDTHS[seed % 3], SIZES[seed % 4]
    module = random_module(seed)
    rng = np.random.default_rng(seed)
    inputs = (
        rng.normal(0, 2, 1 if seed % 5 == 0 else count).astype(np.float32),
        rng.normal(0, 2, (1 if seed % 7 == 0 else count, 3)).astype(np.float32),
        rng.integers(-3, 4, count).astype(np.int32),
        rng.integers(0, 2**32, count).astype(np.uint32),
    )
    tables = {
        "data": TableData(np.arange(5, dtype=np.float32)),
        "grid": TableData(np.arange(12, dtype=np.float32).reshape(2, 3, 2)),
    }
    results = []
    for width in (lanes, 1):
        executable = backend.compile(module, Options(loop_limit=LOOP_LIMIT, lanes=width))
        outputs = (np.zeros(count, np.float32), np.zeros((count, 3), np.float32), np.zeros(count, np.int32))
        status = executable.run(Call((count,), inputs, outputs, {"scale": np.float32(1.5)}, tables))
        ended = np.ones(count, np.int32) if status is None else status
        # Loops of subroutines that were inlined are counted once for each call: their lines tell which is which.
        results.append(([str(executable.loops[k - 2]) if k > 1 else k for k in ended], *outputs))
    assert results[0][0] == results[1][0]
    for found, expected in zip(results[0][1:], results[1][1:], strict=True):
        same(found, expected)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("few", [True, False])
def test_a_large_kernel_calls_a_function_whose_code_is_generated_once(few: bool) -> None:
    @sh.program
    def steps(a: sh.Attrib2f, b: sh.Attrib1f) -> tuple[sh.Attrib2f, sh.Attrib1i]:
        x, n = sh.Attrib2f(a), sh.Attrib1i(0)
        for k in range(2 if few else 60):
            with SH_IF(x.x * x.y > b + k):
                x *= 0.75 - 0.5 * b
                n += 1
            x.x += 0.5 * x.y - b * k
        return x, n

    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(37, 2)).astype(np.float32), rng.normal(size=37).astype(np.float32)
    packets, single = (steps.compile("opencl", lanes=lanes) for lanes in (8, 1))
    assert ("noinline)) void steps_packet(" not in packets.source) == few
    for found, expected in zip(packets(a, b), single(a, b), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.sampled(3)
@each_width
def test_subroutines_are_functions_of_packets(lanes: int) -> None:
    @sh.subroutine
    def advance(z: sh.Attrib2f, c: sh.Attrib2f, n: sh.Attrib1i) -> sh.Attrib1b:
        z[:] = sh.Attrib2f(z.x * z.x - z.y * z.y, 2 * z.x * z.y) + c
        SH_RETURN(sh.Attrib1b(False), sh.dot(z, z) > 4)
        n += 1
        return sh.Attrib1b(True)

    @sh.subroutine
    def tone(n: sh.Attrib1i, most: sh.Attrib1i) -> sh.Color3f:
        r = sh.Color3f(0.0)
        with SH_FOR(most) as k:
            SH_RETURN(r, k > n)
            SH_DISCARD(n == 3)
            r += 0.1
        return r

    most = sh.Param(sh.Attrib1i, 12, name="most")

    @sh.program
    def picture(c: sh.Attrib2f) -> tuple[sh.Color3f, sh.Color3f, sh.Color3f]:
        z, n, go = sh.Attrib2f(0, 0), sh.Attrib1i(0), sh.Attrib1b(True)
        with SH_WHILE(lambda: go & (n < most)):
            go[:] = advance(z, c, n)
        return tone(n, most), tone(most, n), tone(most, most)

    c = np.random.default_rng(1).uniform(-2, 1, (1000, 2)).astype(np.float32)
    found, expected = both(picture, lanes, c)
    for f, e in zip(found, expected, strict=True):
        same(f, e)
    numpy = picture.compile("numpy")
    for f, e in zip(numpy(c), expected, strict=True):
        same(f, e)
    source = picture.compile("opencl", lanes=lanes).source
    heads = re.findall(r"void (tone\w*)\(\s*(?:// \S+)?\s*(\w+) n,\s*(\w+) most", source)
    wide = f"int{lanes}"
    assert heads == [("tone", wide, "int"), ("tone_2", "int", wide), ("tone_3", "int", "int")]
    assert all(f"\ndef {name}(" in numpy.source for name in ("advance", "tone", "tone_2", "tone_3", "picture"))


@pytest.mark.sampled(3)
@each_width
def test_the_status_is_known_behind_a_loop_when_every_way_ends_in_a_call(lanes: int) -> None:
    @sh.subroutine
    def bounded(p: sh.Attrib1f) -> sh.Attrib1f:
        SH_RETURN(sh.Attrib1f(0.0), p > 0.5)
        SH_DISCARD(p < -2)
        p += 1
        return sh.Attrib1f(0.0)

    @sh.program
    def ends_in_a_call(a: sh.Attrib1f, limit: sh.Attrib1f) -> sh.Attrib1f:
        count = sh.Attrib1i(0)
        with SH_WHILE(lambda: (count < 1) & (a < limit)):
            count += 1
            a[:] = bounded(a)
        bounded(a)
        return a

    a, limit = np.float32([1.5, 0.2, -1, -3, 4] * 9), np.float32([2, 0, 0, 0, 9] * 9)
    found, expected = both(ends_in_a_call, lanes, a, limit)
    same(found, expected)
    result = ends_in_a_call.compile("numpy").run(a, limit)
    same(result.outputs, expected)
    assert result.written.tolist() == [True, True, True, False, True] * 9
