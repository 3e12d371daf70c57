"""SHPY_DUMP=ir,vector,tree,source: print what the stages give, to standard error.

Stage: emit. `ir` is the module as it was recorded, `vector` what `vectorize` made of it, `tree` each
function of the output tree (see `tree_text.py`), `source` the emitted text.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable


def dump(stage: str, title: str, text: Callable[[], str]) -> None:
    """Print the text of a stage if SHPY_DUMP names it."""
    if stage in os.environ.get("SHPY_DUMP", "").replace(" ", "").split(","):
        print(f"--- {stage}: {title}\n{text()}", file=sys.stderr)
