"""The backend of a picture or of queries, where the user names none.

Stage: below all others of the ray tracer.

    chosen_backend(None)        # "opencl" where its device has numpy's bits, else "numpy"
"""

from __future__ import annotations

import shpy as sh


def chosen_backend(name: str | None, *, shares_cores: bool = False) -> str:
    """Return `name`; for None and "auto" the backend for work that is long enough to pay for a compilation.

    With `shares_cores` that is numpy: workers share the cores of a machine, and OpenCL would take all for each.
    """
    if name not in (None, "auto"):
        return name
    default = sh.default_backend(long=True)
    return "numpy" if shares_cores and not default.pinned else str(default)
