"""The backend of a picture or of queries, where the user names none.

Stage: below all others of the ray tracer.

    chosen_backend(None)        # "opencl" where its device has numpy's bits, else "numpy"
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import shpy as sh


def chosen_backend(name: str | None, *, shares_cores: bool = False) -> str:
    """Return `name`; for None and "auto" the backend for work that is long enough to pay for a compilation.

    With `shares_cores` that is numpy: workers share the cores of a machine, and OpenCL would take all for each.
    """
    if name not in (None, "auto"):
        return name
    default = sh.default_backend(long=True)
    return "numpy" if shares_cores and not default.pinned else str(default)


def chosen_meanwhile(name: str | None) -> Callable[[], str]:
    """Return a function that waits for `chosen_backend(name)`; a thread of its own opens the device.

    The first build of a process takes PoCL 0.5 to 0.9 s, in which it needs no Python. A cold `raytracer render mixed`
    takes 0.88 of its time (0.82 to 0.91) if the scene is read and laid out meanwhile, 0.49 of numpy's; the first sample
    of it by `--integrator path --backend opencl` takes 0.77. This may go when the first build takes less than 0.1 s.
    """
    if (sh.default_backend() if name in (None, "auto") else name) == "numpy":
        return lambda: "numpy"  # without a thread, so that the process may fork
    pool = ThreadPoolExecutor(1, "raytracer-device")
    answer = pool.submit(chosen_backend, name)
    pool.submit(lambda: open_device(answer.result()))
    pool.shutdown(wait=False)
    return answer.result


def open_device(backend: str) -> None:
    """Open the first device of a backend; the kernel of the picture meets its errors, too."""
    if backend != "numpy":
        with suppress(sh.ShpyError):
            sh.Stream.empty(1, sh.Attrib1f, backend)
