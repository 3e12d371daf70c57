"""The table of operations as Markdown: docs/numerics.md shows it, docs/language.md the functions that users call.

`scripts/test tests/test_documentation.py --update-snapshots` writes them.
"""

from __future__ import annotations

from collections.abc import Sequence

from shpy.ir.ops import OPS, Op, Tolerance


def table_of_operations() -> str:
    """Return one row an operation, in the order of the table."""
    rows: list[tuple[str, ...]] = [("operation", "types", "exact meaning", "strict", "portable", "relaxed", "f64")]
    rows += [(_name(op), f"`{op.signature}`", op.doc, *map(_spoken, _bounds(op))) for op in OPS.values()]
    return _table(rows)


def table_of_functions() -> str:
    """Return one row for each operation that users call by its name."""
    rows = [("function", "what it does")]
    rows += [
        (f"`sh.{op.name}({', '.join(op.parameters)})`", op.says.removeprefix("Return "))
        for op in OPS.values()
        if op.says
    ]
    return _table(rows)


def _table(rows: Sequence[tuple[str, ...]]) -> str:
    head, *rest = rows
    rows = (head, ("---",) * len(head), *rest)
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in rows)


def _name(op: Op) -> str:
    return f"`{op.name}` (`{op.symbol}`)" if op.symbol else f"`{op.name}`"


def _bounds(op: Op) -> tuple[Tolerance, ...]:
    """Return what is allowed in strict, portable and relaxed mode, and at f64."""
    return op.tolerance, op.portable, op.relaxed, op.double


def _spoken(bound: Tolerance) -> str:
    parts = [f"{bound.ulp:.7g} ULP"] if bound.ulp else []
    parts += [f"{bound.absolute:g}"] if bound.absolute else []
    return " or ".join(parts) or "nothing"
