"""Python's own parser, for several threads.

Stage: record, and emit for numpy. CPython (3.11 among others) counts the depth of the trees that it makes for all
threads together. Where threads change while a tree is made, as a callback of the garbage collector lets them, the count
does not match, and `ast.parse` raises SystemError for a text without fault.

    parse("a + b", "eval").body
"""

from __future__ import annotations

import ast
import threading
from typing import Any, Final

_LOCK: Final = threading.RLock()  # a callback of the garbage collector may record
_ATTEMPTS: Final = 20
"""Attempts for a text, since threads that are not of this package parse too."""


def parse(text: str, mode: str = "exec") -> Any:
    """Return the tree of a text: ast.Module, or ast.Expression for the mode "eval". Raises what `ast.parse` raises."""
    with _LOCK:
        for _ in range(_ATTEMPTS - 1):
            try:
                return ast.parse(text, mode=mode)
            except SystemError:
                continue
        return ast.parse(text, mode=mode)
