"""A view in a process of its own, and the installed browser, which tests may lack."""

import json
import os
from contextlib import contextmanager

import pytest
from websockets.sync.client import connect

from benchmarks.pages import CHROMIUM, View, viewed

__all__ = ["View", "as_at_first", "chromium", "viewed"]


def as_at_first(view, *params):
    """Undo what other tests have set: pages share the state of a view on numpy, in strict mode."""
    undone = {"params": dict.fromkeys(params), "backend": "numpy", "math": "strict", "playing": True, "steps": 1}
    with connect(view.url.replace("http", "ws") + "view", origin=view.url.rstrip("/")) as line:
        line.send(json.dumps({"do": "set", "changes": undone}))


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
