"""The conformance list on every OpenGL and OpenCL driver that is found, each in a process of its own.

    python -m tests.drivers --get                   # downloads what is not installed to a folder of its own
    python -m tests.drivers                         # runs the list on what is there; writes docs/drivers.md
    python -m tests.drivers llvmpipe rusticl        # on these; the other rows of the table stay
    python -m tests.drivers PoCL --print            # writes nothing
    python -m tests.drivers --certify               # runs `shpy certify` instead; writes the table of docs/certify.md

Drivers that are not on the system are in the folder SHPY_DRIVERS (default: ~/.cache/shpy-drivers), one folder each.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import zipfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from shpy.backend.opencl.packets.widen import WIDER, WIDTHS
from shpy.backend.registry import backends
from shpy.errors import CompileError, ShpyError
from shpy.testing.certify.sections import mixed
from shpy.testing.conformance.cases import Case
from shpy.testing.conformance.catalogue import all_cases

ROOT = Path(__file__).parents[1]
DOCUMENT = ROOT / "docs" / "drivers.md"
CERTIFIED = ROOT / "docs" / "certify.md"
PRIVATE = Path(os.environ.get("SHPY_DRIVERS") or Path.home() / ".cache" / "shpy-drivers")
MESA = {"EGL_PLATFORM": "surfaceless", "LIBGL_ALWAYS_SOFTWARE": "1"}
ZINK = {"MESA_LOADER_DRIVER_OVERRIDE": "zink", "LIBGL_KOPPER_DRI2": "1"}
LLVMPIPE_CL = {"RUSTICL_ENABLE": "llvmpipe"}
NVIDIA = "/proc/driver/nvidia/version"
SECONDS = 1800
OVERLAY = ("unshare", "--mount", "--map-root-user", "sh", "-c",
           'for d in lib share; do mount -t overlay overlay -o lowerdir="$0/usr/$d:/usr/$d" "/usr/$d" || exit; done; '
           'exec "$@"')  # fmt: skip
"""Runs a command where usr/lib and usr/share of a private folder, which comes first, lie over those of the system."""
APT = """\
Dir::Cache "."; Dir::State "state"; Dir::State::status "status"; Dir::Etc::sourceparts "none";
Dir::Etc::sourcelist "sources.list"; APT::Install-Recommends "0"; APT::Sandbox::User "root";
"""
"""apt's configuration in a folder of its own, as on a system without any package."""


@dataclass(frozen=True)
class Source:
    """Packages that hold a driver: `library` is the file that a loader opens, by its pattern.

    `fixed`: the driver looks for its own files in /usr/lib. `release`: another Debian than the system's, of which all
    that the packages need is taken too.
    """

    folder: str
    library: str
    debian: tuple[str, ...] = ()
    pypi: tuple[str, ...] = ()
    fixed: bool = False
    release: str = ""

    @property
    def path(self) -> Path:
        """The folder of its files."""
        return PRIVATE / self.folder

    def found(self) -> Path | None:
        """The library; None where it was not downloaded."""
        return next(iter(sorted(self.path.rglob(self.library))), None)

    def get(self) -> None:
        """Download the packages and take them apart."""
        self.path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory() as scratch:
            if self.release:
                self._get_release(Path(scratch))
            for package in () if self.release else self.debian:
                subprocess.run(["apt-get", "download", package], cwd=scratch, check=True)
            for package in self.pypi:
                command = [sys.executable, "-m", "pip", "download", "--no-deps", "-d", scratch, package]
                subprocess.run(command, check=True)
            for archive in Path(scratch).iterdir():
                if archive.suffix == ".deb":
                    subprocess.run(["dpkg", "-x", archive, self.path], check=True)
                elif archive.suffix == ".whl":
                    zipfile.ZipFile(archive).extractall(self.path)

    def _get_release(self, folder: Path) -> None:
        """Download the packages of another release, and those that they depend on."""
        for name in ("partial", "archives/partial", "state/lists/partial"):
            (folder / name).mkdir(parents=True)
        signed = "[signed-by=/usr/share/keyrings/debian-archive-keyring.gpg]"
        (folder / "sources.list").write_text(f"deb {signed} http://deb.debian.org/debian {self.release} main\n")
        (folder / "apt.conf").write_text(APT.replace(' "', f' "{folder}/', 5))
        (folder / "status").touch()
        for command in (["update"], ["install", "--yes", "--download-only", *self.debian]):
            subprocess.run(
                ["apt-get", *command], env={**os.environ, "APT_CONFIG": str(folder / "apt.conf")}, check=True
            )
        for archive in (folder / "archives").glob("*.deb"):
            archive.rename(folder / archive.name)

    def environment(self, target: str) -> dict[str, str]:
        """Return the variables that select it, beside a file that tells a loader where the library is."""
        library = self.found()
        assert library is not None
        if self.fixed:
            library, paths = Path("/") / library.relative_to(self.path), []
        else:
            folders = {str(other.parent) for other in self.path.rglob("*.so*")} - {str(library.parent)}
            paths = [str(library.parent), *sorted(folders)]
        paths += filter(None, [os.environ.get("LD_LIBRARY_PATH")])
        tell = self.path / "loaders" / f"of-{library.name}"
        tell.mkdir(parents=True, exist_ok=True)
        if target == "glsl":
            (tell / "icd.json").write_text(
                json.dumps(
                    {"file_format_version": "1.0.0", "ICD": {"library_path": str(library), "api_version": "1.1"}}
                )
            )
            return {"VK_ICD_FILENAMES": str(tell / "icd.json"), "LD_LIBRARY_PATH": ":".join(paths)}
        (tell / "driver.icd").write_text(f"{library}\n")
        return {"OCL_ICD_VENDORS": str(tell), "LD_LIBRARY_PATH": ":".join(paths)}


@dataclass(frozen=True)
class Driver:
    """A driver, what runs on it, the environment that selects it, and where it comes from if not from the system."""

    name: str
    target: str
    environment: dict[str, str] = field(default_factory=dict)
    source: Source | None = None
    file: str = "/"
    """A file that the system has with this driver, for those of a GPU."""

    @property
    def installed(self) -> bool:
        """Return whether the driver is installed."""
        return Path(self.file).exists() and (self.source is None or self.source.found() is not None)

    @property
    def family(self) -> str:
        """Its name without a width."""
        return self.name.partition(",")[0]

    def command(self, *arguments: str) -> list[str]:
        """The command that runs a module for it."""
        command = [sys.executable, "-m", *arguments]
        return [*OVERLAY, str(self.source.path), *command] if self.source and self.source.fixed else command

    def selected(self) -> dict[str, str]:
        """The whole environment that selects it."""
        own = self.source.environment(self.target) if self.source else {}
        return {**os.environ, "SHPY_CACHE_DIR": "", **self.environment, **own}


LAVAPIPE = Source("lavapipe", "libvulkan_lvp.so", debian=("mesa-vulkan-drivers", "libvulkan1"))
INTEL = Source("intel", "libintelocl.so", pypi=("intel-opencl-rt", "intel-cmplr-lib-rt", "tbb", "tcmlib"))
RUSTICL = Source(
    "rusticl", "libRusticlOpenCL.so.1", debian=("mesa-opencl-icd", "libclc-15", "libllvmspirvlib15"), fixed=True
)
POCL = Source("pocl-pypi", "libpocl-*.so*", pypi=("pocl-binary-distribution",))
OF_DEBIAN = ("libegl1", "libegl-mesa0", "libgl1-mesa-dri", "mesa-opencl-icd", "mesa-vulkan-drivers", "pocl-opencl-icd")
RELEASES = {13: "trixie", 14: "forky"}


def of_debian(number: int, library: str) -> Source:
    """A driver of another Debian, whose libraries, that of C among them, lie over those of the system as it runs."""
    return Source(f"debian-{number}", library, OF_DEBIAN, fixed=True, release=RELEASES[number])


def lanes_of(name: str, widths: tuple[int, ...], **more: object) -> list[Driver]:
    """An OpenCL driver at several widths."""
    return [Driver(f"{name}, {n} lane{'s' * (n > 1)}", f"opencl-{n}", **more) for n in widths]  # type: ignore[arg-type]


def drivers_of_debian(number: int) -> list[Driver]:
    """The drivers of another Debian that need no GPU."""
    name, egl = f"Debian {number}", of_debian(number, "libEGL_mesa.so.0")
    return [
        Driver(f"{name}: llvmpipe", "glsl", MESA, egl),
        Driver(f"{name}: zink on lavapipe", "glsl", {**MESA, **ZINK}, of_debian(number, "libvulkan_lvp.so")),
        *lanes_of(f"{name}: PoCL", (1, 8, 16), source=of_debian(number, "libpocl.so.2")),
        *lanes_of(
            f"{name}: rusticl", (1, 8), environment=LLVMPIPE_CL, source=of_debian(number, "libRusticlOpenCL.so.1")
        ),
    ]


DRIVERS = [
    Driver("llvmpipe", "glsl", MESA),
    Driver("llvmpipe at GL 3.3", "glsl", {**MESA, "MESA_GL_VERSION_OVERRIDE": "3.3"}),
    Driver("zink on lavapipe", "glsl", {**MESA, **ZINK}, LAVAPIPE),
    *lanes_of("PoCL", (1, *WIDTHS, *WIDER)),
    *lanes_of("Intel CPU", (1, 8), source=INTEL),
    *lanes_of("rusticl", (1, 8), environment=LLVMPIPE_CL, source=RUSTICL),
    *lanes_of("PoCL of PyPI", (1, 8, 16), source=POCL),
    *drivers_of_debian(13),
    *drivers_of_debian(14),
    Driver("NVIDIA, OpenGL", "glsl", file=NVIDIA),
    Driver("NVIDIA, OpenCL", "opencl-1", file=NVIDIA),
]  # fmt: skip


def cases_of(target: str) -> list[Case]:
    """The list, without programs that GLSL cannot hold, in an order of which any beginning holds all kinds."""
    return mixed([case for case in all_cases() if target != "glsl" or "glsl" not in case.refused])


def run_here(target: str, skip: set[str], seconds: float) -> None:
    """Run the list in this process for so long; a line of JSON tells each beginning and outcome."""
    started = time.monotonic()
    name = target.partition("-")[0]
    device = next(b for b in backends() if b.name == name).devices[0]
    tell = {"device": device.name, "version": device.version, "notes": device.notes}
    print(json.dumps(tell), flush=True)
    for case in cases_of(target):
        if case.name in skip:
            continue
        if time.monotonic() - started > seconds:
            break
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

    @property
    def faults(self) -> list[str]:
        """The programs that gave other bits or ended the process."""
        return sorted(f"{n}: {o}" for n, o in self.outcomes.items() if o.partition(":")[0] in ("wrong", "crashed"))

    def row(self, driver: Driver) -> str:
        """Its row of the table."""
        same, whole = sum(o == "same" for o in self.outcomes.values()), len(cases_of(driver.target))
        part = f" ({len(self.outcomes)} of {whole} were run)" if len(self.outcomes) < whole else ""
        cells = [f"same bits: {same} programs{part}"] if same else []
        for note in self.notes:
            note = note.removeprefix("this device ")
            fault, _, cure = note.rpartition(": ")
            cells.append(f"corrected: {fault} ({cure})" if fault else note)
        reasons = Counter(o.partition(": ")[2] for o in self.outcomes.values() if o.startswith("refused"))
        cells += [
            f"refused: {reason.removeprefix(self.device).strip()} ({n} programs)"
            for reason, n in sorted(reasons.items())
        ]
        cells += self.faults
        return f"| {driver.name} | {self.device}, {self.version} | {'; '.join(cells).replace('|', '/')} |"


def run(driver: Driver, seconds: float = SECONDS) -> Report:
    """Run the list in processes of their own, for about so long: one more for each program that ends its process."""
    report = Report()
    while True:
        command = driver.command("tests.drivers", "--here", driver.target, "--seconds", str(seconds))
        done = subprocess.run(
            command, input=json.dumps(sorted(report.outcomes)),
            cwd=ROOT, env=driver.selected(), capture_output=True, text=True, timeout=2 * SECONDS, check=False,
        )  # fmt: skip
        begun = None
        for line in done.stdout.splitlines():
            if not line.startswith("{"):
                continue  # the driver's own
            told = json.loads(line)
            if "device" in told:
                report.device, report.version, report.notes = told["device"], told["version"], told["notes"]
            begun = told.get("begun")
            if "case" in told:
                report.outcomes[told["case"]] = told["outcome"]
        if done.returncode == 0:
            return report
        if begun is None:
            report.outcomes["the first use"] = f"crashed: the process ended ({done.stderr.strip()[-200:]})"
            return report
        report.outcomes[begun] = "crashed: the process ended"


HEAD = """\
# Drivers

What `python -m tests.drivers` found: the conformance list on drivers of OpenGL and OpenCL, on processors and one GPU.
The reference is the interpreter. Elements that meet a denormal on the way are not compared on a device that flushes
denormals. "Corrected" is what probes find when a device is first used, and the way around it; a program is "refused"
with a `CompileError` that names the operation or type which the device gets wrong or does not have.

`python -m tests.drivers --get` downloads the drivers that are not installed to a folder of their own; it leaves the
system as it is. rusticl looks for the files of libclc in /usr/lib, so it runs in a mount namespace (`unshare`) where
they are. Those of Debian 13 (Mesa 25.0, PoCL 6.0) and of Debian 14, which is not released yet (Mesa 26.1, PoCL 7.1),
run so too, their libraries over those of Debian 12. Rows were made on an AMD EPYC with AVX2, another with AVX-512, and
an Intel Xeon with AVX-512; PoCL and Intel's runtime tell the name.
Where fewer programs were run, the time ended: older rows of PoCL took one to three seconds a program.

"Exits of loops": Mesa 22.3 leaves a loop at once where an exit follows the step of what it compares and holds for the
first value. rusticl has this fault too; Mesa 25.0 has it no more. Two faults of Mesa no probe can find. Zink of 22.3
takes minutes to compile sixteen subroutines that return from loops. Zink of 25.0 hangs while it opens, with
"vkCreateInstance failed", where `MESA_LOADER_DRIVER_OVERRIDE=zink` is set and there is no Vulkan driver: unset it.

Mesa 25.0's and 26's llvmpipe and zink take `a < b ? b : a` for a maximum, also where a is NaN, and forget `precise` in
arguments of functions. A probe finds it, and comparisons and arguments are variables of their own there. Mesa 26.1 also
takes `(a >= b ? a : b) * c` for a product with the maximum, which loses the sign of a zero. Another probe finds that,
and comparisons are hidden there.

Mesa 26 takes loops apart whose end it can derive, and then nests what follows their exits; llvmpipe ignores, in
silence, conditions that nest deeper than 79. So a loop with that many exits has its body in another loop of one
iteration, for every driver.

NVIDIA's drivers were run on an H100; other GPUs were not. Its GLSL multiplies by reciprocals, takes `!(a < b)` for
`a >= b`, clamps ints to bounds that cross in the other order, takes `abs(i) < 0` for false, rounds square roots of
binary64 wrong, and links shaders of more textures than it has units, whose results are wrong. Far angles were wrong
when its row was made, and a few answers of functions whose texts have numbers of many digits: the compiler seems to
misread decimal numbers. Since then numbers are probed and written by their bits, and hard cases are asked before
binary64 is used; these two were not run on this GPU again. The walk of rays that diverge, which the ray tracer runs in
OpenCL alone, met other triangles in GLSL there, for a reason that was not found. NVIDIA's OpenCL gives other ints of
NaN in binary64, and takes `x < 0 ? x : 0` for a minimum of zeros; at 16 lanes, which shpy does not choose on a GPU, one
program of bools was wrong. All bits of pictures of four scenes, Whitted's and path traced, were those of numpy on both
(`raytracer render` of `boxes`, `glass` and `materials`, and of `cornell --integrator path`).

rusticl of Mesa 25.0 is wrong in three programs where it takes a product of zero and an infinity for 0, beyond what is
corrected: `bools_of_a_counter`, `literals_as_arguments` and `products_of_constants`. Mesa 22.3 is right there. That
of Mesa 26.1 is right there and wrong in four others: `half`, `halves_beside_floats`, `a_quotient_that_is_counted` and
`the_square_of_a_root_is_not_its_radicand`.

| driver | device and version | results |
|---|---|---|
"""


def write_table(rows: dict[str, str]) -> None:
    """Write the document: these rows by driver, and its own for others."""
    old = DOCUMENT.read_text().splitlines() if DOCUMENT.exists() else []
    kept = {line.split("|")[1].strip(): line for line in old if line.startswith("| ")}
    missing = {d.name: f"| {d.name} | | not run yet |" for d in DRIVERS}
    whole = {**missing, **{name: line for name, line in kept.items() if name in missing}, **rows}
    DOCUMENT.write_text(HEAD + "".join(f"{line}\n" for line in whole.values()))


def certify(driver: Driver) -> str:
    """Run `shpy certify` on it, as a user of that driver would; gives its row of the table."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "certificate.json"
        given = ["certify", "--backend", driver.target.partition("-")[0], "-o", str(path)]
        done = subprocess.run(
            driver.command("shpy", *given), cwd=ROOT, env=driver.selected(), capture_output=True, text=True, check=False
        )
        if not path.exists():
            return f"| {driver.family} | no report: {done.stderr.strip()[-200:]} | | | | |"
        (target,) = json.loads(path.read_text())["targets"]
    sections = target["sections"].values()
    found = [finding for section in sections for finding in section["findings"].values()]
    same = sum(finding["verdict"] in ("same", "denormals") for finding in found)
    refused = sum(finding["verdict"] == "refused" for finding in found)
    wrong = sorted(name for s in sections for name, f in s["findings"].items() if f["verdict"] in ("differs", "failed"))
    said = f"{target['verdict']}: {', '.join(wrong)}" if wrong else target["verdict"]
    left, seconds = sum(s["not run"] for s in sections), sum(s["seconds"] for s in sections)
    return f"| {driver.family} | {said} | {same} | {refused} | {left} | {seconds:.0f} |"


def write_certified(row: str) -> None:
    """Put a row of `certify` into the table that ends its document."""
    text, head, table = CERTIFIED.read_text().partition("| --- | --- | ---: | ---: | ---: | ---: |\n")
    rows = {line.split("|")[1].strip(): line for line in [*table.splitlines(), row]}
    ordered = [rows[family] for family in dict.fromkeys(d.family for d in DRIVERS) if family in rows]
    CERTIFIED.write_text(text + head + "".join(f"{line}\n" for line in ordered))


def main() -> None:
    """Run what is asked for, print the rows, and write the document."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="drivers, by the beginning of their names (default: all)")
    parser.add_argument("--get", action="store_true", help="download drivers instead")
    parser.add_argument("--certify", action="store_true", help="run `shpy certify` once on each driver instead")
    parser.add_argument("--print", action="store_true", help="do not write docs/drivers.md or docs/certify.md")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of each driver, after which no program begins")
    parser.add_argument("--here", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.here:
        run_here(given.here, set(json.load(sys.stdin)), given.seconds)
        return
    chosen = [d for d in DRIVERS if not given.names or d.name in given.names] or [
        d for d in DRIVERS if any(d.name.startswith(name) for name in given.names)
    ]
    if given.certify:
        chosen = list({driver.family: driver for driver in reversed(chosen)}.values())[::-1]
    for driver in chosen:
        if given.get:
            if driver.source and not driver.installed:
                driver.source.get()
        elif driver.installed and given.certify:
            row = certify(driver)
            print(row, flush=True)
            if not given.print:
                write_certified(row)
        elif driver.installed:
            row = run(driver, given.seconds).row(driver)
            print(row, flush=True)
            if not given.print:
                write_table({driver.name: row})
        else:
            print(f"{driver.name} is not installed: python -m tests.drivers --get '{driver.name}'")


if __name__ == "__main__":
    main()
