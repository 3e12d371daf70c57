"""The prologue of a packet's kernel: the struct of a packet, and the functions that find and make that of a work item.

Stage: emit. A packet is one row of elements, or a few rows that are `row` elements apart; or a part of a list.

    block_packet(32, 32, 64)        # up to 64 packets of a line for each work item
"""

from __future__ import annotations

from typing import Final

INLINE: Final = "__attribute__((always_inline))"
"""The attribute of functions that take a packet, which fills many registers, or an array meant for registers."""


def list_packet(lanes: int) -> str:
    """Return the struct of a packet of a list, and the function that makes it."""
    return f"""\
// The elements of a packet: {lanes} that follow one another in a list, or as many as are `left` at its end.
typedef struct {{
    size_t first;
    int left;
    int{lanes} active;
}} sh_packet;

// The packet that begins with the element `first`.
{INLINE} sh_packet sh_packet_at(size_t first, ulong count) {{
    sh_packet p;
    p.first = first;
    p.left = first < count ? (int)min(count - first, (ulong){lanes}) : 0;
    p.active = (int{lanes})({", ".join(map(str, range(lanes)))}) < p.left;
    return p;
}}"""


def block_packet(lanes: int, wide: int, packets: int) -> str:
    """Return the struct of a packet of rows of `wide` elements, and the functions that find and make it.

    A work item computes one packet, or up to `packets` that follow one another in a line.
    """
    rows = lanes // wide
    columns = ", ".join(str(k % wide) for k in range(lanes))
    lines = ", ".join(str(k // wide) for k in range(lanes))
    by_rows = f" * {rows}" if rows > 1 else ""
    below, line = (f" + row * (int{lanes})({lines})", f"y + (int{lanes})({lines})") if rows > 1 else ("", "y")
    inside, whole = (", bool inside", "inside || ") if packets > 1 else ("", "")
    last = {1: "", 2: "row + "}.get(rows, f"{rows - 1} * row + ")
    return f"""\
// The elements of a packet: {rows} row{"s" if rows > 1 else ""} of {wide} in an array that is `row` wide.
// Each lane holds the element `first + at`, which is in column x of line y.
typedef struct {{
    size_t first;
    int row;
    int{lanes} at;
    int{lanes} x;
    int{lanes} y;
    int{lanes} active;
    bool whole;
    bool empty;
}} sh_packet;

{_in_line(wide, packets) if packets > 1 else _corner(wide, by_rows)}

// The packet that begins there; the last one of a row, and the last row, may hold fewer elements.
{INLINE} sh_packet sh_packet_at(int2 corner, ulong count, int row{inside}) {{
    int x = corner.x, y = corner.y;
    sh_packet p;
    p.first = (size_t)y * row + x;
    p.row = row;
    p.empty = p.first >= count || x >= row;
    int left = (int)min(count - p.first, (ulong)INT_MAX);
    p.x = (int{lanes})({columns});
    p.at = p.x{below};
    p.active = (p.x < row - x) & (p.at < left);
    p.whole = {whole}x + {wide} <= row && left > {last}{wide - 1};
    p.at &= p.active;
    p.x += x;
    p.y = {line};
    return p;
}}"""


def _corner(wide: int, by_rows: str) -> str:
    """Return the function that finds the packet of a work item."""
    moved_i, moved_j = ("(first + i)", "(first + j)") if by_rows else ("first + i", "first + j")
    return f"""\
// The column and line at which this work item's packet begins. The dispatch begins with packet, or line, `first`.
{INLINE} int2 sh_corner(int first, int row) {{
    int i = get_global_id(0), j = get_global_id(1);
    return row == {wide} ? (int2)(0, {moved_i}{by_rows}) : (int2)(i * {wide}, {moved_j}{by_rows});
}}"""


def _in_line(wide: int, packets: int) -> str:
    """Return the functions that find the packets of a work item, which follow one another in a line."""
    most = packets * wide
    return f"""\
// The column and line at which this work item's packets begin: {packets} of a line, or as many as are left of it.
{INLINE} int2 sh_corner(int first, int row) {{
    int i = first + get_global_id(0), parts = (row - 1) / {most} + 1;
    return (int2)(i % parts * {most}, i / parts);
}}

// The column behind these packets, or 0 if there is no such line.
{INLINE} int sh_end(int2 corner, ulong count, int row) {{
    return (ulong)corner.y * row < count ? min(row, corner.x + {most}) : 0;
}}"""
