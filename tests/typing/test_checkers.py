"""mypy and pyright accept a script of every feature, and find every mistake of a file of mistakes."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from patience import HANGING

import shpy as sh

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
COMMANDS = {
    "mypy": ["mypy", "--strict", "--config-file=", "--no-error-summary", "--follow-imports=silent"],
    "pyright": ["pyright", "--pythonpath", sys.executable],
}


@cache
def found(checker: str) -> dict[str, dict[int, str]]:
    """Return each file's errors by line, as a checker reports them."""
    files = ("accepted.py", "mistakes.py")
    environment = {**os.environ, "PYRIGHT_PYTHON_IGNORE_WARNINGS": "1"}
    command = [sys.executable, "-m", *COMMANDS[checker], *(str(HERE / file) for file in files)]
    run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=HANGING)
    assert run.returncode == 1, run.stdout + run.stderr
    errors: dict[str, dict[int, str]] = {file: {} for file in files}
    for match in re.finditer(r"^.*?(\w+\.py):(\d+):.*\berror: .*$", run.stdout, re.MULTILINE):
        errors.setdefault(match[1], {})[int(match[2])] = match[0]
    return errors


@pytest.mark.parametrize("checker", COMMANDS)
def test_a_script_of_every_feature_is_accepted(checker: str) -> None:
    errors = found(checker)
    assert errors["accepted.py"] == {}
    assert set(errors) == {"accepted.py", "mistakes.py"}


@pytest.mark.parametrize("checker", COMMANDS)
def test_every_mistake_is_found_and_nothing_else(checker: str) -> None:
    lines = (HERE / "mistakes.py").read_text().splitlines()
    mistakes = {number for number, line in enumerate(lines, 1) if line.endswith("# mistake")}
    reported = found(checker)["mistakes.py"]
    assert len(mistakes) > 45
    assert {n: lines[n - 1].strip() for n in mistakes - set(reported)} == {}
    assert {n: text for n, text in reported.items() if n not in mistakes} == {}


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
