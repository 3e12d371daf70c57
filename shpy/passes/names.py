"""Free names for the functions that passes make.

Stage: improve.

>>> names = {"tone"}
>>> fresh("tone", names), fresh("tone", names), fresh("dot3", names)
('tone_2', 'tone_3', 'dot3')
"""

from __future__ import annotations


def fresh(name: str, names: set[str]) -> str:
    """Return the name, or the first of name_2, name_3, ... that is free; from now on it is taken."""
    candidate, number = name, 2
    while candidate in names:
        candidate, number = f"{name}_{number}", number + 1
    names.add(candidate)
    return candidate
