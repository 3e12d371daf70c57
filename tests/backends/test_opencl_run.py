"""The OpenCL runtime: what goes to the device and comes back, memory, errors."""

import ast
import gc
import os
import re
import subprocess
import sys
import threading
import warnings
import weakref
from typing import Any

import numpy as np
import pytest

import shpy as sh
from shpy import SH_DISCARD, SH_DO, SH_FOR, SH_IF, SH_UNTIL, SH_WHILE
from shpy.backend.base import Call, Options
from shpy.backend.opencl.device import building as runtime, driver as device
from shpy.backend.opencl.device.building import backend
from shpy.backend.opencl.device.driver import machine_of
from shpy.backend.opencl.device.memory import tables_of
from shpy.backend.opencl.text.kernel import KernelText
from shpy.ir.builder import Builder
from shpy.ir.nodes import Function, Loc, Module, Param, Port, Table
from shpy.ir.tabledata import TableData
from shpy.ir.types import vec

F, INT = vec("f"), vec("i")


def module(function: Function, params: tuple[Param, ...] = (), tables: tuple[Table, ...] = ()) -> Module:
    inputs = tuple(Port(i.name or f"i{k}", "") for k, i in enumerate(function.inputs))
    outputs = tuple(Port(o.name or f"o{k}", "") for k, o in enumerate(function.outputs))
    return Module("test", inputs, outputs, params, tables, (function,))


def doubled() -> Module:
    b = Builder("doubled")
    x = b.input(F, "x")
    b.store(b.output(F, "y"), b.let("add", x, x))
    return module(b.finish())


@pytest.mark.sampled(2)
@pytest.mark.parametrize("count", [1, 2, 63, 64, 65, 1000, 4096 + 17])
def test_every_element_and_none_besides_is_written(count: int) -> None:
    x = np.arange(count, dtype=np.float32)
    memory = np.full(count + 64, -1, np.float32)
    executable = backend.compile(doubled(), Options())
    assert executable.run(Call((count,), (x,), (memory[:count],), {}, {})) is None
    assert np.array_equal(memory[:count], 2 * x)
    assert np.all(memory[count:] == -1)


def test_a_uniform_input_is_the_same_for_all() -> None:
    @sh.program
    def add(a: sh.Attrib3f, b: sh.Attrib3f, flag: sh.Attrib1b) -> sh.Attrib3f:
        return sh.cond(flag, a + b, a)

    a = np.random.default_rng(0).random((7, 5, 3), np.float32)
    one = np.array([1, 2, 3], np.float32)
    compiled = add.compile("opencl")
    assert np.array_equal(compiled(a, one, True), a + one)
    assert np.array_equal(compiled(a, one, np.arange(5) > 2), np.where((np.arange(5) > 2)[:, None], a + one, a))
    assert np.array_equal(compiled(one, a[0, 0], False), one)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("size", [1, 2, 3, 4])
def test_bools_in_and_out(size: int) -> None:
    b = Builder("invert")
    t = vec("b", size)
    x = b.input(t, "x")
    b.store(b.output(t, "y"), b.let("not", x))
    data = np.random.default_rng(size).random((100, size)[: min(size, 2)]) > 0.5
    out = np.zeros_like(data)
    backend.compile(module(b.finish()), Options()).run(Call((100,), (data,), (out,), {}, {}))
    assert np.array_equal(out, ~data)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("precision", ["f16", "f32", "f64"])
def test_precisions(precision: Any) -> None:
    scale = sh.Param(sh.Attrib1f, 0.375, name="scale")
    table = sh.Table(np.array([1.1, 2.2], np.float32), sh.Attrib1f, name="table")

    @sh.program
    def third(x: sh.Attrib3f) -> sh.Attrib3f:
        return x / 3 + table[sh.Attrib1i(x.x)] * scale

    dtype = {"f16": np.float16, "f32": np.float32, "f64": np.float64}[precision]
    x = np.random.default_rng(1).random((50, 3)).astype(dtype)
    found = third.compile("opencl", precision=precision)(x)
    assert found.dtype == dtype
    expected = x / dtype(3) + dtype(np.float32(1.1)) * dtype(0.375)
    assert np.array_equal(found, expected)


def test_a_table_is_uploaded_once_and_again_when_it_has_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    b = Builder("read")
    i = b.input(INT, "i")
    b.store(b.output(F, "y"), b.let("table", i, type=F, attr="data"))
    executable = backend.compile(module(b.finish(), tables=(Table("data", F, 1),)), Options())
    data = TableData(np.array([1, 2, 3], np.float32))
    at = np.array([-5, 0, 1, 2, 9], np.int32)
    out = np.zeros(5, np.float32)
    call = Call((5,), (at,), (out,), {}, {"data": data})
    machine = machine_of(None)
    uploads = []
    contiguous = np.ascontiguousarray
    monkeypatch.setattr(device.np, "ascontiguousarray", lambda *a, **k: uploads.append(1) or contiguous(*a, **k))
    for _ in range(3):
        executable.run(call)
    before = len(uploads)
    executable.run(call)
    per_run = len(uploads) - before
    assert out.tolist() == [1, 1, 2, 3, 3]
    data.array = np.array([4, 5, 6], np.float32)
    data.version += 1
    executable.run(call)
    assert out.tolist() == [4, 4, 5, 6, 6]
    assert len(uploads) == before + 2 * per_run + 1
    gone = weakref.ref(data)
    del data, call
    gc.collect()
    assert gone() is None
    assert all(t is not None for t in list(tables_of(machine)._copies))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("shape", [(4,), (2, 3), (2, 3, 4), (2, 3, 4, 5)])
def test_grid_index_runs_along_the_last_axis_first(shape: tuple[int, ...]) -> None:
    rank = len(shape)
    t = vec("i", rank)
    b = Builder("grid")
    b.store(b.output(t, "at"), b.let("grid_index", type=t))
    b.store(b.output(t, "size"), b.let("grid_shape", type=t))
    executable = backend.compile(module(b.finish()), Options())
    n = int(np.prod(shape))
    at, size = (np.zeros((n, rank)[: min(rank, 2)], np.int32) for _ in range(2))
    executable.run(Call(shape, (), (at, size), {}, {}))
    assert np.array_equal(at.reshape(n, rank), np.array(list(np.ndindex(shape))))
    assert np.array_equal(size.reshape(n, rank), np.broadcast_to(shape, (n, rank)))


def test_discarded_elements_keep_what_was_there() -> None:
    @sh.program
    def root(x: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib2i]:
        SH_DISCARD(x < 0)
        return sh.sqrt(x), sh.Attrib2i(1, 2)

    x = np.array([4, -1, 9], np.float32)
    out = (np.full(3, 7, np.float32), np.full((3, 2), 8, np.int32))
    result = root.compile("opencl").run(x, out=out)
    assert result.written.tolist() == [True, False, True]
    assert out[0].tolist() == [2, 7, 3]
    assert out[1].tolist() == [[1, 2], [8, 8], [1, 2]]


def test_a_loop_without_an_end_is_stopped_and_named() -> None:
    @sh.program
    def count(x: sh.Attrib1f) -> sh.Attrib1f:
        with SH_WHILE(lambda: x > 0):
            x += 1
        return x

    with pytest.raises(sh.LoopLimitExceeded, match=r"test_opencl_run\.py:\d+") as error:
        count.compile("opencl", loop_limit=100)(np.array([1, -1, 2], np.float32))
    assert error.value.count == 2
    assert error.value.result.written.tolist() == [False, True, False]


def test_loops_that_a_device_could_unroll_wrongly() -> None:
    @sh.program
    def counted(n: sh.Attrib1i, x: sh.Attrib1i) -> sh.Attrib1i:
        total = sh.Attrib1i(0)
        with SH_FOR(0, n) as i:
            start = sh.Attrib1i(x)
            with SH_DO():
                start += 1
                SH_UNTIL(start > i)
            with SH_IF(i % 2 == 1):
                total += start
        return total

    def expected(n: int, x: int) -> int:
        return sum(max(i, x) + 1 for i in range(n) if i % 2 == 1)

    n, x = np.meshgrid(np.arange(6, dtype=np.int32), np.arange(-2, 5, dtype=np.int32))
    found = counted.compile("opencl")(n, x)
    assert found.tolist() == np.vectorize(expected)(n, x).tolist()


def test_a_refused_text_names_the_line_of_the_user(monkeypatch: pytest.MonkeyPatch) -> None:
    b = Builder("wrong", loc=Loc("/home/someone/code.py", 10))
    x = b.input(F, "x")
    y = b.output(F, "y")
    b.loc = Loc("/home/someone/code.py", 12)
    b.store(y, b.let("sqrt", b.let("add", x, x)))
    printed = runtime.print_kernel

    def broken(prepared: Module, math: Any, **abilities: bool) -> Any:
        kernel = printed(prepared, math, **abilities)
        return KernelText(
            **{
                **{f: getattr(kernel, f) for f in kernel.__dataclass_fields__},
                "text": kernel.text.replace("sqrt(", "no_such_function("),
            }
        )

    monkeypatch.setattr(runtime, "print_kernel", broken)
    with pytest.raises(sh.CompileError, match="no_such_function") as error:
        backend.compile(module(b.finish()), Options(lanes=1))
    assert error.value.loc == Loc("/home/someone/code.py", 12)


def test_without_pyopencl_the_cure_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyopencl", None)
    device._listed.forget()
    with pytest.raises(sh.BackendUnavailable, match=re.escape(sh.packages.install("pyopencl"))):
        backend.devices()


def test_without_a_driver_the_cure_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    import pyopencl

    def none() -> None:
        raise pyopencl.LogicError("clGetPlatformIDs failed: PLATFORM_NOT_FOUND_KHR")

    monkeypatch.setattr(pyopencl, "get_platforms", none)
    device._listed.forget()
    with pytest.raises(sh.BackendUnavailable, match="apt install pocl-opencl-icd"):
        backend.devices()
    device._listed.forget()


_CORES_OF_THREADS = """
import os
import shpy as sh
CONFINE
[d for b in sh.backends() for d in b.devices if b.name == "opencl"]
found = []
for thread in os.listdir("/proc/self/task"):
    try:
        found.append(sorted(os.sched_getaffinity(int(thread))))
    except ProcessLookupError:
        pass  # it has ended
print(found)
"""


CORES = set(range(os.cpu_count() or 1))
LAST = max(CORES)


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("told", "confine", "kept"),
    [
        ({}, "", CORES),
        ({"POCL_AFFINITY": "0"}, "", CORES if len(CORES) == 1 else set()),
        ({}, f"os.sched_setaffinity(0, {{{LAST}}})", {LAST}),
    ],
)
def test_threads_of_a_processor_stay_on_cores_of_their_own(told: dict[str, str], confine: str, kept: set[int]) -> None:
    command = [sys.executable, "-c", _CORES_OF_THREADS.replace("CONFINE", confine)]
    environment = {k: v for k, v in os.environ.items() if k != "POCL_AFFINITY"} | told
    found = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    assert {cores[0] for cores in ast.literal_eval(found) if len(cores) == 1} == kept


def test_a_device_that_is_not_there() -> None:
    with pytest.raises(sh.ShpyTypeError, match="no OpenCL device 99"):
        backend.compile(doubled(), Options(device=99))


def test_f64_where_the_device_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine_of(None), "doubles", False)
    with pytest.raises(sh.CompileError, match="no f64"):
        backend.compile(doubled(), Options(precision="f64"))


def test_relaxed_kernels_say_that_their_device_flushes_denormals(monkeypatch):
    monkeypatch.setattr(machine_of(None), "denormals", False)

    @sh.program
    def program(x: sh.Attrib1f) -> sh.Attrib1f:
        return sh.exp2(x)

    said = "in relaxed mode this device flushes denormals to zero"
    assert said in program.compile("opencl", math="relaxed").notes
    assert said in program.compile("opencl", math="relaxed", lanes=1).notes
    assert not any("flushes" in note for note in program.compile("opencl").notes)


def test_vectors_are_hidden_in_packets_where_a_compiler_folds_zeros(monkeypatch):
    monkeypatch.setattr(machine_of(None), "wrong", frozenset({"zeros"}))

    @sh.program
    def program(x: sh.Vector3f) -> sh.Vector3f:
        return sh.log(x)

    points = np.array([[0.5, 2, -1], [0, 1, np.inf], [1e-20, 3, 7]], np.float32)
    found = program.compile("opencl", lanes=8)(points)
    assert np.array_equal(found, program.compile("numpy")(points), equal_nan=True)


def test_a_log_of_the_driver_warns_nobody(monkeypatch):
    machine = machine_of(None)
    build = machine.cl.Program.build

    def noisy(*given: Any, **named: Any) -> Any:
        warnings.warn("the driver's log", machine.cl.CompilerWarning, stacklevel=2)
        return build(*given, **named)

    monkeypatch.setattr(machine.cl.Program, "build", noisy)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert machine._asked() == machine.wrong
        machine.build("kernel void silent(void) {}")


def test_many_threads_share_the_device() -> None:
    executable = backend.compile(doubled(), Options())
    wrong = []

    def work(seed: int) -> None:
        rng = np.random.default_rng(seed)
        for _ in range(20):
            x = rng.random(rng.integers(1, 3000), np.float32)
            out = np.zeros_like(x)
            executable.run(Call(x.shape, (x,), (out,), {}, {}))
            if not np.array_equal(out, x + x):
                wrong.append(seed)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_programs_of_one_text_are_built_once() -> None:
    first, second = backend.compile(doubled(), Options()), backend.compile(doubled(), Options())
    assert first.source == second.source
    assert machine_of(None).build(first.source) is machine_of(None).build(second.source)


@pytest.mark.parametrize("lanes", [1, 16])
def test_large_arrays_are_used_where_they_lie(lanes: int) -> None:
    @sh.program
    def twice(a: sh.Attrib4f, b: sh.Attrib1f) -> sh.Attrib4f:
        return 2 * a + b

    kernel, count = twice.compile("opencl", lanes=lanes), 20_001
    memory = np.zeros(4 * count + 40, np.float32)
    for start in (0, 1, 2, 4, 16):  # aligned to an element or not
        a = memory[start : start + 4 * count].reshape(count, 4)
        a[:] = np.arange(4 * count).reshape(count, 4)
        b = np.arange(count, dtype=np.float32)
        a.flags.writeable = b.flags.writeable = False
        out = np.full(4 * count + 40, -1, np.float32)
        given = out[start : start + 4 * count].reshape(count, 4)
        result = kernel.run(a, b, out=given)
        assert result.outputs is given
        assert np.array_equal(given, 2 * a + b[:, None])
        assert (np.delete(out, np.s_[start : start + 4 * count]) == -1).all()
        assert np.array_equal(kernel(a, b), given)


def test_a_large_output_may_be_the_input() -> None:
    @sh.program
    def mirrored(a: sh.Attrib1f, t: sh.Table[sh.Attrib1f]) -> sh.Attrib1f:
        return a + t[29_999 - sh.grid_index(1)]

    a = np.arange(30_000, dtype=np.float32)
    mirrored.compile("opencl").run(a, a.copy(), out=a)
    assert (a == 29_999).all()


def test_large_outputs_keep_what_discarded_elements_held() -> None:
    @sh.program
    def even(a: sh.Attrib1i) -> sh.Attrib1i:
        SH_DISCARD(a % 2 == 1)
        return -a

    a = np.arange(40_000, dtype=np.int32)
    out = np.full(40_000, 7, np.int32)
    result = even.compile("opencl").run(a, out=out)
    assert result.count == 20_000
    assert np.array_equal(out, np.where(a % 2, 7, -a))


def test_numbers_reach_a_kernel_by_their_bytes() -> None:
    """pyopencl is told once which arguments are buffers; a NaN keeps its bits, and a buffer may be left out."""
    text = """
    __kernel void bits(float x, int2 pair, uint n, __global const uint *more, __global uint *out) {
        if (get_global_id(0) == 0) {
            out[0] = as_uint(x);
            out[1] = pair.x;
            out[2] = pair.y;
            out[3] = more ? more[0] : n;
        }
    }
    """
    space = backend.space(None)
    more, out = (space.allocate(n, vec("u"), np.dtype(np.uint32)) for n in (1, 4))
    more.write(np.array([77], np.uint32))
    for bits, pair, n, there in (
        (0x7FA00001, (1, -2), 2**32 - 1, False),
        (0xFF812345, (-(2**31), 5), 3, True),
        (0x00000001, (0, 0), 9, False),
    ):
        x = np.uint32(bits).view(np.float32)
        args = (x, np.array(pair, np.int32), np.uint32(n), more.buffer if there else None, out.buffer)
        space.enqueue(text, "bits", 1, args)
        expected = np.array([bits, *np.array(pair, np.int32).view(np.uint32), 77 if there else n], np.uint32)
        assert out.read().tolist() == expected.tolist()
