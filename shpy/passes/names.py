"""Free names for the functions that passes make.

Stage: improve.

>>> taken = {"tone"}
>>> fresh("tone", taken), fresh("tone", taken), fresh("dot3", taken)
('tone_2', 'tone_3', 'dot3')
"""

from __future__ import annotations


def fresh(name: str, taken: set[str]) -> str:
    """Return the name, or the first of name_2, name_3, ... that is free; from now on it is taken."""
    found, number = name, 2
    while found in taken:
        found, number = f"{name}_{number}", number + 1
    taken.add(found)
    return found
