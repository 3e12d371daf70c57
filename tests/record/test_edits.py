"""Programs whose files are edited while the process lives: each version is judged by its own text.

`edits.py` makes the versions, loads each by importlib.reload, autoreload, `exec`, runpy, `%run`, a notebook's cell and
the live page, and compares what it gives with a process that has seen no other version.
"""

from __future__ import annotations

import importlib
import linecache
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from patience import HANGING

import shpy as sh
from shpy.errors import RecordError, ShpyWarning
from shpy.lang.recording.text import has_changed, text_of, written

HEAD = "import shpy as sh\nfrom shpy import SH_IF\n"
WRONG = """
@sh.program
def step(x: sh.Attrib1f) -> sh.Attrib1f:
    n = 0
    with SH_IF(x > 0):
        n = n + 1
    return x * 0 + n
"""
RIGHT = WRONG.replace("n = 0", "n = sh.Attrib1f(0)").replace("n = n + 1", "n += 1")


def walk(folder: Path, seed: int, count: int) -> None:
    """Walk through `count` edits, in a process of its own."""
    command = [sys.executable, str(Path(__file__).with_name("edits.py")), str(seed), str(count), str(folder)]
    found = subprocess.run(command, capture_output=True, text=True, timeout=HANGING)
    assert found.returncode == 0, found.stderr
    assert found.stdout.strip() == "done"


def test_edits_give_what_a_fresh_process_gives(tmp_path: Path) -> None:
    walk(tmp_path, 7301, 6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_edits_give_what_a_fresh_process_gives_at_length(tmp_path: Path, seed: int) -> None:
    walk(tmp_path, seed, 200)


def test_a_reloaded_file_is_judged_by_its_own_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    file = tmp_path / "reloaded_twice.py"
    file.write_text(HEAD + RIGHT)
    module = importlib.import_module("reloaded_twice")
    file.write_text(HEAD + WRONG)
    with pytest.raises(RecordError, match="`n` is rebound inside"):
        importlib.reload(module)
    file.write_text(HEAD + RIGHT)
    module = importlib.reload(module)
    assert np.array_equal(module.step(np.float32([-1, 2])), [0, 1])


def test_exchanged_params_keep_their_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    file = tmp_path / "exchanged.py"
    lines = ["gain = sh.Param(sh.Attrib1f, 2.0)", "bias = sh.Param(sh.Attrib1f, 5.0)"]
    file.write_text(HEAD + "\n".join(lines))
    module = importlib.import_module("exchanged")
    file.write_text(HEAD + "\n".join(reversed(lines)))
    importlib.reload(module)
    assert (module.gain.name, module.bias.name) == ("gain", "bias")


def test_params_without_a_text_have_the_names_that_they_are_stored_in() -> None:
    names: dict[str, object] = {"sh": sh}
    exec("gain, bias = 1, sh.Param(sh.Attrib1f, 2.0)\nlow = sh.Param(sh.Attrib1f, 1.0); high = low * 2", names)
    assert [getattr(names[name], "name", None) for name in ("low", "bias")] == ["low", None]


def executed(tmp_path: Path, text: str, later: str) -> tuple[dict[str, object], list[str]]:
    """Execute a text whose file has another one by then; return its names and the notices."""
    file = tmp_path / "stale.py"
    file.write_text(later)
    names: dict[str, object] = {}
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        exec(compile(text, str(file), "exec", dont_inherit=True), names)
    return names, [str(w.message) for w in told if issubclass(w.category, ShpyWarning)]


def test_a_text_that_does_not_belong_is_told(tmp_path: Path) -> None:
    names, notices = executed(tmp_path, HEAD + RIGHT, HEAD + WRONG)
    assert notices == [
        f"{tmp_path / 'stale.py'}:4: Python runs another step than the file's text has there: the text was changed "
        "after it was loaded, or as it was loaded. Names that a block binds anew are found in the bytecode; mistakes "
        "that only a text shows, such as two names of one value, are not looked for. Load the file again"
    ]
    step = names["step"]
    assert isinstance(step, sh.Program)
    assert np.array_equal(step(np.float32([-1, 2])), [0, 1])
    assert {written(loc.loc) for loc in step.trace(x=2.0)} == {""}
    with pytest.raises(RecordError, match="`n` is rebound inside"):
        executed(tmp_path, HEAD + WRONG, HEAD + RIGHT)


def test_no_notice_where_other_parts_of_the_file_have_changed(tmp_path: Path) -> None:
    names, notices = executed(tmp_path, HEAD + RIGHT, HEAD + RIGHT + "\nn = 3\n")
    assert notices == []
    assert isinstance(names["step"], sh.Program)


def test_a_trace_shows_the_lines_that_were_recorded(tmp_path: Path) -> None:
    file = tmp_path / "traced.py"
    file.write_text(HEAD + RIGHT)
    names: dict[str, object] = {}
    exec(compile(file.read_text(), str(file), "exec", dont_inherit=True), names)
    file.write_text(HEAD + "\n" * 3 + RIGHT)
    linecache.checkcache(str(file))
    step = names["step"]
    assert isinstance(step, sh.Program)
    lines = [written(found.loc) for found in step.trace(x=2.0)]
    assert [line for line in lines if line.startswith("n ")] == ["n = sh.Attrib1f(0)", "n += 1"]


def test_this_file_with_its_assertions_belongs_to_its_code() -> None:
    assert text_of(test_this_file_with_its_assertions_belongs_to_its_code.__code__) is not None
    assert not has_changed(walk.__code__)
    inner = compile("def f(x):\n    return x + 0.0\n", __file__, "exec").co_consts[0]
    assert text_of(inner) is None
    assert has_changed(inner)


def test_a_helper_with_a_text_is_checked_for_a_program_without_one(tmp_path: Path) -> None:
    helper = "def helper(x):\n    with SH_IF(x > 0):\n        return x\n    return x + 1\n"
    program = "\n@sh.program\ndef step(x: sh.Attrib1f):\n    return helper(x * {}) * 2\n"
    with pytest.raises(RecordError, match="Python's `return` inside"):
        executed(tmp_path, HEAD + helper + program.format(3), HEAD + helper + program.format(4))
