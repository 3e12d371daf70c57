"""On what it ran: processors, drivers and versions, for the head of a report.

>>> sorted(describe([]))[:2]
['cores', 'devices']
"""

from __future__ import annotations

import os
import platform
import re
from pathlib import Path
from typing import Any

import numpy as np

import shpy as sh
from benchmarks.peers import PEERS
from shpy.command import processor

_VECTORS = {"AVX-512": "avx512f", "AVX2": "avx2", "SSE 4.2": "sse4_2"}
"""The flags by which Linux tells that a processor has these vectors, the widest ones first."""


def vectors() -> str:
    """Return the widest vectors of the processor, as Linux tells them, with a word before; else ""."""
    listed = Path("/proc/cpuinfo")
    flags = listed.read_text().partition("flags")[2].split() if listed.is_file() else []
    return next((f" with {name}" for name, flag in _VECTORS.items() if flag in flags), "")


def opencl_version() -> str:
    """Return the version of the first OpenCL platform."""
    import pyopencl

    whole = pyopencl.get_platforms()[0].version.strip()
    return ", ".join(re.findall(r"PoCL \S+|LLVM [\d.]+", whole)) or whole


def describe(peers: list[str]) -> dict[str, Any]:
    """Processor, cores, system, our devices by backend, versions of Python, numpy and the peers, and the load."""
    devices = {b.name: ", ".join(d.name for d in b.devices) or f"missing: {b.cure}" for b in sh.backends()}
    if "missing" not in devices["opencl"]:
        devices["opencl"] += ", " + opencl_version()
    return {
        "processor": processor() + vectors(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "devices": devices,
        "peers": {PEERS[name].label: PEERS[name].version for name in peers if PEERS[name].modules},
        "load": [round(x, 1) for x in os.getloadavg()] if hasattr(os, "getloadavg") else None,
    }
