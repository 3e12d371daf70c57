"""Tracebacks show the user's lines: in pytest, in notebooks, and where a frozen module starts the program."""

import re
import subprocess
import sys

import pytest

TEST = """
import shpy as sh

def helper(x):
    return x | 1

def test_refused():
    @sh.program
    def f(x: sh.Attrib1f) -> sh.Attrib1f:
        return helper(x)

def test_own():
    @sh.program
    def f(x: sh.Attrib1f) -> sh.Attrib1f:
        return x + {}["missing key"]

def test_own_attribute():
    @sh.program
    def f(x: sh.Attrib1f) -> sh.Attrib1f:
        return x + object().nothing

def test_run():
    sh.program(helper_program)([1j])

def helper_program(x: sh.Attrib1f) -> sh.Attrib1f:
    return x
"""


def output(tmp_path, *options):
    (tmp_path / "test_mine.py").write_text(TEST)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options, str(tmp_path / "test_mine.py")]
    return subprocess.run(command, capture_output=True, text=True, cwd=tmp_path).stdout


def test_pytest_shows_the_users_lines_alone(tmp_path):
    said = output(tmp_path, "--tb=short")
    shown = re.findall(r"^(\S+\.py):(\d+): in (\w+)", said, re.M)
    assert {file for file, _, _ in shown} == {"test_mine.py"}, said
    assert [name for _, _, name in shown] == [
        "test_refused",
        "f",
        "helper",
        "test_own",
        "f",
        "test_own_attribute",
        "f",
        "test_run",
    ]
    assert "write instead" in said


def test_a_full_trace_shows_all_lines(tmp_path):
    assert re.search(r"shpy/lang/programs/record\.py:\d+: ", output(tmp_path, "--full-trace", "-k", "test_refused"))


def test_the_users_own_error_hides_the_frames_around_it(tmp_path):
    said = output(tmp_path, "--tb=short", "-k", "test_own and not attribute")
    assert re.findall(r"^(\S+\.py):\d+: in (\w+)", said, re.M) == [("test_mine.py", "test_own"), ("test_mine.py", "f")]


def test_ipython_shows_the_users_lines_alone(capsys):
    from IPython.core.interactiveshell import InteractiveShell

    shell = InteractiveShell.instance()
    shell.run_cell("import shpy as sh\ndef helper(x):\n    return x | 1\n")
    shell.run_cell("@sh.program\ndef f(x: sh.Attrib1f) -> sh.Attrib1f:\n    return helper(x)\n")
    said = capsys.readouterr().out
    InteractiveShell.clear_instance()
    assert "shpy/lang" not in said
    assert "interactiveshell" not in said
    assert "return helper(x)" in said
    assert "write instead" in said
    assert len(said.splitlines()) < 14, said


@pytest.mark.parametrize("way", ["-m", "-c"])
def test_a_frozen_module_is_no_line_of_the_users(tmp_path, way):
    (tmp_path / "mine.py").write_text("import shpy as sh\nsh.compact(3, 4)\n")
    start = ["-m", "mine"] if way == "-m" else ["-c", "import runpy; runpy.run_path('mine.py')"]
    said = subprocess.run([sys.executable, *start], capture_output=True, text=True, cwd=tmp_path).stderr
    assert "mine.py:2: " in said.splitlines()[-2]
    from shpy.errors import is_standard

    assert is_standard("<frozen runpy>")
