"""The tests give the same results whatever the user's own settings are."""

import re
import subprocess
import sys
from pathlib import Path

from environments import ROOT, environment
from patience import HANGING

SETTINGS = {"SHPY_BACKEND": "glsl", "SHPY_DUMP": "ir,source", "SHPY_QUIET": "", "POCL_AFFINITY": "0"}
"""The variables of the table in docs/gpu.md, but for the folder of kernels, with values that change what is printed."""
READ_THEM = [
    "tests/backends/test_glsl_faults.py::test_corrected_binary64_that_fails_at_hard_cases_is_not_used",
    "tests/test_slow.py",
    "tests/backends/test_dump.py",
]
"""Tests of what reads these variables."""


def test_every_setting_that_the_documents_list_is_tried():
    listed = set(re.findall(r"^\| `((?:SHPY|POCL)_\w+)` \|", (ROOT / "docs/gpu.md").read_text(), re.MULTILINE))
    assert listed == {*SETTINGS, "SHPY_CACHE_DIR"}


def test_tests_pass_with_the_settings_of_a_user(tmp_path):
    folder = tmp_path / "kernels"
    folder.mkdir(mode=0o700)
    ran = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *READ_THEM],
        cwd=ROOT,
        env=environment(SHPY_CACHE_DIR=str(folder), **SETTINGS),
        capture_output=True,
        text=True,
        timeout=HANGING,
        stdin=subprocess.DEVNULL,
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert list(Path(folder).iterdir()) == []
