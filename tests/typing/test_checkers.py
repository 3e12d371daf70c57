"""mypy and pyright accept a script of every feature, and find every mistake of a file of mistakes."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from functools import cache
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from patience import HANGING

import shpy as sh

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
COMMANDS = {
    "mypy": ["mypy", "--no-error-summary"],  # with our configuration, so that it reads what the check of types keeps
    "pyright": ["pyright", "--pythonpath", sys.executable],
}
CHECKERS = pytest.mark.parametrize("checker", ["mypy", pytest.param("pyright", marks=pytest.mark.slow)])


@cache
def found(checker: str) -> dict[str, dict[int, str]]:
    """Return each file's errors by line, as a checker reports them."""
    environment = {**os.environ, "PYRIGHT_PYTHON_IGNORE_WARNINGS": "1"}
    with TemporaryDirectory() as folder:  # all files in one run: each reads the stub
        files = [HERE / "accepted.py", HERE / "mistakes.py", written_meetings(Path(folder))]
        command = [sys.executable, "-m", *COMMANDS[checker], *map(str, files)]
        run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=HANGING)
    assert run.returncode == 1, run.stdout + run.stderr
    errors: dict[str, dict[int, str]] = {file.name: {} for file in files}
    for match in re.finditer(r"^.*?(\w+\.py):(\d+):.*\berror: .*$", run.stdout, re.MULTILINE):
        errors.setdefault(match[1], {})[int(match[2])] = match[0]
    return errors


@CHECKERS
def test_a_script_of_every_feature_is_accepted(checker: str) -> None:
    errors = found(checker)
    assert errors["accepted.py"] == {}
    assert set(errors) == {"accepted.py", "mistakes.py", "meetings.py"}


@CHECKERS
def test_every_mistake_is_found_and_nothing_else(checker: str) -> None:
    lines = (HERE / "mistakes.py").read_text().splitlines()
    mistakes = {number for number, line in enumerate(lines, 1) if line.endswith("# mistake")}
    reported = found(checker)["mistakes.py"]
    assert len(mistakes) > 45
    assert {n: lines[n - 1].strip() for n in mistakes - set(reported)} == {}
    assert {n: text for n, text in reported.items() if n not in mistakes} == {}


NUMBERS = {f"{base}{size}": getattr(sh, f"Attrib{size}{base}") for base in "hfdiu" for size in (1, 3)}
MEETINGS = (
    "{0} * {1}",
    "{0} / {1}",
    "sh.max({0}, {1})",
    "sh.pow({0}, {1})",
    "sh.mix({0}, {1}, 0.5)",
    "sh.cond({0} < 1, {0}, {1})",
)


def meetings() -> list[str]:
    """Return an assertion of the type that runs have, for each two types that may meet and each of MEETINGS."""
    values = {"sh": sh, **{name: cls(2) for name, cls in NUMBERS.items()}}
    pairs = [pair for pair in product(NUMBERS, NUMBERS) if {pair[0][0], pair[1][0]} != {"i", "u"}]
    expressions = [meeting.format(*pair) for pair in pairs for meeting in MEETINGS]
    return [f"assert_type({e}, sh.{type(eval(e, values)).__name__})" for e in expressions]


def written_meetings(folder: Path) -> Path:
    """Write the assertions to a file."""
    lines = [
        "from typing import assert_type",
        "import shpy as sh",
        *(f"{name} = sh.{cls.__name__}(2)" for name, cls in NUMBERS.items()),
    ]
    file = folder / "meetings.py"
    file.write_text("\n".join([*lines, *meetings()]) + "\n")
    return file


@CHECKERS
def test_numbers_of_two_types_meet_in_the_type_that_runs_have(checker: str) -> None:
    assert found(checker)["meetings.py"] == {}


def test_the_script_runs() -> None:
    sys.path.insert(0, str(HERE))
    try:
        import accepted
    finally:
        sys.path.remove(str(HERE))
    assert np.shape(accepted.run()) == (4, 4, 3)


def test_the_stub_is_up_to_date() -> None:
    run = subprocess.run([sys.executable, str(ROOT / "scripts" / "stubs"), "--check"], check=False)
    assert run.returncode == 0, "run scripts/stubs"


def test_the_stub_has_every_public_name() -> None:
    stub = ast.parse((ROOT / "shpy" / "__init__.pyi").read_text())
    names = {bound for statement in stub.body for bound in bound_by(statement)}
    assert {*sh.__all__, *sh._MODULES, *sh._LATER} - names == set()


def bound_by(statement: ast.stmt) -> list[str]:
    """Return the names that a statement of a stub defines or exports."""
    match statement:
        case ast.FunctionDef() | ast.ClassDef():
            return [statement.name]
        case ast.ImportFrom():
            return [alias.asname for alias in statement.names if alias.asname is not None]
        case ast.Assign() | ast.AnnAssign():
            targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
            return [target.id for target in targets if isinstance(target, ast.Name)]
        case _:
            return []
