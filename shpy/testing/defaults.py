"""The defaults that pytest's `--shpy-backends`, `--shpy-ulp` and `--shpy-update` set; else every backend and every bit.

Stage: test. `plugin.py` sets these, `assert_equivalent` and `assert_golden` read them.
"""

from __future__ import annotations

backends: tuple[str, ...] | None = None
"""The backends to compare where a test names none; None for each that is available."""

ulp: float = 0.0
"""The least distance in ULP that every comparison allows."""

update: bool = False
"""True if `assert_golden` writes its files anew."""
