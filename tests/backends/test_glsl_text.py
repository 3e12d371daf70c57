"""Golden texts of the GLSL printer, one feature each; what must never be in a text, and names that clash."""

import re
from typing import Any

import numpy as np
import pytest
from texts import TEXTS

import shpy as sh
from shpy import SH_DISCARD, SH_ELSE, SH_FOR, SH_IF, SH_WHILE
from shpy.backend.glsl.text.prologue import SPLIT

heights = sh.Table(np.zeros((4, 5), np.float32), sh.Attrib1f, name="heights")
sky = sh.Param(sh.Color3f, (0.2, 0.4, 0.8), name="sky")


@sh.program
def wave(x: sh.Attrib1f, k: sh.Attrib2f) -> sh.Attrib2f:
    y = sh.sin(x) * k + 0.0
    return sh.cond(y > 0, y, -k)


@sh.program
def terrain(cell: sh.Attrib2i) -> tuple[sh.Color3f, sh.Attrib2i]:
    h = heights[cell]
    return sky * h, sh.grid_index(2)


@sh.subroutine
def push(stack: sh.Attrib4f, value: sh.Attrib1f) -> sh.Attrib1f:
    stack[:] = sh.Attrib4f(value, stack.xyz)
    return stack.w


@sh.program
def histogram(x: sh.Attrib1f, bits: sh.Attrib1u) -> tuple[sh.Attrib4f, sh.Attrib1b]:
    counts = sh.Array(sh.Attrib1i, 4)
    stack = sh.Attrib4f()
    with SH_FOR(0, 10) as i:
        counts[i % 4] += 1
        push(stack, sh.Attrib1f(counts[i]) * x)
    return stack, (bits >> 3) % 2 == 1


@sh.program
def positive(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    total = sh.Attrib1f(0)
    with SH_IF(x < 0):
        SH_DISCARD()
    with SH_ELSE():
        with SH_WHILE(lambda: n > 0):
            total += sh.min(x, 1) / sh.Attrib1f(n)
            n -= 1
    return total


PROGRAMS: dict[str, Any] = {
    "wave": wave, "terrain": terrain, "histogram": histogram, "positive": positive,
}  # fmt: skip


@pytest.mark.parametrize("name", PROGRAMS)
def test_golden_text(name: str, snapshots: Any) -> None:
    snapshots.check(f"{name}.glsl", TEXTS["glsl"](PROGRAMS[name].ir))


@pytest.mark.parametrize("name", PROGRAMS)
def test_what_never_stands_in_a_text(name: str) -> None:
    source = PROGRAMS[name].compile("glsl").source
    assert max(map(len, source.splitlines())) <= 160
    assert "\t" not in source
    assert "\n\n\n" not in source
    own = source[source.index(f" {name}(") :]
    assert not re.search(r"[-+*/] 0\.0|0\.0 [-+*/]", own)
    assert not re.search(r"(?<!precise )\bfloat \w+( =|;)", own)
    called = set(re.findall(r"\b(sh_\w+)\(", source))
    assert all(re.search(rf"^\w+ {f}\(", source, re.MULTILINE) for f in called)


@sh.program
def main(zero: sh.Attrib1f, at: sh.Attrib1f, texelFetch: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f]:
    status = zero * 0.0 + at
    precise = status * texelFetch
    return status, precise


def test_names_that_glsl_or_the_printer_uses_do_no_harm() -> None:
    x = np.array([1, 2, np.inf], np.float32)
    a, b = main.compile("glsl")(x, x + 1, x + 2)
    with np.errstate(invalid="ignore"):
        assert np.array_equal(a, x * 0 + x + 1, equal_nan=True)
        assert np.array_equal(b, (x * 0 + x + 1) * (x + 2), equal_nan=True)


@sh.program
def shifted(x: sh.Attrib1u, by: sh.Attrib1u) -> tuple[sh.Attrib1u, sh.Attrib1u]:
    return x >> by, x << ((by & 15) + 16)


def test_what_a_shift_is_by_is_masked_unless_it_is_known_to_be_less_than_32() -> None:
    kernel = shifted.compile("glsl")
    assert "x >> (by & 31u)" in kernel.source
    assert "x << ((by & 15u) + 16u)" in kernel.source
    right, left = kernel(np.uint32([96, 5]), np.uint32([33, 34]))
    assert right.tolist() == [48, 1]
    assert left.tolist() == [96 << 17, 5 << 18]


def test_the_prologue_holds_what_is_used_and_below_what_that_calls() -> None:
    @sh.program
    def clamped(x: sh.Attrib3f) -> sh.Attrib3f:
        return sh.clamp(x, -1, 1)

    names = re.findall(r"^\w+ (sh_\w+)\(", clamped.compile("glsl").source, re.MULTILINE)
    assert names == ["sh_max", "sh_min", "sh_clamp", "sh_clamp"]


def test_division_of_places_by_way_of_floats_is_exact():
    """Quotients and remainders at multiples, beside them, and up to the largest number of elements of a texture."""
    from shpy.backend.glsl.device.context import open_context

    context = open_context(0)
    rng = np.random.default_rng(7)
    n = np.concatenate([rng.integers(1, 2**e, 3000) for e in (2, 4, 10, 14, 20, 26)])
    multiples = n * (rng.integers(0, 2**26, len(n)) // n)
    i = np.clip(multiples + rng.integers(-1, 2, len(n)), 0, 2**27).astype(np.int32)
    text = (
        "#version 330 core\nuniform isampler2D pairs;\nlayout(location = 0) out ivec2 parts;\n"
        f"{SPLIT}\nvoid main() {{\n    ivec2 p = texelFetch(pairs, ivec2(gl_FragCoord.xy), 0).xy;\n"
        "    parts = sh_split(p.x, p.y);\n}\n"
    )
    size, pairs = (1000, len(n) // 1000), np.stack([i, n.astype(np.int32)], axis=-1)

    def draw():
        texture = context.gl.texture(size, 2, pairs.tobytes(), dtype="i4")
        target = context.gl.framebuffer([context.gl.texture(size, 2, dtype="i4")])
        target.use()
        texture.use(0)
        context.gl.vertex_array(context.program(text), []).render(context.moderngl.TRIANGLES, 3)
        found = target.read(components=2, dtype="i4")
        context.resting.use()
        return found

    found = np.frombuffer(context.call(draw), np.int32).reshape(-1, 2)
    assert np.array_equal(found, np.stack([i // n, i % n], axis=-1))
