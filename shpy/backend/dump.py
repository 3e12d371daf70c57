"""SHPY_DUMP=ir,vector,tree,source: print the results of the stages to standard error.

Stage: emit. `ir` is the module as it was recorded, `vector` what `vectorize` made of it, `tree` each
function of the output tree (see `emit/spell_tree.py`), `source` the emitted text.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import cache

from shpy.errors import warn

STAGES = ("ir", "vector", "tree", "source")


def dump(stage: str, title: str, text: Callable[[], str]) -> None:
    """Print the text of a stage if SHPY_DUMP names it."""
    if stage in _chosen_stages(os.environ.get("SHPY_DUMP", "")):
        print(f"--- {stage}: {title}\n{text()}", file=sys.stderr)


@cache
def _chosen_stages(text: str) -> frozenset[str]:
    """Return the stages that a value of SHPY_DUMP names; warn of others."""
    names = frozenset(text.replace(" ", "").split(",")) - {""}
    if others := sorted(names.difference(STAGES)):
        warn(f"SHPY_DUMP names {', '.join(others)}, and the stages are {', '.join(STAGES)}")
    return names
