"""Golden texts of the OpenCL printer, one feature each; names that clash; what must never be in a text."""

import re
from typing import Any

import numpy as np
import pytest

import shpy as sh
from shpy import (
    SH_BREAK,
    SH_CONTINUE,
    SH_DISCARD,
    SH_ELIF,
    SH_ELSE,
    SH_FOR,
    SH_IF,
    SH_RETURN,
    SH_WHILE,
)
from shpy.backend.emit.spell_c import comment
from shpy.ir.nodes import Loc

heights = sh.Table(np.zeros((4, 5), np.float32), sh.Attrib1f, name="heights")
palette = sh.Table(np.zeros((9, 3), np.float32), sh.Attrib3f, name="palette")
sky = sh.Param(sh.Color3f, (0.2, 0.4, 0.8), name="sky")


@sh.subroutine
def shade(n: sh.Normal3f, light: sh.Vector3f, color: sh.Color3f) -> sh.Color3f:
    d = sh.dot(n, light)
    with SH_IF(d < 0):
        SH_RETURN(color * 0.1)
    return color * d


@sh.subroutine
def push(stack: sh.Attrib4f, value: sh.Attrib1f) -> sh.Attrib1f:
    stack[:] = sh.Attrib4f(value, stack.xyz)
    return stack.w


@sh.program
def shading(p: sh.Point3f, n: sh.Normal3f) -> sh.Color3f:
    color = sh.Color3f(0)
    with SH_FOR(0, 4) as i:
        with SH_IF(i % 3 == 0):
            SH_CONTINUE()
        color += shade(sh.normalize(n), p, sky) * heights[i, i + 1]
    with SH_IF(p.x > 1):
        color[:] = palette[sh.Attrib1i(p.y)]
    with SH_ELIF(p.y > 1):
        color[:] = sh.cond(p > 0, color, sh.Color3f(0.25))
    with SH_ELSE():
        color.z = sh.clamp(p.z, 0, 1)
    return color


@sh.program
def counting(x: sh.Attrib1f, bits: sh.Attrib1u) -> tuple[sh.Attrib4f, sh.Attrib3b, sh.Attrib1i]:
    counts = sh.Array(sh.Attrib1i, 4)
    stack = sh.Attrib4f()
    with SH_FOR(0, 10) as i:
        counts[i % 4] += 1
        push(stack, sh.Attrib1f(counts[i]) * x)
    mask = sh.Attrib3b((bits >> 3) % 2 == 1, x > 0, False)
    return stack, mask & (stack.xyz > 1), counts[1] * counts[2] - 7


@sh.program
def walk(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    total = sh.Attrib1f(0)
    with SH_IF(x < 0):
        SH_DISCARD()
    with SH_WHILE(lambda: n > 0):
        n -= 1
        with SH_IF(total > 100):
            SH_BREAK()
        total += sh.min(x, 1) / sh.Attrib1f(n)
    return total


@sh.program
def place(offset: sh.Attrib2i) -> tuple[sh.Attrib2i, sh.Attrib1b]:
    at = sh.grid_index(2) + offset
    return at, sh.all(at < sh.grid_shape(2))


PROGRAMS: dict[str, Any] = {
    "shading": shading, "counting": counting, "walk": walk, "place": place,
}  # fmt: skip


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", PROGRAMS)
def test_golden_text(name: str, snapshots: Any) -> None:
    snapshots.check(f"{name}.cl", PROGRAMS[name].compile("opencl", lanes=1).source)


@pytest.mark.parametrize("name", PROGRAMS)
def test_what_never_stands_in_a_text(name: str) -> None:
    source = PROGRAMS[name].compile("opencl", lanes=1).source
    assert max(map(len, source.splitlines())) <= 140
    assert "\t" not in source
    assert "\n\n\n" not in source
    called = set(re.findall(r"\b(sh_\w+)\(", source))
    assert all(re.search(rf"^\w+ {f}\(", source, re.MULTILINE) for f in called)


@sh.program
def kernel(element: sh.Attrib1f, count: sh.Attrib1f, convert_int: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f]:
    INFINITY = element * 2 + count
    sh_min = sh.min(INFINITY * convert_int, 3)
    return INFINITY, sh_min


def test_names_that_opencl_or_the_printer_uses_do_no_harm() -> None:
    x = np.array([1, 2, 3], np.float32)
    a, b = kernel.compile("opencl")(x, x + 1, x + 2)
    assert a.tolist() == [4, 7, 10]
    assert b.tolist() == [3, 3, 3]


def test_a_file_name_cannot_leave_its_comment() -> None:
    assert comment(Loc("b\n#error*", 3)) == "// b__error_:3"
    assert comment(Loc("a.py??\\", 3)) == "// :3"
    assert comment(Loc("dir\\file.py", 12)) == "// file.py:12"
    assert comment(Loc("x??/y\u2028.py", 1)) == "// y_.py:1"
