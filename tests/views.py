"""A view in a process of its own, and its page in the installed browser."""

import os
import re
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class View:
    """The process of `shpy view`, with the file that it shows."""

    def __init__(self, path, *options, command=("shpy", "view"), address="127.0.0.1"):
        self.path = path
        # As at a terminal: a background job of a shell ignores Ctrl-C, and its children would, too.
        self.process = subprocess.Popen(
            [sys.executable, "-m", *command, str(path), "--port", "0", *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )
        line = self.process.stdout.readline()
        assert f"http://{address}:" in line, line + self.process.stderr.read()
        self.port = int(re.search(r":(\d+)/", line)[1])
        self.url = f"http://127.0.0.1:{self.port}/"

    def save(self, text):
        """Save the file as an editor does: a new file takes the old one's place."""
        new = self.path.with_suffix(".new")
        new.write_text(text)
        new.replace(self.path)

    def end(self):
        """End it as Ctrl-C does; return its exit status and its standard error."""
        self.process.send_signal(signal.SIGINT)
        _, said = self.process.communicate(timeout=20)
        return self.process.returncode, said


@contextmanager
def viewed(path, *options, **kinds):
    """Serve a file until the block ends."""
    view = View(Path(path), *options, **kinds)
    try:
        yield view
    finally:
        if view.process.poll() is None:
            view.end()


@contextmanager
def chromium():
    """Start the installed Chromium, driven by Playwright."""
    if CHROMIUM is None and not os.environ.get("CI"):
        pytest.skip("there is no Chromium here: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        try:
            yield browser
        finally:
            browser.close()
