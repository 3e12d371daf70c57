"""The searches for the first statement at which two forms of a picture diverge, each for the page that asked for it.

Stage: view. A search takes about twenty runs of an instrumented program, which takes minutes for a large one. It runs
in a thread. A page that no longer needs it cancels it; it then ends before its next compilation or run.

    searches = Searches(tell)
    searches.begin(page, program, moment, (Form("numpy", "strict"), Form("opencl", "fast")), element=17)
    searches.cancel(page)               # nothing is told
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from shpy.display.screen import Moment, filled
from shpy.programs import Program
from shpy.view.kernels import Form


class Cancelled(Exception):
    """The search was cancelled."""


class Searches:
    """The running searches, at most one for each page; `tell` sends a header to the server."""

    def __init__(self, tell: Callable[[dict[str, Any]], None]) -> None:
        self._tell = tell
        self._cancelled: dict[int, threading.Event] = {}
        """By the number of the page; the event of a search that has ended stays until the next one."""

    def begin(self, page: int, program: Program, moment: Moment, forms: tuple[Form, Form], element: int) -> None:
        """Search for the first statement at which an element diverges, in place of an earlier search of the page."""
        self.cancel(page)
        cancelled = self._cancelled[page] = threading.Event()

        def check() -> None:
            if cancelled.is_set():
                raise Cancelled

        def work() -> None:
            try:
                text = _find_divergence(program, moment, forms, element, check)
                check()
            except Cancelled:
                return
            except Exception as error:  # the comparison remains valid
                text = f"The search for the first statement ended: {error}"
            self._tell({"kind": "answer", "about": "divergence", "page": page, "divergence": text})

        threading.Thread(target=work, daemon=True).start()

    def cancel(self, page: int | None) -> None:
        """Cancel the search of a page, or all of them (None)."""
        for number in list(self._cancelled) if page is None else [page]:
            if number in self._cancelled:
                self._cancelled.pop(number).set()


def _find_divergence(
    program: Program, moment: Moment, forms: tuple[Form, Form], element: int, check: Callable[[], None]
) -> str:
    """Return the first statement at which an element diverges, in words."""
    from shpy.testing.divergence import search  # here: it takes long to import, and few pictures are compared
    from shpy.testing.observers import Setting

    if forms[0].fuse != forms[1].fuse:
        return "One of them rounds a * b + c once, the other twice: they may diverge at each such sum."
    inputs = filled(program.inputs, moment)
    one, two = (Setting(program, (), inputs, moment.shape, form.options, check=check) for form in forms)
    names = tuple(f"{form.backend}-1" if form.backend == "opencl" else form.backend for form in forms)
    divergence = search(one, (names[0], names[1]), element, other=two)
    return (
        str(divergence) if divergence else "No statement diverges while it is watched: a contraction, or a lane width."
    )
