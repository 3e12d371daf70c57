"""The prologue of trees: a program of two elements as kernels that fold and scan a stream, in packets.

Stage: emit. A work item takes `each` neighbouring elements, block after block. A block is a few packets, and a level of
the tree halves their number: the even lanes of two packets are combined with the odd ones. So the order is that of the
definition (`collectives.trees`), whatever the width, and a stream of few elements is one dispatch.

Memory limits the speed of sums. A processor's own prefetcher does not keep up with the branches between blocks, so each
loop prefetches what it reads some time later.

    TreePrologue(maker.prologue, NodeTypes((F,), (F,), lifted=False)).text("add_pairs")
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

import numpy as np

from shpy.backends.base import NodeTypes
from shpy.backends.opencl.packets.prologue import PacketPrologue
from shpy.backends.opencl.packets.prologue_memory import INLINE, element_name, lane_of, spelled_wide
from shpy.backends.opencl.packets.widen import lanes_of, rows_of
from shpy.ir.constants import DTYPES
from shpy.ir.types import Base, Type

FOLD: Final = "sh_fold"
SCAN: Final = "sh_scan"
_BLOCK_NUMBERS: Final = 1024
"""Numbers of a block: the nodes of its levels stay in the cache next to a core."""
_AHEAD: Final = 16384
"""Bytes between reading and prefetching in a loop: sums of ten million take 0.68 of the time (0.85 with 4,096)."""
_LINE: Final = 64
"""Bytes of a line of a cache."""

# GIVEN, MADE, OUT and ABOVE are the parameters of streams, and with _ARGS the arguments. WIDTH are the lanes.
_TREE: Final = """\
// The tree over two packets of which `left` elements count: an odd last one passes unchanged.
INLINE sh_node sh_halve(sh_node a, sh_node b, int left) {
    sh_node even = sh_even(a, b);
    sh_node both = sh_combine(even, sh_odd(a, b));
    return left & 1 ? sh_chosen(sh_lanes() == left / 2, even, both) : both;
}

// The tree over a part of a block, in the first lane: of `left` elements from `first` on.
INLINE sh_node sh_tree(GIVEN, ulong first, int left) {
    sh_node node[BLOCK / (2 * WIDTH)];
    int pairs = left / (2 * WIDTH), rest = left % (2 * WIDTH);
    for (int k = 0; k < pairs; k += 1) {
        ulong at = first + k * (2 * WIDTH);
        node[k] = sh_neighbours(sh_given(GIVEN_ARGS, at, at + WIDTH), sh_given(GIVEN_ARGS, at + WIDTH, at + 2 * WIDTH));
    }
    if (rest != 0) {
        ulong at = first + left - rest, end = first + left;
        sh_node a = sh_given(GIVEN_ARGS, at, end), b = a;
        if (rest > WIDTH) {
            b = sh_given(GIVEN_ARGS, at + WIDTH, end);
        }
        node[pairs] = sh_halve(a, b, rest);
    }
    for (left = (left + 1) / 2; left > 1; left = (left + 1) / 2) {
        int pairs = left / (2 * WIDTH), rest = left % (2 * WIDTH);
        for (int k = 0; k < pairs; k += 1) {
            node[k] = sh_neighbours(node[2 * k], node[2 * k + 1]);
        }
        if (rest != 0) {
            node[pairs] = sh_halve(node[2 * pairs], node[2 * pairs + (rest > WIDTH)], rest);
        }
    }
    return node[0];
}

// The tree over a block, up to the level that is one packet.
INLINE sh_node sh_whole(GIVEN, ulong first) {
    sh_node node[BLOCK / (2 * WIDTH)];
    for (int k = 0; k < BLOCK / (2 * WIDTH); k += 1) {
        ulong at = first + k * (2 * WIDTH);
        sh_ahead(GIVEN_ARGS, at);
        node[k] = sh_neighbours(sh_given(GIVEN_ARGS, at, at + WIDTH), sh_given(GIVEN_ARGS, at + WIDTH, at + 2 * WIDTH));
    }
    for (int width = BLOCK / (4 * WIDTH); width > 0; width /= 2) {
        for (int k = 0; k < width; k += 1) {
            node[k] = sh_neighbours(node[2 * k], node[2 * k + 1]);
        }
    }
    return node[0];
}

// The tree over elements. `waiting` holds a packet for each bit of the number of whole blocks that are done.
INLINE sh_node sh_range(GIVEN, ulong at, ulong end) {
    sh_node waiting[64], made;
    uint blocks = 0;
    for (; at + BLOCK <= end; at += BLOCK) {
        int level = 0;
        made = sh_whole(GIVEN_ARGS, at);
        for (uint done = blocks; done & 1; done >>= 1) {
            made = sh_neighbours(waiting[level], made);
            level += 1;
        }
        waiting[level] = made;
        blocks += 1;
    }
    bool some = at < end;
    if (some) {
        made = sh_tree(GIVEN_ARGS, at, (int)(end - at));
    }
    for (int level = 0; blocks >> level != 0; level += 1) {
        if (blocks >> level & 1) {
            sh_node whole = waiting[level];
            for (int lanes = WIDTH; lanes > 1; lanes /= 2) {
                whole = sh_neighbours(whole, whole);
            }
            made = some ? sh_combine(whole, made) : whole;
            some = true;
        }
    }
    return made;
}

// Combine a node with those that wait for it. `waiting` holds a node for each bit of the number of those `before`.
INLINE void sh_wait(sh_node *waiting, uint before, sh_node made) {
    int level = 0;
    for (; before & 1; before >>= 1) {
        made = sh_combine(waiting[level], made);
        level += 1;
    }
    waiting[level] = made;
}

// The tree over the nodes of parts, in each lane.
INLINE sh_node sh_joined(MADE, uint parts) {
    sh_node waiting[32], made;
    for (uint part = 0; part < parts; part += 1) {
        sh_wait(waiting, part, sh_first(sh_made(MADE_ARGS, part, part + 1)));
    }
    bool some = false;
    for (int level = 0; parts >> level != 0; level += 1) {
        if (parts >> level & 1) {
            made = some ? sh_combine(waiting[level], made) : waiting[level];
            some = true;
        }
    }
    return made;
}

// The tree over each part of `each` elements. `done` counts the finished parts: the work item that finishes the last
// one continues with the tree over all parts, and resets the counter to 0.
__kernel void sh_fold(GIVEN, ulong count, ulong each, MADE, __global volatile uint *done, OUT) {
    ulong part = get_global_id(0), at = part * each;
    uint parts = get_global_size(0);
    sh_write(MADE_ARGS, sh_range(GIVEN_ARGS, at, min(count, at + each)), part, part + 1);
    if (done) {
        mem_fence(CLK_GLOBAL_MEM_FENCE);
        if (atomic_inc(done) == parts - 1) {
            mem_fence(CLK_GLOBAL_MEM_FENCE);
            *done = 0;
            sh_write(OUT_ARGS, sh_joined(MADE_ARGS, parts), 0, 1);
        }
    }
}
"""
_SCAN: Final = """\
// The prefixes of the even nodes of a level: each combines the prefix of the odd node before it with its own value.
// `through` are the prefixes of the odd nodes, and `before` ends with the prefix before them.
INLINE sh_node sh_evens(sh_node before, sh_node through, sh_node even, bool begins) {
    sh_node both = sh_combine(sh_after(before, through), even);
    return begins ? sh_chosen(sh_lanes() == 0, even, both) : both;
}

// Fills the levels above the packets of a block and returns the last level. Nodes after the last element are undefined.
INLINE sh_node *sh_up(sh_node *level, int packets) {
    for (int width = BLOCK / WIDTH; width > 1; width /= 2) {
        for (int k = 0; 2 * k < packets; k += 1) {
            level[width + k] = sh_neighbours(level[2 * k], level[min(2 * k + 1, packets - 1)]);
        }
        level += width;
        packets = (packets + 1) / 2;
    }
    for (int lanes = WIDTH; lanes > 1; lanes /= 2) {
        level[1] = sh_neighbours(level[0], level[0]);
        level += 1;
    }
    return level;
}

// Replace the nodes of all levels by their prefixes, from the last one on. `before` is the prefix that ends before
// the block, unless the block `begins` the stream, and `through` the one that ends with it.
INLINE void sh_down(sh_node *level, int packets, sh_node before, sh_node through, bool begins) {
    *level = through;
    for (int lanes = WIDTH; lanes > 1; lanes /= 2) {
        level -= 1;
        level[0] = sh_low(sh_evens(before, level[1], sh_even(level[0], level[0]), begins), level[1]);
    }
    for (int width = 2; width <= BLOCK / WIDTH; width *= 2) {
        sh_node *parents = level, last = before;
        int under = BLOCK / WIDTH / width, here = (packets + under - 1) / under;
        level -= width;
        for (int k = 0; 2 * k < here; k += 1) {
            sh_node parent = parents[k], even = sh_even(level[2 * k], level[min(2 * k + 1, here - 1)]);
            even = sh_evens(last, parent, even, begins && k == 0);
            level[2 * k] = sh_low(even, parent);
            level[2 * k + 1] = sh_high(even, parent);
            last = parent;
        }
    }
}

// The prefixes of `each` elements, shifted by one place if `exclusive`. If there are several parts of `each` elements,
// `above` holds the prefix that ends with each part.
__kernel void sh_scan(GIVEN, ulong count, ulong each, int parts, int exclusive, ABOVE, OUT) {
    ulong part = get_global_id(0), first = part * each, end = min(count, first + each);
    sh_node node[2 * BLOCK / WIDTH + 4], waiting[64], outer = sh_nothing();
    uint blocks = 0;
    if (part > 0) {
        outer = sh_first(sh_given(ABOVE_ARGS, part - 1, part));
    }
    if (part == 0 && exclusive) {
        sh_write(OUT_ARGS, outer, 0, 1);
    }
    sh_node before = outer;
    for (ulong at = first; at < end; at += BLOCK) {
        int left = (int)min(end - at, (ulong)BLOCK), packets = (left + WIDTH - 1) / WIDTH;
        for (int k = 0; k < packets; k += 1) {
            node[k] = sh_given(GIVEN_ARGS, at + k * WIDTH, count);
        }
        sh_node *root = sh_up(node, packets), through = outer;
        sh_wait(waiting, blocks, *root);
        blocks += 1;
        bool some = part > 0;
        for (int level = 31 - clz(blocks); level >= 0; level -= 1) {
            if (blocks >> level & 1) {
                through = some ? sh_combine(through, waiting[level]) : waiting[level];
                some = true;
            }
        }
        through = sh_first(parts > 1 && at + BLOCK == first + each ? sh_given(ABOVE_ARGS, part, part + 1) : through);
        sh_down(root, packets, before, through, at == 0);
        for (int k = 0; k < packets; k += 1) {
            sh_write(OUT_ARGS, node[k], at + k * WIDTH + exclusive, count);
        }
        before = through;
    }
}
"""


def tree_block(types: NodeTypes) -> int:
    """Return the number of elements of a block: a power of two, smaller if an element has many numbers."""
    numbers = sum(t.size for t in types.made)
    return max(64, _BLOCK_NUMBERS >> (numbers - 1).bit_length())


class TreePrologue:
    """The writer of the kernels that call a program of two nodes, whose numbers are packets."""

    def __init__(self, prologue: PacketPrologue, types: NodeTypes) -> None:
        self.prologue, self.node_types, self.lanes = prologue, types, prologue.lanes
        self.parts = [lanes_of(t.base, self.lanes) for t in types.made for _ in range(t.size)]

    def text(self, inner: str) -> str:
        """Return the kernels; `inner` names the program."""
        texts = [self._node(), self._calls(inner), self._reads(inner), self._ahead(), self._writes(), _TREE]
        if not self.node_types.lifted:
            texts.append(_SCAN)
        text = "\n".join(texts)
        for word, meant in self._words().items():
            text = re.sub(rf"\b{word}\b", meant, text)
        return text

    def _words(self) -> dict[str, str]:
        types = self.node_types
        words = {"WIDTH": str(self.lanes), "BLOCK": str(tree_block(types)), "INLINE": INLINE}
        for word, of, qualifier in (
            ("GIVEN", types.element, "const "),
            ("ABOVE", types.made, "const "),
            ("MADE", types.made, ""),
            ("OUT", types.made, ""),
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
        picks = {
            "even": ("The even lanes of two packets.", evens),
            "odd": ("The odd lanes of two packets.", odds),
            "low": ("The lanes of two packets alternately: the first half of the sequence.", turns[:n]),
            "high": ("The lanes of two packets alternately: the second half.", turns[n:]),
            "after": ("The last lane of one packet and all but the last one of the next.", range(n - 1, 2 * n - 1)),
        }
        for name, (told, lanes) in picks.items():
            if name in ("even", "odd") or not self.node_types.lifted:
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
        given = self._zeros(self.node_types.element) + [f"(int{self.lanes})(0)"] if lifted else []
        arguments = [*given, *self._rows(parts, self.node_types.made * 2)]
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
        made = [f"&made.part{k}" for k in range(len(self.parts))]
        if self.node_types.lifted:
            unused = [f"&unused.part{k}" for k in range(len(self.parts))]
            outputs = [*unused, *made] if last else [*made, *unused]
            call = f"    {inner}({', '.join([*arguments, *outputs])});"
            return ["    sh_node made, unused;", call, "    return made;"]
        if len(made) > 1:
            return ["    sh_node made;", f"    {inner}({', '.join([*arguments, *made])});", "    return made;"]
        return ["    sh_node made;", f"    made.part0 = {inner}({', '.join(arguments)});", "    return made;"]

    def _reads(self, inner: str) -> str:
        """Return `sh_given` and `sh_made`, which read nodes of elements, or of parts, from `first` to before `end`."""
        types = self.node_types
        lines, numbers = self._leaves("given", types.element)
        if types.lifted:
            leaves = [f"element{k}" for k in range(len(types.element))]
            arguments = [*leaves, "(int)first + sh_lanes()", *self._zeros(types.made * 2)]
            made = self._called(inner, arguments, last=False)
        else:
            made = _filled(numbers)
        given = self._reading("elements", "given", [*lines, *made])
        lines, numbers = self._leaves("made", types.made)
        return given + self._reading("parts", "made", [*lines, *_filled(numbers)])

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
        types = self.node_types.made
        values = self._rows([f"made.part{k}" for k in range(len(self.parts))], types)
        lines = [
            f"    {self.prologue.memory('write', t.base, t.size)}(out{k}, {value}, packet);"
            for k, (t, value) in enumerate(zip(types, values, strict=True))
        ]
        head = "INLINE void sh_write(OUT, sh_node made, ulong first, ulong end) {"
        return "\n".join([head, "    sh_packet packet = sh_packet_at(first, end);", *lines, "}", ""])

    def _rows(self, parts: Sequence[str], types: Sequence[Type]) -> list[str]:
        """Return the parts as leaves; the parts of a vector form one struct."""
        found, rest = [], iter(parts)
        for t in types:
            of = [next(rest) for _ in range(t.size)]
            found.append(of[0] if t.size == 1 else f"({self._wide_name(t)}){{{', '.join(of)}}}")
        return found

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
