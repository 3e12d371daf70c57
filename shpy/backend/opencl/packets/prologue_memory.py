"""The prologue of a packet's kernel, part two: how the lanes of a packet read and write memory.

Stage: emit. A packet is one row of elements, or a few rows of four that are `row` elements apart: a block of an image,
or, with `row` 4, consecutive elements of a list. In a kernel that does not read its place in the grid, a packet of one
row is a part of a list, whatever the shape is: only the end of the list has to be tested. Each method of `PacketMemory`
returns the text of functions for one type:

    float16x2 sh_read_f2(__global const float *a, int step, sh_packet p)      an input; step 0: the same for all
    void sh_write_f2(__global float *a, float16x2 v, sh_packet p)             an output; lanes without an element: not
    float16x3 sh_gather_f3(__global const float4 *a, int16 at)                elements of a table, rows of four at once

Where the compiler is clang's, vectors are loaded and stored through a type of their own: PoCL's vload16 moves halves of
halves, down to pairs, which LLVM does not always join again. CPU time: 0.92 to 0.95 for the game of life, 0.91 to 0.97
for Jacobi's iteration.
Consecutive numbers are loaded four at a time and sorted by explicit shuffles of two vectors, because PoCL compiles a
plain list of components to a chain of inserts (40 ns where shuffles take 20, for 16 float4s).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from shpy.backend.opencl.packets.prologue_packet import INLINE
from shpy.backend.opencl.packets.prologue_wide import LONGEST
from shpy.backend.opencl.packets.widen import rows_of
from shpy.backend.opencl.text.prologue import NOINLINE, SCALARS
from shpy.ir.types import Base, Type

QUAD: Final = 4
"""Numbers that are loaded, stored and sorted together; the columns of a packet that is a block."""
_HEX: Final = "0123456789abcdef"
_XYZW: Final = "xyzw"
_PARTS: Final = ("ra", "rb", "rc", "rd")

Pick = tuple[str, int]
"""A vector's name, and a place in each group of four of its numbers."""


def spelled_wide(type: Type) -> str:
    """Return `float16` for a packet of numbers (bools are ints, -1 for true), `float16x3` for a packet of vectors."""
    lanes = getattr(type, "lanes", None)
    base = SCALARS[Base.I if type.is_bool else type.base]
    return f"{base}{type.size}" if lanes is None else f"{base}{lanes}x{type.size}"


def lane_of(lane: int, lanes: int, count: int = 1) -> str:
    """Return the text that picks `count` lanes from `lane` on: `.s4567`, or `.hi.s4567` from the upper 16."""
    halves = ""
    while lanes > LONGEST:
        lanes //= 2
        halves += ".lo" if lane < lanes else ".hi"
        lane %= lanes
    return f"{halves}.s{_HEX[lane : lane + count]}"


def struct_text(type: Type) -> str:
    """Return the declaration of the struct that holds vectors."""
    lanes = getattr(type, "lanes", 0)
    base = SCALARS[Base.I if type.is_bool else type.base]
    return f"typedef struct {{\n    {base}{lanes} {', '.join(_XYZW[: type.size])};\n}} {spelled_wide(type)};"


def _fields(size: int) -> list[str]:
    return [f".{c}" for c in _XYZW[:size]] if size > 1 else [""]


def _scaled(text: str, size: int) -> str:
    return f"{text} * {size}" if size > 1 else text


def element_name(base: Base) -> str:
    """Name the type of a number in memory."""
    return "uchar" if base is Base.B else SCALARS[base]


def _pointed(base: Base, size: int) -> str:
    """Return the type of a table's elements: those of three numbers are padded to four."""
    return element_name(base) if size == 1 else f"{element_name(base)}{4 if size == 3 else size}"


def _place(place: str, size: int, component: int) -> str:
    if size == 1:
        return place
    scaled = f"(size_t)({place}) * {size}" if " " in place else f"(size_t){place} * {size}"
    return f"{scaled} + {component}" if component else scaled


@dataclass(frozen=True, slots=True)
class PacketMemory:
    """The writer of functions for packets of `lanes`; `shuffle`: the compiler has `__builtin_shufflevector`.

    A packet has `columns` neighbouring elements in each row: four for a block of the grid, else all. If `listed`, it
    holds consecutive elements of a list.
    """

    lanes: int
    shuffle: bool
    columns: int
    listed: bool = False

    def read(self, name: str, base: Base, size: int) -> str:
        """Return `sh_read_f2`, and the function that reads the lanes of an incomplete packet one by one."""
        lanes, element, fields = self.lanes, element_name(base), _fields(size)
        result = spelled_wide(rows_of(base, size, lanes))
        same = [f"v{f} = {self._loaded(f'({element}{lanes})(a[{k}])', base)};" for k, f in enumerate(fields)]
        parts = [f"v{f} = {self._loaded(self._vload(element, f'part{k}'), base)};" for k, f in enumerate(fields)]
        what = "A vector" if size > 1 else "A number"
        places = [] if self.listed else [f"    int place[{lanes}];", f"    vstore{lanes}(at, 0, place);"]
        place = "k < left ? k : 0" if self.listed else "place[k]"
        return "\n".join([
            f"// {what} for each lane of an array, one after the other.",
            f"{NOINLINE} {result} {name}_each(__global const {element} *a, {self._which}) {{",
            *places,
            f"    {element} {', '.join(f'part{k}[{lanes}]' for k in range(size))};",
            f"    for (int k = 0; k < {lanes}; k += 1) {{",
            *(f"        part{k}[k] = a[{_place(place, size, k)}];" for k in range(size)),
            "    }",
            f"    {result} v;",
            *(f"    {line}" for line in parts),
            "    return v;",
            "}",
            "",
            f"// {what} for each lane of an array; with step 0, the same for all.",
            f"{INLINE} {result} {name}(__global const {element} *a, int step, sh_packet p) {{",
            f"    {result} v;",
            "    if (step == 0) {",
            *(f"        {line}" for line in same),
            "        return v;",
            "    }",
            f"    a += {_scaled('p.first', size)};",
            f"    if ({self._partial}) {{",
            f"        return {name}_each(a, {'p.left' if self.listed else 'p.at'});",
            "    }",
            *self._if_list(size, f"v = {self._loaded(self._load(element, lanes, 'a'), base)};", "return v;"),
            *(f"    {line}" for line in self._block_loads(base, size)),
            "    return v;",
            "}",
        ])  # fmt: skip

    def write(self, name: str, base: Base, size: int) -> str:
        """Return `sh_write_f2`, and the function that writes the lanes of an incomplete packet one by one."""
        lanes, element, fields = self.lanes, element_name(base), _fields(size)
        value = spelled_wide(rows_of(base, size, lanes))
        numbers = [f"v{f}" if base is not Base.B else f"convert_uchar{lanes}(-v{f})" for f in fields]
        what = "vector" if size > 1 else "number"
        return "\n".join([
            f"// Each lane's {what} into its element of an array, one after the other.",
            *self._write_each(name, base, size, value, numbers),
            "",
            f"// Each lane's {what} into its element of an array.",
            f"{INLINE} void {name}(__global {element} *a, {value} v, sh_packet p) {{",
            f"    a += {_scaled('p.first', size)};",
            f"    if ({self._partial}) {{",
            f"        {name}_each(a, v, {'p.left' if self.listed else 'p.at, p.active'});",
            "        return;",
            "    }",
            *self._if_list(size, self._store(element, lanes, numbers[0], "a"), "return;"),
            *(f"    {line}" for line in self._block_stores(element, numbers)),
            "}",
        ])  # fmt: skip

    def _write_each(self, name: str, base: Base, size: int, value: str, numbers: list[str]) -> list[str]:
        lanes, element = self.lanes, element_name(base)
        parts = [
            f"    {element} {', '.join(f'part{k}[{lanes}]' for k in range(size))};",
            *(f"    vstore{lanes}({n}, 0, part{k});" for k, n in enumerate(numbers)),
        ]
        if self.listed:
            return [
                f"{NOINLINE} void {name}_each(__global {element} *a, {value} v, {self._which}) {{",
                *parts,
                "    for (int k = 0; k < left; k += 1) {",
                *(f"        a[{_place('k', size, k)}] = part{k}[k];" for k in range(size)),
                "    }",
                "}",
            ]
        return [
            f"{NOINLINE} void {name}_each(",
            f"    __global {element} *a, {value} v, {self._which}, int{lanes} active) {{",
            f"    int place[{lanes}], there[{lanes}];",
            f"    vstore{lanes}(at, 0, place);",
            f"    vstore{lanes}(active, 0, there);",
            *parts,
            f"    for (int k = 0; k < {lanes}; k += 1) {{",
            "        if (there[k]) {",
            *(f"            a[{_place('place[k]', size, k)}] = part{k}[k];" for k in range(size)),
            "        }",
            "    }",
            "}",
        ]

    @property
    def _which(self) -> str:
        """The parameter that tells which elements an incomplete packet holds."""
        return "int left" if self.listed else f"int{self.lanes} at"

    @property
    def _partial(self) -> str:
        """The condition that a packet is incomplete."""
        return f"p.left < {self.lanes}" if self.listed else "!p.whole"

    def gather(self, name: str, base: Base, size: int) -> str:
        """Return `sh_gather_f3`, which reads elements of a table; the buffer pads elements of three numbers to four."""
        lanes, result = self.lanes, spelled_wide(rows_of(base, size, self.lanes))
        return "\n".join([
            "// The elements at these places, which are in range.",
            f"{INLINE} {result} {name}(__global const {_pointed(base, size)} *a, int{lanes} at) {{",
            *(f"    {line}" for line in self._gathered(base, size, [f"at{lane_of(k, lanes)}" for k in range(lanes)])),
            "}",
        ])  # fmt: skip

    def _gathered(self, base: Base, size: int, places: list[str]) -> list[str]:
        """Return the statements that load the elements at these places and return them."""
        element = element_name(base)
        if size == 1:
            loads = ", ".join(f"a[{place}]" for place in places)
            return [f"return {self._loaded(f'({element}{self.lanes})({loads})', base)};"]
        body = self._pairs(element, base, places) if size == 2 else self._quads(element, base, size, places)
        return [f"{spelled_wide(rows_of(base, size, self.lanes))} v;", *body, "return v;"]

    def near(self, name: str, rank: int, base: Base, size: int, gather: str, flat: str, wrap: str, tells: bool) -> str:
        """Return `sh_near2_f`, which reads a table beside the packet's own place, contiguous elements as a vector.

        The first lane's index tells whether all lanes are in range, because no index wraps around between them. With a
        function to `wrap` indices, indices that are out of range are taken modulo `n`. Where the kernel `tells` it,
        a constant `inside` says that all lanes are in range of the table, and of its moduli.
        """
        lanes, pointer, guard = self.lanes, _pointed(base, size), "if (!inside) " if tells else ""
        result, index = spelled_wide(rows_of(base, size, lanes)), "int" if rank == 1 else f"int{rank}"
        if rank == 1:
            place = [f"int{lanes} i = as_int{lanes}(as_uint{lanes}(p.x + p.y * {self.columns}) + (uint)by);"]
            first, at, end = "i.s0", ["i.s0"], ["size"]
            sides, pitch = [lanes], str(QUAD)
            slow = f"{gather}(a, clamp({f'{wrap}(i, n)' if wrap else 'i'}, 0, size - 1))"
        else:
            place = [
                f"int{lanes} y = as_int{lanes}(as_uint{lanes}(p.y) + (uint)by.x);",
                f"int{lanes} x = as_int{lanes}(as_uint{lanes}(p.x) + (uint)by.y);",
            ]
            first, at, end = "(int2)(y.s0, x.s0)", ["y.s0", "x.s0"], ["size.x", "size.y"]
            sides = [lanes // self.columns, self.columns]
            pitch = "size.y" if sides[0] > 1 else str(QUAD)
            moved = f"{wrap}(y, n.x), {wrap}(x, n.y)" if wrap else "y, x"
            slow = f"{gather}(a, {flat}((int{lanes}x2){{{moved}}}, size))"
        if wrap:
            # A packet beyond the border is in range after one period. So far from 2^31 no index wraps around within it.
            place += [
                f"{index} end = clamp(n, 0, size), period = n < 1 << 29 ? max(n, 0) : ({index})(0), at = {first};",
                f"{guard}at += (at < 0 ? period : ({index})(0)) - (at >= period ? period : ({index})(0));",
            ]
            at, end = (["at"], ["end"]) if rank == 1 else (["at.x", "at.y"], ["end.x", "end.y"])
        inside = " && ".join(f"{i} >= 0 && {i} <= {n} - {side}" for i, n, side in zip(at, end, sides, strict=True))
        told, more = (", modulo n", f", {index} n") if wrap else ("", "")
        more += ", bool inside" if tells else ""
        return "\n".join([
            f"// The elements of a table at the packet's own place, moved{told}.",
            f"{INLINE} {result} {name}(__global const {pointer} *a, {index} size, sh_packet p, {index} by{more}) {{",
            *(f"    {line}" for line in place),
            f"    if ({'!inside && ' if tells else ''}!({inside})) {{",
            f"        return {slow};",
            "    }",
            f"    a += {at[0] if rank == 1 else f'(size_t){at[0]} * size.y + {at[1]}'};",
            *(f"    {line}" for line in self._near_loads(base, size, pitch)),
            "}",
        ])  # fmt: skip

    def _near_loads(self, base: Base, size: int, pitch: str) -> list[str]:
        """Return the statements that load quads of a table that are `pitch` elements apart."""
        element, rows = element_name(base), range(self.lanes // QUAD)
        if size == 1 and pitch == str(QUAD):
            return [f"return {self._loaded(self._load(element, self.lanes, 'a'), base)};"]
        if size == 1:
            starts = ["a", *(f"a + {f'{r} * ' if r > 1 else ''}{pitch}" for r in rows[1:])]
            loads = ", ".join(self._load(element, QUAD, start) for start in starts)
            return [f"return {self._loaded(f'({element}{self.lanes})({loads})', base)};"]
        return self._gathered(base, size, [f"{f'{r} * {pitch} + ' if r else ''}{c}" for r in rows for c in range(QUAD)])

    def packed(self, base: Base, count: int) -> str:
        """Return the type of vectors that lie in memory as their numbers do."""
        name = f"{element_name(base)}{count}"
        size = {"uchar": 1, "double": 8}.get(element_name(base), 4)
        return f"typedef {name} {name}_packed __attribute__((aligned({size})));"

    def _load(self, element: str, count: int, array: str, at: int = 0) -> str:
        """Return the text that loads `count` numbers, a whole packet or a quad, from number `at` of a device array."""
        if self.shuffle:
            return f"*(__global const {element}{count}_packed *)({array}{f' + {at}' if at else ''})"
        return (
            self._vload(element, array) if count == self.lanes and not at else f"vload{count}({at // count}, {array})"
        )

    def _store(self, element: str, count: int, numbers: str, array: str, at: int = 0) -> str:
        """Return the statement that stores `count` numbers into an array of the device, from number `at` on."""
        if self.shuffle:
            return f"*(__global {element}{count}_packed *)({array}{f' + {at}' if at else ''}) = {numbers};"
        return f"vstore{count}({numbers}, {at // count}, {array});"

    def _vload(self, element: str, array: str) -> str:
        """Return the first numbers of an array: `vload16(0, a)`."""
        if self.lanes <= LONGEST:
            return f"vload{self.lanes}(0, {array})"
        loads = ", ".join(f"vload{LONGEST}({k}, {array})" for k in range(self.lanes // LONGEST))
        return f"({element}{self.lanes})({loads})"

    # Shuffles

    def _loaded(self, text: str, base: Base) -> str:
        """Return the expression that converts loaded data to a packet: bytes of bools become masks."""
        return f"convert_int{self.lanes}({text} != (uchar)0)" if base is Base.B else text

    def _shuffled(self, element: str, picks: Iterable[Pick]) -> str:
        """Return the expression that picks numbers of at most two vectors within each group of four."""
        chosen, groups = list(picks), range(self.lanes // 4)
        if not self.shuffle:
            numbers = ", ".join(f"{name}{lane_of(4 * g + k, self.lanes)}" for g in groups for name, k in chosen)
            return f"({element}{self.lanes})({numbers})"
        first, second = (list(dict.fromkeys(name for name, _ in chosen)) * 2)[:2]
        places = ", ".join(str(4 * g + k + self.lanes * (name != first)) for g in groups for name, k in chosen)
        return f"__builtin_shufflevector({first}, {second}, {places})"

    def _sorted(self, element: str, name: str, picks: list[Pick]) -> tuple[list[str], str]:
        """Return statements and a final shuffle that pick four numbers out of up to four vectors.

        A shuffle takes two vectors, so more need statements first; `name` is the prefix of their variables.
        """
        if len({source for source, _ in picks}) <= 2:
            return [], self._shuffled(element, picks)
        lines = []
        for half, (one, two) in enumerate((picks[:2], picks[2:])):
            lines.append(f"{element}{self.lanes} {name}{half} = {self._shuffled(element, [one, one, two, two])};")
        return lines, self._shuffled(element, [(f"{name}{half}", at) for half in (0, 1) for at in (0, 2)])

    def _if_list(self, size: int, *statements: str) -> list[str]:
        """Return statements in a branch for a block of consecutive elements; no statements if none is needed."""
        if size > 1 or self.lanes == self.columns:
            return []
        return [f"    if (p.row == {self.columns}) {{", *(f"        {s}" for s in statements), "    }"]

    def _block_loads(self, base: Base, size: int) -> list[str]:
        """Return the statements that load a whole packet, four numbers at a time, and sort them by component."""
        element, quads = element_name(base), range(self.lanes // QUAD)
        wide, lines = f"{element}{self.lanes}", []
        if size == 1 and self.lanes == self.columns:
            return [f"v = {self._loaded(self._load(element, self.lanes, 'a'), base)};"]
        for k, part in enumerate(_PARTS[:size]):
            loads = ", ".join(self._load(element, QUAD, self._start(size, q), QUAD * k) for q in quads)
            if size == 1:
                return [f"v = {self._loaded(f'({wide})({loads})', base)};"]
            lines.append(f"{wide} {part} = ({wide})({loads});")
        return lines + self._columns(element, base, size)

    def _columns(self, element: str, base: Base, size: int) -> list[str]:
        """Return statements that make components of `ra`, `rb`, ...: there four lanes have four numbers of a row."""
        if size == 4:
            return self._transposed(element, base, size)
        lines = []
        for component, c in enumerate(_XYZW[:size]):
            places = [divmod(component + size * k, 4) for k in range(4)]
            steps, vector = self._sorted(element, c, [(_PARTS[part], at) for part, at in places])
            lines += [*steps, f"v.{c} = {self._loaded(vector, base)};"]
        return lines

    def _block_stores(self, element: str, numbers: list[str]) -> list[str]:
        """Return the statements that store a whole packet, four numbers at a time."""
        size, wide = len(numbers), f"{element}{self.lanes}"
        if size == 1 and self.lanes == self.columns:
            return [self._store(element, self.lanes, numbers[0], "a")]
        lines = [f"{wide} {_XYZW[k]} = {n};" for k, n in enumerate(numbers)]
        parts = _PARTS[:size] if size > 1 else ("x",)
        for n, part in enumerate(parts if size > 1 else ()):
            picks = [(_XYZW[at % size], at // size) for at in range(4 * n, 4 * n + 4)]
            steps, vector = self._sorted(element, part, picks)
            lines += [*steps, f"{wide} {part} = {vector};"]
        for q in range(self.lanes // QUAD):
            picked, start = lane_of(QUAD * q, self.lanes, QUAD), self._start(size, q)
            lines += [self._store(element, QUAD, part + picked, start, QUAD * k) for k, part in enumerate(parts)]
        return lines

    def _start(self, size: int, quad: int) -> str:
        """Return the text of the address at which row `quad` of the packet, four lanes, begins."""
        step = quad * size
        if self.lanes == self.columns:
            return f"a + {step * QUAD}" if step else "a"
        return f"a + {f'{step} * ' if step > 1 else ''}p.row" if step else "a"

    def _pairs(self, element: str, base: Base, places: list[str]) -> list[str]:
        half, lines = self.lanes // 2, []
        for part, first in (("lo", 0), ("hi", half)):
            loads = ", ".join(f"a[{place}]" for place in places[first : first + half])
            lines.append(f"{element}{self.lanes} {part} = ({element}{self.lanes})({loads});")
        for c, which in (("x", "even"), ("y", "odd")):
            vector = f"({element}{self.lanes})(lo.{which}, hi.{which})"
            lines.append(f"v.{c} = {self._loaded(vector, base)};")
        return lines

    def _quads(self, element: str, base: Base, size: int, places: list[str]) -> list[str]:
        """Return statements that load four packets, each with the rows of every fourth lane, and transpose them."""
        wide, lines = f"{element}{self.lanes}", []
        for k, part in enumerate(_PARTS):
            loads = ", ".join(f"a[{places[4 * g + k]}]" for g in range(self.lanes // 4))
            lines.append(f"{wide} {part} = ({wide})({loads});")
        return lines + self._transposed(element, base, size)

    def _transposed(self, element: str, base: Base, size: int) -> list[str]:
        """Return statements that make columns of rows within each group of four lanes, by unpacking twice."""
        lines = []
        for first, second in ("ab", "cd"):
            for part, (one, two) in (("lo", (0, 1)), ("hi", (2, 3))):
                picks = [(f"r{first}", one), (f"r{second}", one), (f"r{first}", two), (f"r{second}", two)]
                vector = self._shuffled(element, picks)
                lines.append(f"{element}{self.lanes} {part}_{first}{second} = {vector};")
        for component, c in enumerate(_XYZW[:size]):
            part, at = ("lo", "hi")[component // 2], 2 * (component % 2)
            picks = [(f"{part}_{pair}", at + k) for pair in ("ab", "cd") for k in (0, 1)]
            lines.append(f"v.{c} = {self._loaded(self._shuffled(element, picks), base)};")
        return lines
