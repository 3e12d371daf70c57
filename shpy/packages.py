"""The packages that optional parts of shpy need, and the command that installs a missing one.

Stage: below all others; `import shpy as sh` brings it as `sh.packages`. The requirements are those that the installed
distribution declares, so that `pyproject.toml` alone states them.

    sh.packages.install("pyopencl")     # pip install 'pyopencl>=2024.2.7'
    sh.packages.extras()["opencl"]      # ['pyopencl']
"""

from __future__ import annotations

import platform
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

DISTRIBUTION: Final = "shpy-dsl"
"""The name under which pip knows shpy once it is installed. No package index has it."""
_BUNDLES: Final = ("all", "dev")
"""Extras that consist of the others."""


def install(*packages: str) -> str:
    """Return the command that installs these packages for the Python that runs.

    Each comes with the versions that shpy declares, or by its name alone where nothing is declared: shpy itself need
    not be installed. `pip` on the path may belong to another Python: then the command names this one.
    """
    declared = {_normal(requirement): requirement for requirement, _ in _requirements()}
    words = [declared.get(_normal(package), package) for package in packages]
    pip = shutil.which("pip")
    here = Path(sys.executable)
    command = "pip" if pip and Path(pip).parent == here.parent else f"{shlex.quote(str(here))} -m pip"
    return " ".join([command, "install", *map(shlex.quote, words)])


def installed(package: str) -> str | None:
    """Return the installed version of a package, None where it is missing."""
    from importlib import metadata  # here: it loads a parser of e-mail, and `import shpy` asks for no package

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def extras() -> dict[str, list[str]]:
    """Return the packages of each optional part, as the installed distribution declares them; empty without one.

    A package that is declared for other versions of Python or for other platforms is left out: pip would not install it
    either.

    >>> extras()["opencl"]
    ['pyopencl']
    """
    packages: dict[str, list[str]] = {}
    for requirement, extra in _requirements():
        if extra and extra not in _BUNDLES:
            packages.setdefault(extra, []).append(_name(requirement))
    return packages


def _requirements() -> Iterator[tuple[str, str | None]]:
    """Yield (requirement, extra) of each package that shpy declares for this Python, without shpy's own extras."""
    from importlib import metadata

    if installed(DISTRIBUTION) is None:
        return
    for line in metadata.metadata(DISTRIBUTION).get_all("Requires-Dist", []):
        requirement, _, condition = line.partition(";")
        extra = re.search(r"extra == ['\"]([\w-]+)['\"]", condition)
        if _normal(requirement) != DISTRIBUTION and _holds(condition):
            yield requirement.strip(), extra[1] if extra else None


def _holds(condition: str) -> bool:
    """Return whether a condition holds here: `python_version < '3.14'`, or one that leaves out Linux on ARM."""
    older = re.search(r"python_version < ['\"](\d+)\.(\d+)['\"]", condition)
    fits = "platform_machine" not in condition or sys.platform != "linux" or platform.machine() == "x86_64"
    return fits and (older is None or sys.version_info[:2] < (int(older[1]), int(older[2])))


def _name(requirement: str) -> str:
    """Return the name in a requirement such as `numpy>=2.0`."""
    match = re.match(r"[\w.-]+", requirement)
    return match[0] if match else requirement


def _normal(requirement: str) -> str:
    """Return the name in a requirement as indices compare names (PEP 503)."""
    return re.sub(r"[-_.]+", "-", _name(requirement)).lower()
