"""A view in a process of its own, the installed Chromium, and a wait that counts its pauses.

with viewed(Path("shader.py"), "--backend", "opencl") as view:
    view.save(view.path.read_text().replace("0.5", "0.6"))
"""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Final

_PATIENCE: Final = 100.0
"""Seconds until a server or a browser counts as hanging."""
_PAUSE: Final = 0.005
"""Seconds between two checks of a condition."""


@cache
def chromium() -> str | None:
    """Return the path of a Chromium that starts, else None: without a snap, Ubuntu's command only asks for one."""
    for path in filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))):
        if subprocess.run([path, "--version"], capture_output=True).returncode == 0:
            return path
    return None


class View:
    """The process of `shpy view`, with the file that it shows."""

    def __init__(
        self,
        path: str | Path,
        *options: str,
        command: Sequence[str] = ("shpy", "view"),
        address: str = "127.0.0.1",
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self.path = Path(path)
        # As at a terminal: a background job of a shell ignores Ctrl-C, and its children would, too.
        self.process = subprocess.Popen(
            [sys.executable, "-m", *command, str(path), "--port", "0", *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        line = self.process.stdout.readline()
        assert f"http://{address}:" in line, line + self.process.stderr.read()
        self.port = int(re.search(r":(\d+)/", line)[1])  # type: ignore[index]
        self.url = f"http://127.0.0.1:{self.port}/"

    def save(self, text: str) -> None:
        """Save the file as an editor does: a new file takes the old one's place."""
        new = self.path.with_suffix(".new")
        new.write_text(text)
        new.replace(self.path)

    def end(self) -> tuple[int, str]:
        """End it as Ctrl-C does; return its exit status and its standard error."""
        self.process.send_signal(signal.SIGINT)
        _, message = self.process.communicate(timeout=_PATIENCE)
        return self.process.returncode, message


def end_by_signal() -> None:
    """Let SIGTERM, as `timeout` sends it, unwind the stack, so that servers and browsers that were started end too."""
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))


@contextmanager
def viewed(path: str | Path, *options: str, **kinds: Any) -> Iterator[View]:
    """Serve a file until the block ends."""
    view = View(path, *options, **kinds)
    try:
        yield view
    finally:
        if view.process.poll() is None:
            view.end()


def wait_until(condition: Callable[[], Any], seconds: float = _PATIENCE) -> Any:
    """Call a function until it returns something true, and return that; raise TimeoutError after `seconds` of pauses.

    The pauses count, not the clock, which goes on while a virtual machine is paused.
    """
    for _ in range(round(seconds / _PAUSE)):
        if result := condition():
            return result
        time.sleep(_PAUSE)
    raise TimeoutError(f"it does not hold after pauses of {seconds} s")
