"""The conformance list.

for case in all_cases():
case.check(case.run("numpy"), "numpy")
"""

from __future__ import annotations

from shpy.testing.conformance import control, data, edges, operations, zeros
from shpy.testing.conformance.cases import Case


def all_cases() -> list[Case]:
    """Return the list: operations, edges, control flow, data."""
    parts = (operations, edges, zeros, control, data)
    return [case for part in parts for case in part.cases()]
