"""A test that computes without an end fails by a limit of its own, and the next one runs."""

import os
import subprocess
import sys
from pathlib import Path

from patience import HANGING

TESTS = """
import pytest

def test_without_an_end():
    while True:
        pass

def test_after_it():
    pass

@pytest.mark.slow
def test_that_may_take_long():
    for _ in range(5_000_000):
        pass
"""


def test_a_test_that_computes_without_an_end_fails_and_the_next_one_runs(tmp_path):
    (tmp_path / "test_it.py").write_text(TESTS)
    ran = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "patience", "--cpu-limit", "0.2", "-p", "no:cacheprovider"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parent), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        capture_output=True,
        text=True,
        timeout=HANGING,
    )
    assert "1 failed, 2 passed" in ran.stdout
    assert "Failed: the test has taken 0.2 seconds of CPU: it hangs, or is to be marked slow" in ran.stdout
