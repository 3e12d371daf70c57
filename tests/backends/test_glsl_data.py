"""Tables and params on GLSL: folded textures, exact ints, clamping on each axis, what is sent when."""

import gc
import weakref
from typing import Any

import numpy as np
import pytest

import shpy as sh
from shpy.backend.glsl import backend
from shpy.backend.glsl.device.context import open_context
from shpy.backend.glsl.text.interface import FOLD
from shpy.ir.tabledata import TableData
from shpy.ir.types import vec


def glsl(program: Any) -> Any:
    return program.compile("glsl")


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "element", [sh.Attrib1f, sh.Attrib2f, sh.Attrib3f, sh.Attrib4f, sh.Attrib1i, sh.Attrib3i, sh.Attrib2u]
)
def test_a_long_table_is_folded(element: Any) -> None:
    size, kind = int(element.__name__[6]), element.__name__[7]
    n = 3 * FOLD + 17
    dtype = {"f": np.float32, "i": np.int32, "u": np.uint32}[kind]
    data = (np.arange(n * size).reshape(n, size) * 1001).astype(dtype)
    table = sh.Table(data[:, 0] if size == 1 else data, element)

    @sh.program
    def read(i: sh.Attrib1i) -> element:
        return table[i]

    i = np.concatenate([np.arange(-3, n + 3), [2**31 - 1, -(2**31)]]).astype(np.int32)
    expected = data[np.clip(i, 0, n - 1)]
    assert np.array_equal(glsl(read)(i).reshape(-1, size), expected)


def test_ints_past_2_to_24_stay_exact() -> None:
    table = sh.Table(np.array([2**24 + 1, -(2**31), 2**31 - 1, -7], np.int32), sh.Attrib1i)

    @sh.program
    def read(i: sh.Attrib1i) -> sh.Attrib1i:
        return table[i]

    assert glsl(read)(np.arange(4, dtype=np.int32)).tolist() == [2**24 + 1, -(2**31), 2**31 - 1, -7]


@pytest.mark.parametrize("shape", [(5, 7), (3, 9000), (9000, 3), (2, 3, 4), (20, 30, 40)])
def test_tables_of_two_and_three_axes_clamp_each(shape: tuple[int, ...]) -> None:
    data = np.random.default_rng(3).random(shape, dtype=np.float32)
    table = sh.Table(data, sh.Attrib1f)
    rank = len(shape)

    @sh.program
    def read(i: getattr(sh, f"Attrib{rank}i")) -> sh.Attrib1f:  # type: ignore[valid-type]
        return table[i]

    rng = np.random.default_rng(4)
    i = np.stack([rng.integers(-2, n + 2, 4000) for n in shape], -1).astype(np.int32)
    clamped = tuple(np.clip(i[:, k], 0, n - 1) for k, n in enumerate(shape))
    assert np.array_equal(glsl(read)(i), data[clamped])


def test_a_table_is_sent_again_only_when_it_changes() -> None:
    table = sh.Table(np.arange(10, dtype=np.float32), sh.Attrib1f)

    @sh.program
    def read(i: sh.Attrib1i) -> sh.Attrib1f:
        return table[i]

    kernel = glsl(read)
    store = backend._runtime(0).store
    i = np.arange(10, dtype=np.int32)
    kernel(i)
    before = store.uploads
    kernel(i)
    assert store.uploads == before
    table.update(np.arange(10, dtype=np.float32) * 3)
    assert np.array_equal(kernel(i), 3 * i)
    assert store.uploads == before + 1


def test_a_table_that_is_gone_leaves_the_device() -> None:
    store = backend._runtime(0).store
    held = [TableData(np.zeros(100, np.float32))]
    open_context(0).call(lambda: store.table(held[0], vec("f")))
    reference = weakref.ref(held[0])
    assert reference in store.tables.keyrefs()
    held.clear()
    gc.collect()
    assert reference() is None
    assert reference not in store.tables.keyrefs()


def test_params_of_every_type() -> None:
    f = sh.Param(sh.Color3f, (1, 2, 3), name="f")
    i = sh.Param(sh.Attrib2i, (-4, 5), name="i")
    u = sh.Param(sh.Attrib1u, 2**32 - 1, name="u")
    b = sh.Param(sh.Attrib1b, True, name="b")

    @sh.program
    def read(x: sh.Attrib1f) -> tuple[sh.Attrib3f, sh.Attrib2i, sh.Attrib1u, sh.Attrib1b]:
        return sh.Attrib3f(f * x), sh.Attrib2i(i), sh.Attrib1u(u), sh.Attrib1b(b)

    kernel = glsl(read)
    a, c, d, e = kernel(np.float32(2))
    assert (a.tolist(), c.tolist(), int(d), bool(e)) == ([2, 4, 6], [-4, 5], 2**32 - 1, True)
    f.value, i.value, u.value, b.value = (0, 1, 0.5), (7, 8), 3, False
    a, c, d, e = kernel(np.float32(2))
    assert (a.tolist(), c.tolist(), int(d), bool(e)) == ([0, 2, 1], [7, 8], 3, False)
