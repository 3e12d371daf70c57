"""Free names, for the functions that passes make, and for what programs declare.

>>> free("tone", {"tone", "tone_2"})
'tone_3'
>>> names = {"tone"}
>>> fresh("tone", names), fresh("tone", names), fresh("dot3", names)
('tone_2', 'tone_3', 'dot3')
"""

from __future__ import annotations

from collections.abc import Container


def free(name: str, names: Container[str]) -> str:
    """Return the name, or the first of name_2, name_3, ... that is not among the names."""
    candidate, number = name, 2
    while candidate in names:
        candidate, number = f"{name}_{number}", number + 1
    return candidate


def fresh(name: str, names: set[str]) -> str:
    """Return a free name, which the names have from now on."""
    candidate = free(name, names)
    names.add(candidate)
    return candidate
