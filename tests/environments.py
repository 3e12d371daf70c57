"""Make a virtual environment that has the packages of one extra of pyproject.toml, and nothing besides.

`linked` takes the packages from the environment of the tests, by links, which takes a second and no package index. The
versions are then those of the tests. `installed` asks pip.
"""

import os
import subprocess
import sys
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
PROJECT = "shpy-dsl"


def environment(**variables):
    """Return the variables of a user's shell: none of ours, and no folder of modules."""
    ours = ("SHPY_", "PYTHON", "PYTEST", "COVERAGE", "POCL_")
    return {name: value for name, value in os.environ.items() if not name.startswith(ours)} | variables


def needed(extra):
    """Return the distributions that an install with an extra brings, and the names of those missing here."""
    found, missing, waiting = {}, set(), [(PROJECT, frozenset({extra} - {""}))]
    seen = set(waiting)
    while waiting:
        name, extras = waiting.pop()
        try:
            found[name] = distribution(name)
        except PackageNotFoundError:
            missing.add(name)
            continue
        for line in found[name].requires or []:
            requirement = Requirement(line)
            if requirement.marker and not any(requirement.marker.evaluate({"extra": e}) for e in extras or {""}):
                continue
            entry = canonicalize_name(requirement.name), frozenset(requirement.extras)
            if entry not in seen:
                seen.add(entry)
                waiting.append(entry)
    return found, missing


def linked(folder, extra):
    """Return the Python of a new environment in `folder` with what `extra` needs ("" for the core alone)."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    (packages,) = folder.glob("lib/python*/site-packages")
    for found in needed(extra)[0].values():
        _link(found, packages)
    return folder / "bin/python"


def _link(found: Distribution, packages: Path) -> None:
    """Link the files of a distribution: each folder or module that lies at the top of its site-packages."""
    home = Path(str(found.locate_file("")))
    for top in {Path(file).parts[0] for file in found.files or [] if not Path(file).is_absolute()} - {
        "..",
        "__pycache__",
    }:
        target = packages / top
        if not target.exists():
            target.symlink_to(home / top)


def installed(folder, extra):
    """Return the Python of a new environment in `folder` into which pip has installed this repository with `extra`."""
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    python = folder / "bin/python"
    wanted = f"{ROOT}[{extra}]" if extra else str(ROOT)
    subprocess.run([python, "-m", "pip", "install", "-q", "--disable-pip-version-check", wanted], check=True)
    return python
