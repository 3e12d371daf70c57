"""The report of a certificate, printed as checks end and written as JSON.

Stage: test. The report names no person and no folder.
"""

from __future__ import annotations

import hashlib
import os
import platform
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

from shpy.backend.base import Device
from shpy.backend.registry import backend
from shpy.command import processor
from shpy.packages import DISTRIBUTION, installed
from shpy.testing.certify.findings import SHOWN, DeviceChoice, Finding
from shpy.testing.certify.golden import FILE
from shpy.testing.certify.sections import SectionRun

FORMAT = 1
"""The version of the JSON's layout."""
_PACKAGES = (DISTRIBUTION, "numpy", "pyopencl", "moderngl", "mpmath")
_SPOKEN = {
    "same": "same",
    "denormals": "same but for denormals",
    "refused": "refused",
    "absent": "not checked",
    "differs": "DIFFER",
    "failed": "FAILED",
}


def device_of(target: DeviceChoice) -> Device:
    """Return the device of a target."""
    return backend(target.backend).devices()[target.device or 0]


def device_lines(target: DeviceChoice) -> list[str]:
    """Return the device in words."""
    device = device_of(target)
    lanes = f", {target.lanes} lane{'s' if target.lanes != 1 else ''}" if target.lanes else ""
    lines = [f"{target.backend}: {device.name}{lanes}"]
    return lines + [f"  {line}" for line in (device.version, *device.notes) if line]


def section_line(ran: SectionRun) -> str:
    """Return the findings of a section, in a line."""
    counted = [f"{n} {spoken}" for verdict, spoken in _SPOKEN.items() if (n := ran.count(verdict))]
    counted += [f"{ran.left} not run"] if ran.left else []
    text = f"  {ran.section.name:12} {ran.section.title:38} {', '.join(counted)}"
    worst = max(((f.ulp or 0, name) for name, f in ran.findings.items()), default=(0, ""))
    if worst[0]:
        text += f"; error up to {worst[0]:.3g} ULP ({worst[1]})"
    return f"{text} ({duration(ran.seconds)})"


def duration(seconds: float) -> str:
    """Seconds in words: "52 s", "11 minutes", "3.5 hours"."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} minutes" if seconds < 6000 else f"{seconds / 3600:.1f} hours"


def left_line(ran: SectionRun, target: DeviceChoice) -> list[str]:
    """Return the command that runs the checks for which a section had no time."""
    if not (ran.cut and ran.findings):
        return []
    options = [f"--{name} {value}" for name, value in target.options.items()]
    name = ran.section.name
    words = ["shpy certify --backend", target.backend, *options, "--section", name, "--full -o", f"{name}.json"]
    every = duration(ran.seconds / len(ran.findings) * len(ran.section.checks))
    return [f"    to run all, in about {every}: {' '.join(words)}"]


def difference_lines(ran: SectionRun) -> list[str]:
    """Return the first checks that differ with their inputs, and why others were refused or not made."""
    lines = []
    for number, (name, finding) in enumerate(ran.wrong.items()):
        if number == SHOWN:
            lines.append(f"    and {len(ran.wrong) - SHOWN} more: the JSON names them all")
            break
        first, *rest = finding.detail.splitlines() or [""]
        lines += [f"    {name}: {first}", *(f"      {line}" for line in rest)]
    for verdict, spoken in (("absent", "not checked"), ("refused", "refused with an error, never run wrong")):
        details = [f.detail.splitlines()[0] for f in ran.findings.values() if f.verdict == verdict and f.detail]
        reasons = Counter(grouped(details)).most_common()
        listed = [reason if count == len(details) else f"{reason} ({count})" for reason, count in reasons[:SHOWN]]
        more = [f"{len(reasons) - SHOWN} other reasons"] if len(reasons) > SHOWN else []
        lines += [f"    {spoken}: {', '.join(listed + more)}"] if reasons else []
    return lines


def grouped(reasons: Sequence[str]) -> list[str]:
    """Return the reasons; those that differ in their first word alone, a function's name, get all these words."""
    words: dict[str, dict[str, None]] = {}
    for reason in reasons:
        first, _, rest = reason.partition(" ")
        words.setdefault(rest, {})[first] = None
    return [f"{', '.join(words[rest])} {rest}" for rest in (reason.partition(" ")[2] for reason in reasons)]


def verdict(rans: Sequence[SectionRun]) -> str:
    """Return the verdict on one device: "same bits", "same bits but for denormals", "differs", or "not run"."""
    if not any(ran.findings for ran in rans):
        return "not run"
    if any(ran.wrong for ran in rans):
        return "differs"
    return "same bits but for denormals" if any(ran.count("denormals") for ran in rans) else "same bits"


def verdict_lines(rans: Sequence[SectionRun]) -> list[str]:
    """Return the verdict, the number of its checks, and the meaning of its words."""
    text, left = verdict(rans), sum(ran.left for ran in rans)
    meaning = ["     Denormals are numbers nearer to 0 than 1.18e-38. This device takes them for 0."]
    explained = meaning if "denormals" in text else []
    if left and text != "differs":
        run = sum(len(ran.findings) for ran in rans)
        text += f", in the {run:,} of {run + left:,} checks that were run"
    return [f"  -> {text}", *explained]


def certificate(results: Mapping[DeviceChoice, Sequence[SectionRun]], full: bool) -> dict[str, Any]:
    """Return the record: the machine, each device, and every finding."""
    return {
        "format": FORMAT,
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "full": full,
        "complete": not any(ran.left for rans in results.values() for ran in rans),
        "verdict": "differs" if any(verdict(rans) == "differs" for rans in results.values()) else "same bits",
        "golden": hashlib.sha256(FILE.read_bytes()).hexdigest()[:16],
        "machine": {
            "system": f"{platform.system()} {platform.release()}",
            "architecture": platform.machine(),
            "processor": processor(),
            "cores": os.cpu_count(),
            "python": platform.python_version(),
            "packages": {name: installed(name) for name in _PACKAGES},
        },
        "targets": [_target(target, rans) for target, rans in results.items()],
    }


def _target(target: DeviceChoice, rans: Sequence[SectionRun]) -> dict[str, Any]:
    device = device_of(target)
    return {
        "backend": target.backend,
        "device": {
            "index": target.device or 0,
            "name": device.name,
            "version": device.version,
            "features": list(device.features),
            "notes": list(device.notes),
        },
        "lanes": target.lanes or "auto",
        "verdict": verdict(rans),
        "sections": {
            ran.section.name: {
                "checks": len(ran.section.checks),
                "not run": ran.left,
                "seconds": round(ran.seconds, 1),
                "findings": {name: _finding(finding) for name, finding in ran.findings.items()},
            }
            for ran in rans
        },
    }


def _finding(finding: Finding) -> dict[str, Any]:
    return {name: value for name, value in asdict(finding).items() if value not in (None, "", ())}
