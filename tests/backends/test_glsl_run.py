"""Running on GLSL: layouts and bands, many outputs, status, the device's own limit, threads, errors."""

import os
import sys
import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import shpy as sh
from shpy import (
    SH_DISCARD,
)
from shpy.backend.base import Call, Options
from shpy.backend.glsl import backend
from shpy.backend.glsl.device import run as runtime
from shpy.backend.glsl.device.context import Context
from shpy.backend.glsl.device.run import refused, row_length
from shpy.backend.glsl.text.interface import Shader
from shpy.ir.builder import Builder
from shpy.ir.nodes import Loc, Module, Port
from shpy.ir.types import vec


def glsl(program: Any, **options: Any) -> Any:
    return program.compile("glsl", **options)


@sh.program
def twice(x: sh.Attrib1f) -> sh.Attrib1f:
    return 2 * x


# Layout


@pytest.mark.parametrize(
    "shape", [(), (1,), (7,), (1023,), (1024,), (1025,), (3, 5), (5, 64), (100, 640), (2, 3, 4), (0,), (4, 0)]
)
def test_every_shape_comes_back(shape: tuple[int, ...]) -> None:
    x = np.arange(np.prod(shape, dtype=int), dtype=np.float32).reshape(shape)
    found = glsl(twice)(x)
    assert found.shape == shape
    assert np.array_equal(found, 2 * x)


def test_rows_are_the_last_axis_where_that_is_long_enough() -> None:
    assert row_length((480, 640), 16384) == 640
    assert row_length((480, 20000), 16384) == 1024
    assert row_length((100, 3), 16384) == 300
    assert row_length((10,), 16384) == 10


def test_more_elements_than_a_band_take_several_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime, "BAND", 4096)

    @sh.program
    def where(x: sh.Attrib1f, k: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1i]:
        return x + k, sh.grid_index(1)

    x = np.arange(50_001, dtype=np.float32)
    y, index = glsl(where)(x, np.float32(0.5))
    assert np.array_equal(y, x + np.float32(0.5))
    assert np.array_equal(index, np.arange(50_001))


def test_five_million_elements() -> None:
    x = np.random.default_rng(1).random((5_000_000, 3), dtype=np.float32)

    @sh.program
    def squares(x: sh.Attrib3f) -> sh.Attrib3f:
        return x * x

    assert np.array_equal(glsl(squares)(x), x * x)


def test_grid_index_and_shape_follow_numpys_axes() -> None:
    @sh.program
    def where() -> tuple[sh.Attrib3i, sh.Attrib3i]:
        return sh.grid_index(3), sh.grid_shape(3)

    kernel = glsl(where)
    stream = sh.Stream(np.zeros((2, 4, 6, 3), np.int32), sh.Attrib3i, "glsl")
    # A uniform is sent where it changes: runs over arrays and streams share the kernel's.
    for grid in ((3, 5, 70), (2, 4, 6), (3, 5, 70), (1, 5000, 1)):
        index, shape = kernel(shape=grid)
        assert np.array_equal(np.moveaxis(index, -1, 0), np.indices(grid))
        assert (shape == grid).all()
        streams = kernel.run(out=(stream, sh.Stream(stream.numpy(), sh.Attrib3i, "glsl"))).outputs
        assert np.array_equal(np.moveaxis(streams[0].numpy(), -1, 0), np.indices((2, 4, 6)))
        assert (streams[1].numpy() == (2, 4, 6)).all()


# Types


@pytest.mark.sampled(2)
@pytest.mark.parametrize("size", [1, 2, 3, 4])
@pytest.mark.parametrize("base", "fiub")
def test_every_type_goes_in_and_out_exactly(base: str, size: int) -> None:
    b = Builder("same")
    value = b.input(vec(base, size), "x")
    b.store(b.output(vec(base, size), "y"), value)
    module = Module("same", (Port("x", ""),), (Port("y", ""),), (), (), (b.finish(),))
    rng = np.random.default_rng(2)
    shape = (999,) if size == 1 else (999, size)
    bits = rng.integers(0, 2**32, shape, dtype=np.uint32)
    x = {"f": bits.view(np.float32), "i": bits.view(np.int32), "u": bits, "b": bits % 2 == 0}[base]
    out = np.zeros_like(x)
    assert backend.compile(module, Options()).run(Call((999,), (x,), (out,), {}, {})) is None
    if base == "f":
        normal = np.isfinite(x) & (np.abs(x) > 1.2e-38)
        assert np.array_equal(out[normal], x[normal])
        assert np.array_equal(np.isnan(out), np.isnan(x))
    else:
        assert np.array_equal(out, x)


def test_half_precision_rounds_every_operation() -> None:
    @sh.program
    def poly(x: sh.Attrib1f) -> sh.Attrib1f:
        return (x * x + 0.1) / (x + 3)

    x = np.linspace(-2, 2, 5000).astype(np.float16)
    found = glsl(poly, precision="f16")(x)
    assert found.dtype == np.float16
    assert np.array_equal(found, (x * x + np.float16(0.1)) / (x + np.float16(3)))


def test_doubles_are_refused_with_a_cure() -> None:
    with pytest.raises(sh.CompileError, match=r"GLSL 3.30 has no 64-bit floats") as error:
        glsl(twice, precision="f64")
    assert "numpy" in str(error.value)
    assert "test_glsl_run.py:" in str(error.value)


# Outputs


def test_more_outputs_than_draw_buffers_take_several_programs() -> None:
    @sh.program
    def many(x: sh.Attrib1f) -> tuple[(sh.Attrib1f,) * 11]:  # type: ignore[valid-type]
        return tuple(x + k for k in range(11))

    kernel = glsl(many)
    assert kernel.source.count("void main()") == 2
    x = np.arange(100, dtype=np.float32)
    for k, out in enumerate(kernel(x)):
        assert np.array_equal(out, x + k)


def test_many_outputs_with_discards_write_the_same_elements() -> None:
    @sh.program
    def many(x: sh.Attrib1f) -> tuple[(sh.Attrib1f,) * 10]:  # type: ignore[valid-type]
        SH_DISCARD(x > 50)
        return tuple(x + k for k in range(10))

    x = np.arange(100, dtype=np.float32)
    out = tuple(np.full(100, -1, np.float32) for _ in range(10))
    result = glsl(many).run(x, out=out)
    assert np.array_equal(result.written, x <= 50)
    for k, a in enumerate(out):
        assert np.array_equal(a, np.where(x <= 50, x + k, -1))


# Threads, availability, errors


def test_runs_from_any_thread() -> None:
    kernel = glsl(twice)
    x = np.arange(1000, dtype=np.float32)
    found: dict[int, Any] = {}

    def job(k: int) -> None:
        for _ in range(5):
            found[k] = kernel(x + k)

    threads = [threading.Thread(target=job, args=(k,)) for k in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(np.array_equal(found[k], 2 * (x + k)) for k in range(6))


def test_a_forked_process_is_told_and_does_not_hang() -> None:
    kernel = glsl(twice)
    kernel(np.float32(1))
    child = os.fork()
    if child == 0:
        try:
            kernel(np.float32(1))
        except sh.ShpyError as error:
            os._exit(42 if "spawn" in str(error) else 1)
        os._exit(2)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 42


def test_textures_are_used_again() -> None:
    kernel = glsl(twice)
    x = np.arange(3000, dtype=np.float32)
    kernel(x)
    pool = backend._runtime(0).store.pool
    held = len(pool)
    for _ in range(5):
        kernel(x)
    assert len(pool) == held > 0


def test_without_moderngl_the_cure_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "moderngl", None)
    with pytest.raises(sh.BackendUnavailable) as error:
        Context(0)
    assert error.value.cure == sh.packages.install("moderngl")


def test_without_a_device_the_cure_is_named() -> None:
    with pytest.raises(sh.BackendUnavailable, match=r"OpenGL 3\.3") as error:
        Context(99)
    assert "apt install libegl1 libgl1-mesa-dri" in str(error.value)


@pytest.mark.parametrize(
    "log",
    ["0:4(9): error: `y' undeclared", '0(4) : error C1008: undefined variable "y"', "ERROR: 0:4: 'y' : undeclared"],
)
def test_a_drivers_complaint_is_mapped_to_the_users_line(log: str) -> None:
    source = "#version 330 core\nvoid main() {\n    float x = 1.0;  // wave.py:12\n    x = y;\n}\n"
    error = refused(source, f"GLSL Compiler failed\n\nfragment_shader\n======\n{log}\n", Loc("other.py", 1))
    assert error.loc == Loc("wave.py", 12)
    assert "4: x = y;" in str(error)


def test_a_shader_that_the_driver_refuses_is_an_error() -> None:
    shader = Shader("#version 330 core\nvoid main() {\n    float x = y;  // wave.py:3\n}\n", (), {}, (), ())
    with pytest.raises(sh.CompileError, match=r"wave.py:3: the driver refused .*un(declared|defined)"):
        backend._runtime(0).build(shader, None)


@pytest.mark.parametrize(
    "log",
    [
        "0:3(12): error: `y' undeclared",
        '0(3) : error C1503: undefined variable "y"',
        "ERROR: 0:3: 'y' : undeclared identifier",
    ],
    ids=["Mesa", "NVIDIA", "ANGLE"],
)
def test_the_line_is_found_in_every_drivers_log(log: str) -> None:
    error = refused("#version 330 core\nvoid main() {\n    float x = y;  // wave.py:3\n}\n", f"\n{log}\n", None)
    assert error.loc == Loc("wave.py", 3)
    assert "  3: float x = y;" in error.message


def test_inputs_that_nothing_reads_take_no_texture_and_too_many_are_refused() -> None:
    limit = backend._runtime(0).context.limits.textures

    def reading(count: int) -> Module:
        b = Builder("total")
        inputs = [b.input(vec("f"), f"x{k}") for k in range(limit + 8)]
        total = inputs[0]
        for value in inputs[1:count]:
            total = b.let("add", total, value)
        b.store(b.output(vec("f"), "y"), total)
        return Module("total", tuple(Port(str(i.name), "") for i in inputs), (Port("y", ""),), (), (), (b.finish(),))

    arrays = tuple(np.full(5, k, np.float32) for k in range(limit + 8))
    out = np.zeros(5, np.float32)
    backend.compile(reading(limit), Options()).run(Call((5,), arrays, (out,), {}, {}))
    assert (out == sum(range(limit))).all()
    with pytest.raises(
        sh.CompileError, match=rf"{limit + 8} inputs and tables: a program of this device reads {limit}"
    ):
        backend.compile(reading(limit + 8), Options())


def test_textures_beyond_the_limit_are_refused_though_a_driver_links_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """NVIDIA's links a shader of 40 textures for 32 units, and reads some of them wrong."""
    context = backend._runtime(0).context

    @sh.program
    def four(a: sh.Attrib1f, b: sh.Attrib1f, c: sh.Attrib1f, d: sh.Attrib1f) -> sh.Attrib1f:
        return a + b + c + d + 0.1875

    monkeypatch.setattr(context, "limits", replace(context.limits, textures=3))
    with pytest.raises(sh.CompileError, match="4 inputs and tables: a program of this device reads 3 at most"):
        four.compile("glsl")
    monkeypatch.undo()
    assert four.compile("glsl")(1, 2, 3, 4) == 10.1875


def test_the_notes_name_flushed_denormals() -> None:
    flushes = not backend._runtime(0).context.limits.keeps_denormals
    assert any("denormal" in note for note in glsl(twice).notes) == flushes


def test_a_param_is_bound_without_a_look_through_all_uniforms(monkeypatch):
    """The time to bind n Params would grow as n²."""
    import moderngl

    gains = [sh.Param(sh.Attrib1f, k, name=f"gain_{k}") for k in range(8)]

    @sh.program
    def total(x: sh.Attrib1f) -> sh.Attrib1f:
        return sum(gains, x)

    kernel = glsl(total)
    assert kernel([1.0]) == 29
    steps, every = [], moderngl.Program.__iter__
    monkeypatch.setattr(moderngl.Program, "__iter__", lambda program: steps.append(1) or every(program))
    gains[0].value = 3
    assert kernel([1.0]) == 32
    assert steps == []
