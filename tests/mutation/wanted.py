"""A pytest plugin of the mutation check: of the tests that are collected, those that a file lists run, in its order."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep the tests that the file lists; a listed file or function stands for all its tests."""
    wanted = Path(os.environ["SHPY_WANTED"]).read_text().splitlines()
    places = {name: n for n, name in enumerate(wanted)}

    def place(item: pytest.Item) -> int | None:
        test = item.nodeid.partition("[")[0]
        names = (item.nodeid, test, item.nodeid.partition("::")[0])
        return next((places[name] for name in names if name in places), None)

    found = {item: place(item) for item in items}
    kept = [item for item in items if found[item] is not None]
    items[:] = sorted(kept, key=lambda item: found[item] or 0)
