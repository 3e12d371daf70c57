"""Exchanges of fields, `r.o, r.d = r.d, r.o`: an error, since the first store changes what the second one stores.

Stage: record. `r.d` on the right is the field itself, as an array of numpy is, and Python stores from left to right.
"""

from __future__ import annotations

import ast
import itertools
from collections.abc import Sequence

from shpy.lang.mistakes import findings
from shpy.lang.recording.location import here, user_frame
from shpy.lang.recording.recorder import current_frame
from shpy.lang.recording.text import Text
from shpy.lang.values.value import Value


def check_exchange(field: Sequence[Value], value: Sequence[Value]) -> None:
    """Raise RecordError if a store into a field takes what the same execution of one assignment has stored into."""
    frame, user, loc = current_frame(), user_frame(), here()
    if frame is None or user is None or loc is None:
        return
    at, stored = frame.fields_stored
    if user.f_lasti <= at:  # Python has gone back, or into another function
        stored = {}
    for earlier in {stored[v._variable] for v in value if v._variable in stored}:
        tree = loc.text.tree if loc.text is not None and earlier.text is loc.text else None
        for node in ast.walk(tree) if tree is not None else ():
            if isinstance(node, ast.Assign) and node.lineno <= earlier.line and loc.line <= (node.end_lineno or 0):
                _refuse(loc.text, node)
    frame.fields_stored = user.f_lasti, stored
    stored.update((v._variable, loc) for v in field)


def _refuse(text: Text, node: ast.Assign) -> None:
    """Raise the error for an assignment of several values to several targets; accept any other."""
    targets, values = node.targets[0], node.value
    if not (isinstance(targets, ast.Tuple | ast.List) and isinstance(values, ast.Tuple | ast.List)):
        return
    pairs = list(zip(map(ast.unparse, targets.elts), map(ast.unparse, values.elts), strict=False))
    for first, later in itertools.combinations(range(len(pairs)), 2):
        if pairs[first][0] == pairs[later][1]:
            whole = len(pairs) == 2 and pairs[0] == pairs[1][::-1]
            swap = (pairs[0][0], pairs[1][0]) if whole else None
            raise findings.crossed(text, node, pairs[first][0], targets.elts[later], swap, "sh.")
