"""A view in a process of its own, and the installed browser, which tests may lack."""

import os
from contextlib import contextmanager

import pytest

from benchmarks.pages import CHROMIUM, View, viewed

__all__ = ["View", "chromium", "viewed"]


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
