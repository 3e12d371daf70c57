"""The prologue of trees: a program of two elements as kernels that fold and scan a stream, in packets.

Stage: emit. A work item takes `each` neighbouring elements, block after block. A block is a few packets, and a level of
the tree halves their number: the even lanes of two packets are combined with the odd ones. So the order is that of the
definition (`collectives.trees`), whatever the width, and a stream of few elements is one dispatch.

Memory limits the speed of sums. A processor's own prefetcher does not keep up with the branches between blocks, so each
loop prefetches what it reads some time later.

    print_trees(prepared.module, NodeTypes((F,), (F,), lifted=False), 16, Abilities()).text
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from importlib import resources
from typing import Final

import numpy as np

from shpy.backend.base import NodeTypes
from shpy.backend.opencl.packets.kernel import PacketMaker
from shpy.backend.opencl.packets.module import pack_parts
from shpy.backend.opencl.packets.prologue import Abilities, PacketPrologue
from shpy.backend.opencl.packets.prologue_memory import element_name, lane_of, spelled_wide
from shpy.backend.opencl.packets.prologue_packet import INLINE
from shpy.backend.opencl.packets.widen import Lanes, lanes_of, rows_of
from shpy.backend.opencl.text.kernel import KernelText
from shpy.ir.constants import DTYPES
from shpy.ir.nodes import Module
from shpy.ir.types import Base, Type

FOLD: Final = "sh_fold"
SCAN: Final = "sh_scan"
JOIN: Final = "sh_join"
_BLOCK_NUMBERS: Final = 1024
"""Numbers of a block: the nodes of its levels stay in the cache next to a core."""
_AHEAD: Final = 16384
"""Bytes between reading and prefetching in a loop: sums of ten million take 0.68 of the time (0.85 with 4,096)."""
_LINE: Final = 64
"""Bytes of a line of a cache."""

_PAIRS: Final = """\
// The lowest level of the tree, over two packets.
INLINE sh_node sh_lowest(GIVEN, ulong at) {
    sh_ahead(GIVEN_ARGS, at);
    return sh_neighbours(sh_packed(GIVEN_ARGS, at), sh_packed(GIVEN_ARGS, at + WIDTH));
}
"""
_EIGHTS: Final = """\
// The lowest level, over two packets. Within fours, lanes are picked without an instruction that crosses halves of a
// register.
INLINE sh_node sh_pairs(GIVEN, ulong at) {
    sh_ahead(GIVEN_ARGS, at);
    sh_node a = sh_packed(GIVEN_ARGS, at), b = sh_packed(GIVEN_ARGS, at + WIDTH);
    return sh_combine(sh_even_of_fours(a, b), sh_odd_of_fours(a, b));
}

// Two levels over four packets, whose numbers are sorted once.
INLINE sh_node sh_fours(GIVEN, ulong at) {
    sh_node a = sh_pairs(GIVEN_ARGS, at), b = sh_pairs(GIVEN_ARGS, at + 2 * WIDTH);
    sh_node fours = sh_combine(sh_even_of_fours(a, b), sh_odd_of_fours(a, b));
    return sh_sorted(fours, fours);
}

// The three lowest levels of the tree, over eight packets.
INLINE sh_node sh_lowest(GIVEN, ulong at) {
    return sh_neighbours(sh_fours(GIVEN_ARGS, at), sh_fours(GIVEN_ARGS, at + 4 * WIDTH));
}
"""
"""The lowest levels of a tree of scalars, in registers: on AVX2 a sum of ten million takes 0.93 of its time.

For nodes of several numbers the kernel would take longer to compile: 1.3 times with float4.
"""

# In these files GIVEN, MADE, OUT and ABOVE are the parameters of streams, and with _ARGS the arguments. WIDTH are the
# lanes.
_TREE, _SCAN, _JOIN = ((resources.files(__package__) / file).read_text() for file in ("fold.cl", "scan.cl", "join.cl"))


def tree_block(types: NodeTypes) -> int:
    """Return the number of elements of a block: a power of two, smaller if an element has many numbers."""
    numbers = sum(t.size for t in types.part)
    return max(64, _BLOCK_NUMBERS >> (numbers - 1).bit_length())


class TreePrologue:
    """The writer of the kernels that call a program of two nodes, whose numbers are packets."""

    def __init__(self, prologue: PacketPrologue, types: NodeTypes, *, joins: bool = False) -> None:
        """Write kernels for nodes of these types; with `joins` there is one that joins the parts, too."""
        self.prologue, self.node_types, self.lanes, self.joins = prologue, types, prologue.lanes, joins
        self.parts = [lanes_of(t.base, self.lanes) for t in types.part for _ in range(t.size)]
        self._scalar = len(self.parts) == 1

    def text(self, inner: str) -> str:
        """Return the kernels; `inner` names the program."""
        texts = [self._node(), self._calls(inner), self._reads(inner), self._ahead(), self._writes()]
        texts += [_EIGHTS if self._scalar else _PAIRS, _TREE]
        if not self.node_types.lifted:
            texts.append(_SCAN)
        if self.joins:
            texts.append(_JOIN)
        text = "\n".join(texts)
        for word, meant in self._words().items():
            text = re.sub(rf"\b{word}\b", meant, text)
        return text

    def _words(self) -> dict[str, str]:
        types = self.node_types
        lowest = (8 if self._scalar else 2) * self.lanes
        words = {"WIDTH": str(self.lanes), "LOWEST": str(lowest), "BLOCK": str(tree_block(types)), "INLINE": INLINE}
        for word, of, qualifier in (
            ("GIVEN", types.element, "const "),
            ("ABOVE", types.part, "const "),
            ("MADE", types.part, ""),
            ("OUT", types.part, ""),
        ):
            names = [f"{word.lower()}{k}" for k in range(len(of))]
            pairs = zip(of, names, strict=True)
            words[word] = ", ".join(f"__global {qualifier}{element_name(t.base)} *{name}" for t, name in pairs)
            words[f"{word}_ARGS"] = ", ".join(names)
        return words

    def _node(self) -> str:
        """Return the struct of a tree's node and the functions that pick lanes from nodes.

        The struct has a vector for each number of an element, with a component for each lane.
        """
        n = self.lanes
        fields = [f"    {spelled_wide(t)} part{k};" for k, t in enumerate(self.parts)]
        lines = ["// A node of the tree: one lane of each part.", "typedef struct {", *fields, "} sh_node;", ""]
        evens, odds = range(0, 2 * n, 2), range(1, 2 * n, 2)
        turns = [j + h * n for j in range(n) for h in (0, 1)]
        columns = [k + g for k in range(4) for g in range(0, n, 4)]
        fours = [(k, k + 2, n + k, n + k + 2) for k in range(0, n, 4)]
        picks: dict[str, tuple[str, Sequence[int]]] = {
            "even": ("The even lanes of two packets.", evens),
            "odd": ("The odd lanes of two packets.", odds),
        }
        if self._scalar:
            picks |= {
                "even_of_fours": ("The even lanes of each four of two packets.", [k for four in fours for k in four]),
                "odd_of_fours": ("The odd lanes of each four.", [k + 1 for four in fours for k in four]),
                "sorted": ("The first lanes of all fours, then the second ones, and so on.", columns),
            }
        if not self.node_types.lifted:
            picks |= {
                "low": ("The lanes of two packets alternately: the first half of the sequence.", turns[:n]),
                "high": ("The lanes of two packets alternately: the second half.", turns[n:]),
                "after": ("The last lane of one packet and all but the last one of the next.", range(n - 1, 2 * n - 1)),
            }
        for name, (told, lanes) in picks.items():
            lines += [f"// {told}", *self._picking(name, lanes)]
        first, zero = ([f"({spelled_wide(t)})({x})" for t, x in pairs] for pairs in self._plain_parts())
        mask = [f"convert_long{n}(mask)" if t.base is Base.D else "mask" for t in self.parts]
        chosen = [f"{m} ? a.part{k} : b.part{k}" for k, m in enumerate(mask)]
        lines += self._making("The node of the first lane in all.", "first", "sh_node a", first)
        lines += self._making("Zeros.", "nothing", "", zero)
        lines += self._making(
            "One node where the mask is set, and else the other.",
            "chosen",
            f"int{n} mask, sh_node a, sh_node b",
            chosen,
        )
        numbers = ", ".join(map(str, range(n)))
        return "\n".join([*lines, f"INLINE int{n} sh_lanes() {{", f"    return (int{n})({numbers});", "}", ""])

    def _plain_parts(self) -> tuple[list[tuple[Type, str]], list[tuple[Type, str]]]:
        return [(t, f"a.part{k}.s0") for k, t in enumerate(self.parts)], [(t, "0") for t in self.parts]

    def _making(self, told: str, name: str, parameters: str, values: Sequence[str]) -> list[str]:
        return [f"// {told}", f"INLINE sh_node sh_{name}({parameters}) {{", *_filled(values), "}", ""]

    def _picking(self, name: str, lanes: Sequence[int]) -> list[str]:
        """Return a function that picks lanes of two packets; numbers from the width on are lanes of the second one."""
        values = []
        for k, type in enumerate(self.parts):
            a, b = f"a.part{k}", f"b.part{k}"
            if self.prologue.abilities.shuffle:
                values.append(f"__builtin_shufflevector({a}, {b}, {', '.join(map(str, lanes))})")
            else:
                n = self.lanes
                picked = (f"{a}{lane_of(i, n)}" if i < n else f"{b}{lane_of(i - n, n)}" for i in lanes)
                values.append(f"({spelled_wide(type)})({', '.join(picked)})")
        return self._making("", name, "sh_node a, sh_node b", values)[1:]

    def _calls(self, inner: str) -> str:
        """Return `sh_combine`, and `sh_neighbours`, which combines neighbouring lanes of two packets."""
        parts = [f"{name}.part{k}" for name in "ab" for k in range(len(self.parts))]
        lifted = self.node_types.lifted
        element_arguments = self._zeros(self.node_types.element) + [f"(int{self.lanes})(0)"] if lifted else []
        arguments = [*element_arguments, *self._rows(parts, self.node_types.part * 2)]
        return "\n".join([
            "INLINE sh_node sh_combine(sh_node a, sh_node b) {",
            *self._called(inner, arguments, last=True),
            "}",
            "",
            "// Combine neighbours: the even lanes with the odd ones.",
            "INLINE sh_node sh_neighbours(sh_node a, sh_node b) {",
            "    return sh_combine(sh_even(a, b), sh_odd(a, b));",
            "}",
            "",
        ])  # fmt: skip

    def _called(self, inner: str, arguments: Sequence[str], *, last: bool) -> list[str]:
        """Return lines that call the program and return the last node of its results, or the first one."""
        targets = [f"&made.part{k}" for k in range(len(self.parts))]
        if self.node_types.lifted:
            unused = [f"&unused.part{k}" for k in range(len(self.parts))]
            outputs = [*unused, *targets] if last else [*targets, *unused]
            call = f"    {inner}({', '.join([*arguments, *outputs])});"
            return ["    sh_node made, unused;", call, "    return made;"]
        if len(targets) > 1:
            return ["    sh_node made;", f"    {inner}({', '.join([*arguments, *targets])});", "    return made;"]
        return ["    sh_node made;", f"    made.part0 = {inner}({', '.join(arguments)});", "    return made;"]

    def _reads(self, inner: str) -> str:
        """Return `sh_given` and `sh_made`, which read nodes of elements, or of parts, from `first` to before `end`.

        `sh_packed` reads the nodes of elements that are a whole packet.
        """
        types = self.node_types
        lines, numbers = self._leaves("given", types.element)
        if types.lifted:
            leaves = [f"element{k}" for k in range(len(types.element))]
            arguments = [*leaves, "(int)first + sh_lanes()", *self._zeros(types.part * 2)]
            statements = self._called(inner, arguments, last=False)
        else:
            statements = _filled(numbers)
        text = self._reading("elements", "given", [*lines, *statements])
        text += "\n".join([
            "// The nodes of the elements from `first` on, as many as a packet has.",
            "INLINE sh_node sh_packed(GIVEN, ulong first) {",
            "    sh_packet packet = sh_packet_at(0, WIDTH);",
            "    packet.first = first;",
            *lines,
            *statements,
            "}",
            "",
            "",
        ])  # fmt: skip
        lines, numbers = self._leaves("made", types.part)
        return text + self._reading("parts", "made", [*lines, *_filled(numbers)])

    def _reading(self, of: str, name: str, lines: Sequence[str]) -> str:
        return "\n".join([
            f"// The nodes of the {of} from `first` on that stand before `end`.",
            f"INLINE sh_node sh_{name}({name.upper()}, ulong first, ulong end) {{",
            "    sh_packet packet = sh_packet_at(first, end);",
            *lines,
            "}",
            "",
            "",
        ])  # fmt: skip

    def _leaves(self, name: str, types: Sequence[Type]) -> tuple[list[str], list[str]]:
        """Return the lines that read the leaves of a packet of elements, and the names of their numbers."""
        lines, numbers = [], []
        for k, type in enumerate(types):
            wide = spelled_wide(rows_of(type.base, type.size, self.lanes))
            read = self.prologue.memory("read", type.base, type.size)
            lines.append(f"    {wide} element{k} = {read}({name}{k}, 1, packet);")
            numbers += [f"element{k}"] if type.size == 1 else [f"element{k}.{c}" for c in "xyzw"[: type.size]]
        return lines, numbers

    def _ahead(self) -> str:
        """Return `sh_ahead`, which prefetches two packets of elements some distance after a place."""
        asked = []
        for k, type in enumerate(self.node_types.element):
            each = np.dtype(DTYPES[type.base]).itemsize
            for byte in range(0, 2 * self.lanes * type.size * each, _LINE):
                place = f"given{k} + at{f' * {type.size}' if type.size > 1 else ''} + {(_AHEAD + byte) // each}"
                asked.append(f"    __builtin_prefetch({place});")
        return "\n".join([
            "// Ask for the lines of two packets that are read some time later.",
            "INLINE void sh_ahead(GIVEN, ulong at) {",
            "#ifdef __has_builtin",
            "#if __has_builtin(__builtin_prefetch)",
            *asked,
            "#endif",
            "#endif",
            "}",
            "",
        ])  # fmt: skip

    def _writes(self) -> str:
        """Return `sh_write`, which writes the nodes into the elements from `first` on that stand before `end`."""
        types = self.node_types.part
        values = self._rows([f"made.part{k}" for k in range(len(self.parts))], types)
        lines = [
            f"    {self.prologue.memory('write', t.base, t.size)}(out{k}, {value}, packet);"
            for k, (t, value) in enumerate(zip(types, values, strict=True))
        ]
        head = "INLINE void sh_write(OUT, sh_node made, ulong first, ulong end) {"
        return "\n".join([head, "    sh_packet packet = sh_packet_at(first, end);", *lines, "}", ""])

    def _rows(self, parts: Sequence[str], types: Sequence[Type]) -> list[str]:
        """Return the parts as leaves; the parts of a vector form one struct."""
        rows, rest = [], iter(parts)
        for t in types:
            of = [next(rest) for _ in range(t.size)]
            rows.append(of[0] if t.size == 1 else f"({self._wide_name(t)}){{{', '.join(of)}}}")
        return rows

    def _wide_name(self, type: Type) -> str:
        rows = rows_of(type.base, type.size, self.lanes)
        return self.prologue.struct(rows) if type.size > 1 else spelled_wide(rows)

    def _zeros(self, types: Sequence[Type]) -> list[str]:
        zero = [f"({spelled_wide(lanes_of(t.base, self.lanes))})(0)" for t in types for _ in range(t.size)]
        return self._rows(zero, types)


def _filled(values: Sequence[str]) -> list[str]:
    """Return the lines that make a node of these values and return it."""
    stores = [f"    made.part{k} = {value};" for k, value in enumerate(values)]
    return ["    sh_node made;", *stores, "    return made;"]


def print_trees(
    module: Module,
    types: NodeTypes,
    lanes: int,
    abilities: Abilities,
    *,
    joins: bool = False,
    faults: Collection[str] = (),
) -> KernelText | None:
    """Return the kernels of a prepared program of two nodes; None with tables, params, binary16 or uniform outputs.

    The inputs are the parts of two nodes, and the outputs are those of one. If elements are lifted, an element and its
    index precede these inputs, and the node of that element precedes the result. `joins`: see `TreePrologue`;
    `faults`: see `print_packets`.
    """
    if module.tables or module.params or any(t.base is Base.H for t in (*types.element, *types.part)):
        return None
    packets = pack_parts(module, lanes, faults)
    if not all(isinstance(o.type, Lanes) for o in packets.module.entry.outputs):
        return None
    maker = PacketMaker(packets, abilities, faults=faults)
    return maker.kernels_around(TreePrologue(maker.prologue, types, joins=joins).text)
