"""A view in a process of its own, and the installed browser, which tests may lack."""

import json
import os
from contextlib import contextmanager
from pathlib import Path
from weakref import WeakKeyDictionary

import pages
import pytest
from pages import View, viewed
from patience import PAGE
from websockets.sync.client import connect

from shpy.view import wire

_pages: WeakKeyDictionary = WeakKeyDictionary()
__all__ = ["View", "as_at_first", "chromium", "new_page", "save", "viewed", "watched"]


def as_at_first(view, *params):
    """Undo what other tests have set: pages share the state of a view on numpy, in strict mode."""
    undone = {"params": dict.fromkeys(params), "backend": "numpy", "math": "strict", "playing": True, "steps": 1}
    undone |= {"mark": False, "mouse": [0, 0, 0, 0]}
    with connect(view.url.replace("http", "ws") + "view", origin=view.url.rstrip("/")) as line:
        line.send(json.dumps({"do": "set", "changes": undone}))


def save(view, text):
    """Save another version of the file, and wait until its process draws: the one before would end meanwhile."""
    with connect(view.url.replace("http", "ws") + "view", origin=view.url.rstrip("/")) as line:
        view.save(text)
        for awaited in ("recording", "recorded"):
            while wire.unpack(line.recv())[0]["kind"] != awaited:
                pass


def new_page(browser, **options):
    """Open a page that waits as long as a busy machine needs."""
    page = browser.new_page(**options)
    page.set_default_timeout(PAGE)
    return page


@contextmanager
def watched(browser, view, **size):
    """Show a view in a page until the block ends: its console names no problem, and it asks nobody but the view.

    The tests of a browser share the page, which each of them loads anew: one of its own costs processes, two seconds.
    """
    if browser not in _pages:
        _pages[browser] = new_page(browser)
    page, problems = _pages[browser], []

    def note_error(error):
        problems.append(str(error))

    def note_request(request):
        if view.url not in request.url:
            problems.append(request.url)

    page.set_viewport_size(size)
    page.mouse.move(0, 0)
    page.on("pageerror", note_error)
    page.on("request", note_request)
    page.goto(view.url)
    yield page
    page.goto("about:blank")  # its connection ends with its test
    page.remove_listener("pageerror", note_error)
    page.remove_listener("request", note_request)
    assert problems == []


@contextmanager
def chromium():
    """Start the installed Chromium, or Playwright's own, driven by Playwright."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        path = pages.chromium()
        if not (path or Path(playwright.chromium.executable_path).exists() or os.environ.get("CI")):
            pytest.skip("there is no Chromium here: apt-get install chromium, or .venv/bin/playwright install chromium")
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        try:
            yield browser
        finally:
            browser.close()
