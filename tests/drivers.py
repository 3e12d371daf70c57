"""The conformance list on every OpenGL and OpenCL driver that can be had without a GPU, each in a process of its own.

    python -m tests.drivers                         # what is installed; writes docs/drivers.md
    python -m tests.drivers softpipe --print        # one of them; writes nothing

Drivers that are not on the system are looked for in the folder SHPY_DRIVERS (default: ~/.cache/shpy-drivers), as
`NAME/*.icd` for OpenCL and `NAME/lvp_icd.json` for zink.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

from shpy.backends.registry import backends
from shpy.errors import CompileError, ShpyError
from shpy.testing.conformance.cases import all_cases

ROOT = Path(__file__).parents[1]
DOCUMENT = ROOT / "docs" / "drivers.md"
PRIVATE = Path(os.environ.get("SHPY_DRIVERS") or Path.home() / ".cache" / "shpy-drivers")
MESA = {"EGL_PLATFORM": "surfaceless", "LIBGL_ALWAYS_SOFTWARE": "1"}
SECONDS = 1800


@dataclass(frozen=True)
class Driver:
    """A driver, what runs on it, the environment that selects it, and the command that gets it."""

    name: str
    target: str
    get: str
    environment: dict[str, str] = field(default_factory=dict)
    private: str = ""

    def selected(self) -> dict[str, str] | None:
        """The environment that selects it; None where it is not installed."""
        if not self.private:
            return self.environment
        folder = PRIVATE / self.private
        found = sorted(folder.glob("lvp_icd*.json" if self.target == "glsl" else "*.icd"))
        if not found:
            return None
        libraries = sorted({str(library.parent) for library in folder.rglob("*.so*")})
        which = ("VK_ICD_FILENAMES", found[0]) if self.target == "glsl" else ("OCL_ICD_VENDORS", folder)
        paths = ":".join(filter(None, [*libraries, os.environ.get("LD_LIBRARY_PATH", "")]))
        return {**self.environment, which[0]: str(which[1]), "LD_LIBRARY_PATH": paths}


MESA_PACKAGES = "apt install libegl1 libgl1-mesa-dri"
DRIVERS = [
    Driver("llvmpipe", "glsl", MESA_PACKAGES, MESA),
    Driver("llvmpipe at GL 3.3", "glsl", MESA_PACKAGES, {**MESA, "MESA_GL_VERSION_OVERRIDE": "3.3"}),
    Driver(
        "llvmpipe without gpu_shader5",
        "glsl",
        MESA_PACKAGES,
        {**MESA, "MESA_EXTENSION_OVERRIDE": "-GL_ARB_gpu_shader5"},
    ),
    Driver("softpipe", "glsl", MESA_PACKAGES, {**MESA, "GALLIUM_DRIVER": "softpipe"}),
    Driver(
        "zink on lavapipe",
        "glsl",
        "apt-get download mesa-vulkan-drivers; dpkg -x",
        {**MESA, "MESA_LOADER_DRIVER_OVERRIDE": "zink", "LIBGL_KOPPER_DRI2": "1"},
        private="lavapipe",
    ),
    *(Driver(f"PoCL, {n} lane{'s' * (n > 1)}", f"opencl-{n}", "apt install pocl-opencl-icd") for n in (1, 4, 8, 16)),
    Driver("Intel CPU", "opencl-8", "pip install --target intel-opencl-rt intel-cmplr-lib-rt tbb", private="intel"),
    Driver("Oclgrind", "opencl-1", "apt-get download oclgrind; dpkg -x", private="oclgrind"),
    Driver(
        "rusticl", "opencl-1", "apt-get download mesa-opencl-icd; dpkg -x", {"RUSTICL_ENABLE": "llvmpipe"}, "rusticl"
    ),
    Driver("PoCL of PyPI", "opencl-8", "pip install --target pocl-binary-distribution", private="pocl-pypi"),
]


def run_here(target: str, skip: set[str], every: int) -> None:
    """Run the list in this process; a line of JSON tells each beginning and outcome."""
    name = target.partition("-")[0]
    device = next(b for b in backends() if b.name == name).devices[0]
    tell = {"device": device.name, "version": device.version, "notes": device.notes}
    print(json.dumps(tell), flush=True)
    for case in all_cases()[::every]:
        if case.name in skip or (name == "glsl" and "glsl" in case.refused):
            continue
        print(json.dumps({"begun": case.name}), flush=True)
        try:
            case.check(case.run(target), target)
            outcome = "same"
        except CompileError as error:
            outcome = f"refused: {error.message.splitlines()[0]}"
        except (AssertionError, ShpyError) as error:
            outcome = f"wrong: {str(error)[:200]}"
        print(json.dumps({"case": case.name, "outcome": outcome}), flush=True)


@dataclass
class Report:
    """The results of the conformance list on one driver."""

    device: str = ""
    version: str = ""
    notes: list[str] = field(default_factory=list)
    outcomes: dict[str, str] = field(default_factory=dict)

    def row(self, driver: Driver) -> str:
        """Its row of the table."""
        kinds = [o.partition(":")[0] for o in self.outcomes.values()]
        cells = [f"same bits: {kinds.count('same')} programs"]
        for kind in ("refused", "wrong", "crashed"):
            if kind in kinds:
                names = sorted(n for n, o in self.outcomes.items() if o.startswith(kind))
                why = sorted({o.partition(": ")[2] for o in self.outcomes.values() if o.startswith("refused")})
                cells.append(f"{kind}: {'; '.join(why if kind == 'refused' else names)}")
        return f"| {driver.name} | {self.device}, {self.version} | {'. '.join([*cells, *self.notes])} |"


def run(driver: Driver, environment: dict[str, str], every: int) -> Report:
    """Run the list in processes of their own: one more for each program that ends its process."""
    report = Report()
    while True:
        skip = sorted(report.outcomes)
        command = [sys.executable, "-m", "tests.drivers", "--here", driver.target, "--every", str(every)]
        done = subprocess.run(
            command, input=json.dumps(skip), cwd=ROOT, env={**os.environ, "SHPY_CACHE_DIR": "", **environment},
            capture_output=True, text=True, timeout=SECONDS, check=False,
        )  # fmt: skip
        begun = None
        for line in done.stdout.splitlines():
            told = json.loads(line)
            if "device" in told:
                report.device, report.version, report.notes = told["device"], told["version"], told["notes"]
            begun = told.get("begun")
            if "case" in told:
                report.outcomes[told["case"]] = told["outcome"]
        if done.returncode == 0:
            return report
        if begun is None:
            raise SystemExit(f"{driver.name} ends at once:\n{done.stderr[-2000:]}")
        report.outcomes[begun] = "crashed: the process ended"


HEAD = """\
# Drivers

What `python -m tests.drivers` found: the conformance list on each driver of OpenGL and OpenCL that runs without a GPU.
The reference is the interpreter. Elements that meet a denormal on the way are not compared on a device that flushes
denormals. A program is refused with a `CompileError` that names the operation which the device gets wrong.

| driver | device and version | results |
|---|---|---|
"""


def main() -> None:
    """Run what is asked for, print the table, and write the document."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="drivers (default: all)")
    parser.add_argument("--print", action="store_true", help="do not write docs/drivers.md")
    parser.add_argument("--every", type=int, default=1, help="run every n-th program")
    parser.add_argument("--here", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.here:
        run_here(given.here, set(json.load(sys.stdin)), given.every)
        return
    rows = []
    for driver in DRIVERS:
        if given.names and not any(name in driver.name for name in given.names):
            continue
        environment = driver.selected()
        missing = f"| {driver.name} | | not installed: `{driver.get}` |"
        rows.append(missing if environment is None else run(driver, environment, given.every).row(driver))
        print(rows[-1], flush=True)
    if not given.print:
        DOCUMENT.write_text(HEAD + "".join(f"{row}\n" for row in rows))


if __name__ == "__main__":
    main()
