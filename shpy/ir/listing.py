"""The table of operations as Markdown: what docs/numerics.md shows.

Stage: represent. Takes `ops.OPS`, gives text.

>>> print(table_of_operations().splitlines()[0])
| operation | types | exact meaning | strict | relaxed |
"""

from __future__ import annotations

from shpy.ir.ops import OPS, Op, Tolerance


def table_of_operations() -> str:
    """One row an operation, in the order of the table."""
    rows = [("operation", "types", "exact meaning", "strict", "relaxed"), ("---",) * 5]
    rows += [
        (_name(op), f"`{op.signature}`", op.doc, _spoken(op.tolerance), _spoken(op.relaxed)) for op in OPS.values()
    ]
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in rows)


def _name(op: Op) -> str:
    return f"`{op.name}` (`{op.symbol}`)" if op.symbol else f"`{op.name}`"


def _spoken(bound: Tolerance) -> str:
    parts = [f"{bound.ulp:g} ULP"] if bound.ulp else []
    parts += [f"{bound.absolute:g}"] if bound.absolute else []
    return " or ".join(parts) or "nothing"
