"""The installation of shpy and its requirements: every command that the product or a page names can work."""

import importlib.metadata
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from patience import HANGING

import shpy as sh
from shpy import packages

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
FOLDERS = [ROOT / name for name in ("shpy", "raytracer", "shpy_start", "benchmarks", "examples", "tests")]
TEXTS = [
    *(path for folder in FOLDERS for path in folder.rglob("*.py")),
    *ROOT.glob("*.md"),
    *(ROOT / "docs").rglob("*.md"),
    *(path for path in (ROOT / "scripts").iterdir() if path.is_file()),
]
FROM_AN_INDEX = re.compile(r"shpy-dsl\[|install\s+(?:-\S+\s+)*['\"]?(?:shpy|shpy-dsl|raytracer)(?![\w./-])")
"""A command that asks a package index for shpy, which no index has."""


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("pip install 'shpy-dsl[opencl]'", True),
        ("uv pip install shpy", True),
        ("pip install -U shpy-dsl`", True),
        ("pip install -e '.[opencl]'", False),
        ("pip install './shpy_dsl-0.1.0-py3-none-any.whl[opencl]'", False),
        ("pip install shpy/", False),
        ("scripts/setup opencl", False),
    ],
)
def test_a_command_that_asks_an_index_for_shpy_is_recognised(text, found):
    assert bool(FROM_AN_INDEX.search(text)) == found


def test_no_text_tells_to_install_shpy_from_an_index():
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in TEXTS
        if path != Path(__file__)
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if FROM_AN_INDEX.search(line)
    ]
    assert found == []


def test_packages_that_code_asks_for_are_declared():
    asked = re.compile(r"\binstall\(\s*['\"]([\w-]+)['\"]")
    names = {name for path in TEXTS if path != Path(__file__) for name in asked.findall(path.read_text())}
    extras = PROJECT["optional-dependencies"].values()
    declared = {re.match(r"[\w-]+", line)[0] for extra in extras for line in extra}
    assert {"pyopencl", "moderngl", "mpmath", "matplotlib", "hypothesis", "pillow", "OpenEXR"} <= names
    assert names - declared - {"nowhere-to-be-found"} == set()


def installation(monkeypatch, *lines):
    """Make shpy look like an installed distribution with these requirements."""

    class Metadata:
        def get_all(self, key, default):
            return list(lines) if key == "Requires-Dist" else default

    monkeypatch.setattr(importlib.metadata, "metadata", lambda name: Metadata())
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "1.0")


@pytest.fixture
def own_pip(monkeypatch, tmp_path):
    """`pip` on the path belongs to the Python that runs."""
    monkeypatch.setattr(packages.sys, "executable", str(tmp_path / "python"))
    monkeypatch.setattr(packages.shutil, "which", lambda name: str(tmp_path / name))


def test_the_command_names_the_package_with_its_versions(monkeypatch, own_pip):
    lines = [
        "numpy>=2.0",
        "pyopencl>=2024.2.7; extra == 'opencl'",
        "pyopencl>=2024.2.7; extra == 'all'",
        "mako; extra == 'b'",
    ]
    installation(monkeypatch, *lines)
    assert packages.install("pyopencl") == "pip install 'pyopencl>=2024.2.7'"
    assert packages.install("mako", "pyopencl") == "pip install mako 'pyopencl>=2024.2.7'"


def test_names_are_compared_as_an_index_does(monkeypatch, own_pip):
    installation(monkeypatch, "OpenEXR>=3.3; extra == 'raytracer'", "flip_evaluator>=1.6; extra == 'accuracy'")
    assert packages.install("openexr") == "pip install 'OpenEXR>=3.3'"
    assert packages.install("flip-evaluator") == "pip install 'flip_evaluator>=1.6'"


@pytest.mark.parametrize(("version", "found"), [((3, 9), True), ((3, 13), True), ((3, 14), False), ((4, 0), False)])
def test_a_package_for_earlier_pythons_is_left_out_of_later_ones(monkeypatch, own_pip, version, found):
    lines = ["mpmath>=1.3; extra == 'accuracy'", "slow>=1.6; (python_version < '3.14') and extra == 'accuracy'"]
    installation(monkeypatch, *lines)
    monkeypatch.setattr(packages.sys, "version_info", version)
    assert packages.extras() == {"accuracy": ["mpmath", "slow"] if found else ["mpmath"]}
    assert packages.install("slow") == ("pip install 'slow>=1.6'" if found else "pip install slow")


def test_requirements_have_no_condition_of_another_kind():
    """`packages` reads an upper bound of Python's version and the platforms of one package, and no other marker."""
    lines = [*PROJECT["dependencies"], *(line for extra in PROJECT["optional-dependencies"].values() for line in extra)]
    conditions = [line.partition(";")[2].strip() for line in lines if ";" in line]
    assert conditions
    platforms = "sys_platform != 'linux' or platform_machine == 'x86_64'"
    assert [c for c in conditions if not re.fullmatch(rf"python_version < '\d+\.\d+'|{platforms}", c)] == []


@pytest.mark.parametrize(
    ("system", "machine", "fits"), [("linux", "aarch64", False), ("linux", "x86_64", True), ("darwin", "arm64", True)]
)
def test_a_package_for_some_platforms_is_left_out_of_others(monkeypatch, own_pip, system, machine, fits):
    marker = "(sys_platform != 'linux' or platform_machine == 'x86_64') and extra == 'denoise'"
    installation(monkeypatch, f"network>=2.5; {marker}")
    monkeypatch.setattr(packages.sys, "platform", system)
    monkeypatch.setattr(packages.platform, "machine", lambda: machine)
    assert packages.extras() == ({"denoise": ["network"]} if fits else {})


def test_without_an_installation_packages_go_by_name(monkeypatch, own_pip):
    def nothing(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "version", nothing)
    assert packages.install("pyopencl") == "pip install pyopencl"
    assert packages.extras() == {}


@pytest.mark.parametrize("pip", [None, "/usr/bin/pip"])
def test_where_pip_belongs_to_another_python_the_command_names_this_one(monkeypatch, pip):
    installation(monkeypatch, "moderngl>=5.10; extra == 'glsl'")
    monkeypatch.setattr(packages.sys, "executable", "/home/someone/my shader/.venv/bin/python")
    monkeypatch.setattr(packages.shutil, "which", lambda name: pip)
    assert packages.install("moderngl") == "'/home/someone/my shader/.venv/bin/python' -m pip install 'moderngl>=5.10'"


def test_pip_understands_the_command():
    """pip itself parses the words, without a network: the package is there."""
    assert sh.packages.installed("numpy")
    words = sh.packages.install("numpy").partition(" install ")[2].strip("'")
    done = subprocess.run(
        [sys.executable, "-m", "pip", "install", "--dry-run", "--no-index", "--quiet", words],
        capture_output=True,
        text=True,
        timeout=HANGING,
    )
    assert done.returncode == 0, done.stderr
