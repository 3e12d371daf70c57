"""A view in a process of its own, and the installed Chromium, driven by Playwright.

with viewed(Path("shader.py"), "--backend", "opencl") as view, chromium() as browser:
    page = browser.new_page()
    page.goto(view.url)
    view.save(view.path.read_text().replace("0.5", "0.6"))
"""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Final

from websockets.sync.client import connect

from shpy.errors import ShpyError

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


class Browsed:
    """A page in a headless Chromium of its own, asked by the protocol of its developer tools."""

    def __init__(self, url: str, profile: Path) -> None:
        path = chromium()
        if path is None:
            raise ShpyError("there is no Chromium here", cure="apt-get install chromium")
        options = ["--headless=new", "--no-sandbox", "--remote-debugging-port=0", "--window-size=1000,860"]
        self.process = subprocess.Popen(
            [path, *options, f"--user-data-dir={profile}", url],
            stderr=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
        )
        opened = profile / "DevToolsActivePort"
        wait_until(lambda: opened.is_file() and len(opened.read_text().splitlines()) == 2)
        port = opened.read_text().splitlines()[0]
        pages = wait_until(lambda: _pages(port, url))
        self._line = connect(pages[0]["webSocketDebuggerUrl"], max_size=None)
        self._count = 0

    def send(self, method: str, **parameters: Any) -> Any:
        """Return the answer to a command of the protocol."""
        self._count += 1
        self._line.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while (answer := json.loads(self._line.recv(timeout=120))).get("id") != self._count:
            pass
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']}")
        return answer["result"]

    def evaluate(self, expression: str) -> Any:
        """Return the value of an expression, or what its promise gives."""
        answer = self.send("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def wait(self, expression: str) -> None:
        """Wait until an expression is true in the page."""
        wait_until(lambda: self.evaluate(expression))

    def end(self) -> None:
        """End the browser."""
        self._line.close()
        self.process.terminate()
        self.process.wait(_PATIENCE)


def _pages(port: str, url: str) -> list[Any]:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=_PATIENCE) as answer:
        return [one for one in json.load(answer) if one["url"] == url]


def wait_until(condition: Callable[[], Any], seconds: float = _PATIENCE) -> Any:
    """Call a function until it returns something true, and return that; raise TimeoutError after `seconds` of pauses.

    The pauses count, not the clock, which goes on while a virtual machine is paused.
    """
    for _ in range(round(seconds / _PAUSE)):
        if result := condition():
            return result
        time.sleep(_PAUSE)
    raise TimeoutError(f"it does not hold after pauses of {seconds} s")


@contextmanager
def browsed(url: str) -> Iterator[Browsed]:
    """Show a page in Chromium until the block ends."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        page = Browsed(url, Path(profile))
        try:
            yield page
        finally:
            page.end()
