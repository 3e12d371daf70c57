"""The prologue of a packet's kernel: operations on packets that OpenCL C lacks, or computes slowly or otherwise.

Stage: emit. Texts have FLOAT, INT, UINT, DOUBLE for `float16` and so on, or T for the type of the operands and MASK for
the type of a comparison of two T. Only functions that are used are printed. Clang has functions that PoCL compiles to
fewer instructions than OpenCL's own (`Abilities`); a trial, made once, shows whether a device has them.

>>> prologue = PacketPrologue(8, Abilities())
>>> prologue.any_lane()
'sh_any'
>>> print(prologue.text())
// True if any lane is set.
bool sh_any(int8 mask) {
    ulong4 a = as_ulong4(mask);
    ulong2 b = a.lo | a.hi;
    return (b.x | b.y) != 0;
}
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Final

from shpy.backend.emit.spell_c import row_major
from shpy.backend.opencl.packets.prologue_memory import (
    QUAD,
    PacketMemory,
    element_name,
    lane_of,
    spelled_wide,
    struct_text,
)
from shpy.backend.opencl.packets.prologue_packet import INLINE, block_packet, list_packet
from shpy.backend.opencl.packets.widen import rows_of
from shpy.backend.opencl.text.prologue import SCALARS, Prologue
from shpy.ir.types import Base, Type

IN_REGISTERS: Final = 8
"""The most elements of a local array whose element is chosen by comparisons; longer arrays lie in memory."""

SIGNS: Final = {
    4: "__builtin_ia32_movmskps(as_float4(mask))",
    8: "__builtin_ia32_movmskps256(as_float8(mask))",
    16: "__builtin_ia32_cvtd2mask512(mask)",
}
"""The signs of a mask as the bits of a number, by the number of lanes: x86 takes one instruction for it, or none.

By `__builtin_reduce_or`, a frame of a mesh of 70,400 triangles on a mirror takes 1.06 times the CPU time, n-body 1.03.
Wider packets join their parts by `|` first: spheres of 32 lanes take 0.98 of their time, Mandelbrot of 64 lanes 0.96.
"""

GUESSES: Final = {
    4: "__builtin_ia32_rsqrtps({})",
    8: "__builtin_ia32_rsqrtps256({})",
    16: "__builtin_ia32_rsqrt14ps512_mask({0}, {0}, -1)",
}
"""1 / sqrt(x) by one instruction of x86, by the number of lanes: relative errors are below 2**-11, of 16 lanes 2**-14.

It may give NaN or infinity for zeros, infinities, NaN, negative and denormal numbers.
"""

TRUNCATIONS: Final = {
    4: "__builtin_ia32_cvttps2dq({})",
    8: "__builtin_ia32_cvttps2dq256({})",
    16: "__builtin_ia32_cvttps2dq512_mask({}, (int16)(0), -1, 4)",
}
"""Floats to ints by one instruction of x86, by the number of lanes: NaN and numbers out of range give the least int.

Two comparisons make of it what the language asks for; PoCL's `convert_int16_sat` takes twice as many instructions.
"""

_RSQRT: Final = """\
// 1 / sqrt(x), rounded once, of numbers without an estimate.
__attribute__((noinline)) T {name}_rare(T x) {
    T near = 1.0f / sqrt(x);
    T minus_root = -(x * near);
    T lack = fma(minus_root, near, (T)(1.0f)) - fma(x, near, minus_root) * near;
    return lack == lack ? near + near * lack * (0.375f * lack + 0.5f) : near;
}

// 1 / sqrt(x), rounded once: an estimate, then a number within one unit in the last place, then the nearest.
T {name}(T x) {
    T guess = GUESS;
    T lack = fma(-(x * guess), guess, (T)(1.0f));
    T near = STEP;
    T root = x * near;
    lack = fma(fma(-x, near, root), near, fma(-root, near, (T)(1.0f)));
    if (RARE) {
        return {name}_rare(x);
    }
    return fma(near * lack, fma((T)(0.375f), lack, (T)(0.5f)), near);
}"""
"""The bits do not depend on the processor's estimate.

From any number within its bound the first step, of `_STEPS`, gives one within a unit in the last place (151 million
estimates over all x of [1, 4) for each bound), and from any such number the second step rounds correctly (all x of
[1, 4), all neighbours; without the term of 3/8 one or two fail). Other exponents are these scaled by powers of 4, which
neither overflow nor underflow. `scripts/exhaustive rsqrt --lanes 8` and `--lanes 64` compare all 2**32 inputs with both
instructions. It takes 11 or 12 operations and no division: strict n-body takes 0.63 (Intel Xeon) and 0.79 (AMD EPYC) of
its CPU time at 64 lanes, and the shorter step 0.96 of that.
"""

_NEAR_RSQRT: Final = """\
// 1 / sqrt(x) of numbers without an estimate.
__attribute__((noinline)) T {name}_rare(T x) {
    return 1.0f / sqrt(x);
}

// 1 / sqrt(x) within two units in the last place: an estimate, and a step towards the root.
T {name}(T x) {
    T guess = GUESS;
    T lack = 1.0f - x * guess * guess;
    if (RARE) {
        return {name}_rare(x);
    }
    return guess + guess * lack * (0.375f * lack + 0.5f);
}"""
"""Relaxed mode's root: at most 1.5 units of error, and n-body in 0.57 of its CPU time with OpenCL's `rsqrt`.

In fast mode the compiler removes the test for rare numbers, and 1 / sqrt(0) would be NaN.
"""

_STEPS: Final = {
    4: "fma(guess * lack, fma((T)(0.375f), lack, (T)(0.5f)), guess)",
    8: "fma(guess * lack, fma((T)(0.375f), lack, (T)(0.5f)), guess)",
    16: "fma(guess * 0.5f, lack, guess)",
}
"""The first step by the number of lanes of the estimate: cubic, or quadratic where the estimate is close enough."""


@dataclass(frozen=True, slots=True)
class Abilities:
    """The extensions of a compiler: `__builtin_reduce_or`, the functions of ELEMENTWISE, `__builtin_shufflevector`.

    `signs` are the widths for which it has the functions of SIGNS; `wider` are the widths of WIDER that it has;
    `guesses` and `truncations` are the widths for which it has the functions of GUESSES and TRUNCATIONS.
    """

    reduce: bool = False
    elementwise: bool = False
    shuffle: bool = False
    signs: frozenset[int] = frozenset()
    wider: frozenset[int] = frozenset()
    guesses: frozenset[int] = frozenset()
    truncations: frozenset[int] = frozenset()


class PacketPrologue(Prologue):
    """The functions that one packet's kernel uses, in the order of the first use.

    A packet has `columns` neighbouring elements in each row. If `listed`, it holds consecutive elements of a list.
    """

    def __init__(
        self, lanes: int, abilities: Abilities, columns: int = QUAD, *, listed: bool = False, packets: int = 1
    ) -> None:
        super().__init__()
        self.lanes = lanes
        self.abilities = abilities
        self._memory = PacketMemory(lanes, abilities.shuffle, columns, listed)
        self._packets = packets

    def any_lane(self) -> str:
        """Add the function that tells whether any lane is set; return its name."""
        return self.ask("sh_any", self._any)

    def extreme_lane(self, which: str, base: Base) -> str:
        """Add the function that finds the `min` or the `max` of all lanes; return its name."""
        name = f"sh_{which}_lane_{base.value}"
        return self.ask(name, lambda: _extreme(name, which, SCALARS[base], self.lanes))

    def _any(self) -> str:
        head = f"// True if any lane is set.\nbool sh_any(int{self.lanes} mask) {{\n"
        length = self._length(self.abilities.signs)
        if length:
            parts = " | ".join(f"mask{part}" for part in self._parts(length))
            return f"{head}    return {SIGNS[length].replace('mask)', f'{parts})')} != 0;\n}}"
        if self.abilities.reduce:
            return f"{head}    return __builtin_reduce_or(mask) != 0;\n}}"
        lines, width, name = [], self.lanes // 2, "a"
        lines.append(f"    ulong{width} a = as_ulong{width}(mask);")
        while width > 2:
            width //= 2
            last, name = name, chr(ord(name) + 1)
            lines.append(f"    ulong{width} {name} = {last}.lo | {last}.hi;")
        lines.append(f"    return ({name}.x | {name}.y) != 0;")
        return head + "\n".join(lines) + "\n}"

    def rsqrt(self, name: str, *, near: bool = False) -> bool:
        """Add 1 / sqrt(x) of lanes of binary32 by an estimate; return whether there is one.

        It is correctly rounded, or has at most two units of error if `near`.
        """
        length = self._length(self.abilities.guesses)
        if not length:
            return False
        parts = self._parts(length)
        guesses = [GUESSES[length].format(f"x{part}") for part in parts]
        guess = guesses[0] if len(guesses) == 1 else f"(float{self.lanes})({', '.join(guesses)})"
        signs = SIGNS[length] if length in self.abilities.signs else ""
        # A NaN among the numbers is one in their sum, which takes less to test.
        lack = " + ".join(f"lack{part}" for part in parts) if signs else "lack"
        is_rare = f"({lack}) - ({lack}) != 0.0f" if near else f"{lack} != {lack}"  # an infinity passes the first step
        rare = f"{signs.replace('(mask)', f'({is_rare})')} != 0" if signs else f"{self.any_lane()}({is_rare})"
        text = (_NEAR_RSQRT if near else _RSQRT).replace("GUESS", guess).replace("STEP", _STEPS[length])
        text = text.replace("RARE", rare).replace("{name}", name)
        self.ask(name, lambda: re.sub(r"\bT\b", f"float{self.lanes}", text))
        return True

    def ints(self) -> str:
        """Add the conversion of binary32 to ints; return its name, or "" if the compiler has none of TRUNCATIONS."""
        length = self._length(self.abilities.truncations)
        parts = [TRUNCATIONS[length].format(f"x{part}") for part in self._parts(length)] if length else []
        ints, joined = f"int{self.lanes}", ", ".join(parts)
        text = f"""\
// The ints nearest to zero; the nearest ones for numbers out of range, 0 for NaN.
{ints} sh_{ints}(float{self.lanes} x) {{
    {ints} n = {joined if len(parts) == 1 else f"({ints})({joined})"} ^ (x >= 2147483648.0f);
    return x == x ? n : ({ints})(0);
}}"""
        return self.ask(f"sh_{ints}", lambda: text) if parts else ""

    def _length(self, widths: Iterable[int]) -> int:
        """Return the largest of the widths that a packet has once or several times; 0 if there is none."""
        return max((n for n in widths if n <= self.lanes), default=0)

    def _parts(self, length: int) -> list[str]:
        """Return the selectors of a packet's parts of `length` lanes each: ".lo" and ".hi", or "" for all of it."""
        parts = [""]
        while len(parts) * length < self.lanes:
            parts = [f"{part}.{half}" for part in parts for half in ("lo", "hi")]
        return parts

    # Types and memory

    def struct(self, type: Type) -> str:
        """Add the struct of a packet of vectors; return its name."""
        return self.ask(spelled_wide(type), lambda: struct_text(type))

    def packet(self) -> None:
        """Add the struct of a work item's packet."""
        lanes, columns = self.lanes, self._memory.columns
        self.ask(
            "sh_packet",
            lambda: list_packet(lanes) if self._memory.listed else block_packet(lanes, columns, self._packets),
        )

    def memory(self, way: str, base: Base, size: int) -> str:
        """Add the function for a `way` of `read`, `write` or `gather`; return its name."""
        if size > 1:
            self.struct(rows_of(base, size, self.lanes))
        name = f"sh_{way}_{base.value}{size if size > 1 else ''}"
        if way != "gather":
            self._packed(base)
        text = {"read": self._memory.read, "write": self._memory.write, "gather": self._memory.gather}[way]
        return self.ask(name, lambda: text(name, base, size))

    def _packed(self, base: Base) -> None:
        """Add the types through which vectors are loaded and stored, where the compiler has them."""
        for count in (QUAD, self.lanes) if self.abilities.shuffle else ():
            name = f"{element_name(base)}{count}_packed"
            self.ask(name, partial(self._memory.packed, base, count))

    def near(self, rank: int, base: Base, size: int, modulo: str, *, tells: bool) -> str:
        """Add the function that reads a table at an offset from the packet's own place; return its name.

        It takes the indices modulo an argument by the function `modulo`, unless that is "". If the kernel `tells`
        whether all lanes are in range, that is an argument.
        """
        self.packet()
        self._packed(base)
        gather, flat = self.memory("gather", base, size), self.flat_lanes(rank) if rank > 1 else ""
        wrap = self.ask("sh_wrap_lanes", lambda: _wrap("sh_wrap_lanes", modulo, self.lanes)) if modulo else ""
        name = f"sh_{'around' if modulo else 'near'}{rank}_{base.value}{size if size > 1 else ''}"
        return self.ask(name, lambda: self._memory.near(name, rank, base, size, gather, flat, wrap, tells))

    def flat_lanes(self, rank: int) -> str:
        """Add the function that computes flat indices in a table of two or three axes; return its name."""
        index = rows_of(Base.I, rank, self.lanes)
        self.struct(index)
        name = f"sh_at{rank}_lanes"
        return self.ask(name, lambda: _flat(name, spelled_wide(index), rank, self.lanes))

    # Local arrays

    def array(self, way: str, base: Base, length: int, varies: bool) -> str:
        """Add the function that can `pick` from a local array, or `put` into it, at an index per lane; return its name.

        If `varies` is false, the elements of the array are uniform.
        """
        name = f"sh_{way}_{base.value}{length}{'' if varies else '_uniform'}"
        scalar = SCALARS[Base.I if base is Base.B and varies else base]
        if way == "pick":
            return self.ask(name, lambda: _pick(name, scalar, length, self.lanes, varies=varies))
        return self.ask(name, lambda: _put(name, scalar, length, self.lanes))


def _extreme(name: str, which: str, scalar: str, lanes: int) -> str:
    """Return the function that halves a packet until one number is left."""
    lines, parts, width = [], "v", lanes
    for letter in "abcdef":
        halves = [f"{parts}.{half}" for half in ("lo", "hi")]
        width //= 2
        choice = f"{halves[0]} {'<' if which == 'min' else '>'} {halves[1]} ? {halves[0]} : {halves[1]}"
        if width == 1:
            break
        lines.append(f"    {scalar}{width} {letter} = {choice};\n")
        parts = letter
    told = "least" if which == "min" else "greatest"
    head = f"// The {told} number of all lanes.\n{scalar} {name}({scalar}{lanes} v) {{\n"
    return f"{head}{''.join(lines)}    return {choice};\n}}"


def _each(lanes: int) -> list[str]:
    return [lane_of(k, lanes) for k in range(lanes)]


def _flat(name: str, index: str, rank: int, lanes: int) -> str:
    expression = row_major([f"clamp(at.{c}, 0, size.{c} - 1)" for c in "xyz"[:rank]], "size")
    return f"""\
// The places of elements, the nearest ones for indices that are out of range.
int{lanes} {name}({index} at, int{rank} size) {{
    return {expression};
}}"""


def _wrap(name: str, modulo: str, lanes: int) -> str:
    last = lane_of(lanes - 1, lanes)
    return f"""\
// Indices modulo n: those that lie side by side, near 0 or n, need no division.
int{lanes} {name}(int{lanes} i, int n) {{
    if (n > 0 && n < 1 << 29 && i.s0 >= -n && i.s0 < 2 * n && i{last} < 2 * n) {{
        return i + ((i < 0) & n) - ((i >= n) & n);
    }}
    return {modulo}(i, (int{lanes})(n));
}}"""


def _tests(scalar: str, lanes: int) -> str:
    """Return a statement that converts the index `i` to integers as wide as the elements of the array."""
    return f"    long{lanes} n = convert_long{lanes}(i);\n" if scalar == "double" else f"    int{lanes} n = i;\n"


def _choice(parts: Iterable[str]) -> str:
    """Return the expression that chooses part number `n`; if `n` is out of range, it chooses the nearest part."""
    *others, last = parts
    return "".join(f"n {'==' if k else '<='} {k} ? {part} : " for k, part in enumerate(others)) + last


def _pick(name: str, scalar: str, length: int, lanes: int, *, varies: bool) -> str:
    """Return the function that picks an element for each lane: packets if the array `varies`, else numbers."""
    element, minus = ("int", "-") if scalar == "bool" else (scalar, "")
    wide = f"{element}{lanes}"
    told = "Each lane's element at its own index" if varies else "The element at each lane's index"
    head = f"// {told}, clamped.\n{INLINE} {wide} {name}(const {wide if varies else scalar} *a, int{lanes} i) {{\n"
    if length <= IN_REGISTERS:
        choice = _choice(f"a[{k}]" if varies else f"({wide})({minus}a[{k}])" for k in range(length))
        return f"{head}{_tests(element, lanes)}    return {choice};\n}}"
    flat = f"    const {scalar} *flat = (const {scalar} *)a;\n" if varies else ""
    place = f" * {lanes} + {_numbers(lanes)}" if varies else ""
    loads = ", ".join(f"{minus}{'flat' if varies else 'a'}[i{h}]" for h in _each(lanes))
    return f"{head}{flat}    i = clamp(i, 0, {length - 1}){place};\n    return ({wide})({loads});\n}}"


def _put(name: str, scalar: str, length: int, lanes: int) -> str:
    head = f"{INLINE} void {name}({scalar}{lanes} *a, int{lanes} i, {scalar}{lanes} v) {{\n"
    if length <= IN_REGISTERS:
        stores = "".join(f"    a[{k}] = n == {k} ? v : a[{k}];\n" for k in range(length))
        told = "// Each lane's number into the element at its own index, if there is one.\n"
        return f"{told}{head}{_tests(scalar, lanes)}{stores}}}"
    stores = "".join(f"    flat[i{h}] = v{h};\n" for h in _each(lanes))
    return f"""\
// Stores each lane's number in the element at its own index; element {length} takes those out of range.
{head}\
    {scalar} *flat = ({scalar} *)a;
    i = (i < 0) | (i > {length}) ? (int{lanes})({length}) : i;
    i = i * {lanes} + {_numbers(lanes)};
{stores}}}"""


def _numbers(lanes: int) -> str:
    return f"(int{lanes})({', '.join(map(str, range(lanes)))})"
