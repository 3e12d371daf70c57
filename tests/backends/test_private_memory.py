"""Local arrays of any size: a kernel runs right, in smaller groups if need be, or is refused; no process ends by it.

Each case runs in a process of its own, across the bound of the device and of its threads' stacks, at every width.
"""

import json
import os
import subprocess
import sys

import pytest
from patience import HANGING
from test_processes import ROOT

from shpy.backend.opencl.device.compiler_trials import SIZES, most_private, thread_stack, trial_of
from shpy.backend.opencl.device.driver import machine_of
from shpy.backend.opencl.packets.widen import WIDER, WIDTHS

SCRIPT = """
import json, sys
import numpy as np
import shpy as sh
from shpy import SH_FOR

case = json.loads(sys.argv[1])
T, length, arrays, called = getattr(sh, case["type"]), case["length"], case["arrays"], case["called"]
rows = 3 if T is sh.Matrix3f else 1


def first(v):
    return v[0][0] if rows == 3 else v if T is sh.Attrib1f else v.x


def filled(x, n):
    values = [sh.Array(T, length) for _ in range(arrays if not called else 1)]
    with SH_FOR(0, n) as i:
        for k, v in enumerate(values):
            y = x + sh.Attrib1f((i & 3) + k)  # small numbers, whose sums are exact
            v[i] = T(*[y] * case["components"])
    total = sh.Attrib1f(0)
    with SH_FOR(0, n, 7) as i:
        for v in values:
            total += first(v[i])
    return total


subroutine = sh.subroutine(filled)


@sh.program
def sums(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    if not called:
        return filled(x, n)
    total = sh.Attrib1f(0)
    for k in range(arrays):
        total += subroutine(x + k, n)
    return total


def wanted(x, n):
    i = np.arange(0, n, 7)
    return sum((x + k + (i & 3)).sum() for k in range(arrays))


x = (np.arange(700) % 5).astype(np.float32)
n = np.minimum(50 + np.arange(700) % 3, length).astype(np.int32)
try:
    kernel = sums.compile(case["backend"], **case["options"])
except sh.CompileError as error:
    print(json.dumps({"error": str(error), "line": error.loc.line}))
else:
    for _ in range(case["runs"]):
        found = kernel(x, n)
    notes = " ".join(kernel.notes)
    right = np.array_equal(found, np.float32([wanted(a, b) for a, b in zip(x.tolist(), n.tolist())]))
    full = kernel(x[:9], np.full(9, length, np.int32))
    right &= np.array_equal(full, np.float32([wanted(a, length) for a in x[:9].tolist()]))
    print(json.dumps({"right": right, "notes": notes}))
"""
COMPONENTS = {"Attrib1f": 1, "Attrib3f": 3, "Attrib4f": 4, "Matrix3f": 9}
EVERY_WIDTH = (1, *WIDTHS, *WIDER)


def ran(backend, type, length, arrays=1, *, called=False, runs=3, **options):
    """Return what a process with this kernel says; it must not end otherwise."""
    case = {"type": type, "length": length, "arrays": arrays, "called": called, "backend": backend, "runs": runs}
    case |= {"options": options, "components": COMPONENTS[type]}
    environment = os.environ | {"PYTHONPATH": ROOT, "SHPY_QUIET": "1"}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, json.dumps(case)], env=environment, text=True, capture_output=True,
        timeout=HANGING,
    )  # fmt: skip
    assert done.returncode == 0, (case, done.returncode, done.stderr)
    return {"lanes": options.get("lanes", 1), **json.loads(done.stdout)}


def check(told):
    """Let a kernel be right, or refused with its line and something to do."""
    if "has no vectors of" in told.get("error", ""):
        assert told["lanes"] not in (1, *machine_of(None).widths)
    elif "error" in told:
        assert "local arrays of" in told["error"]
        assert "smaller arrays" in told["error"]
        assert told["line"] > 1
    else:
        assert told["right"]


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("type", "length", "arrays", "options"),
    [
        ("Attrib1f", 4096, 2, {"lanes": 16}),
        ("Matrix3f", 4096, 1, {"lanes": 1}),
        pytest.param("Matrix3f", 4096, 1, {"lanes": 16}, marks=pytest.mark.slow),
        ("Attrib4f", 4096, 8, {}),
    ],
)
def test_large_arrays_run_in_smaller_groups(type, length, arrays, options):
    told = ran("opencl", type, length, arrays, runs=1, **options)  # a run takes a CPU second
    check(told)
    assert "error" in told or "groups of" in told["notes"]


def test_what_no_group_holds_is_refused_at_its_line():
    told = ran("opencl", "Attrib4f", 4096, 70, lanes=1)
    most = machine_of(None).most_private
    assert f"the local arrays of an element take {70 * 65536:,} bytes, more than the {most:,}" in told["error"]
    check(told)


@pytest.mark.slow
@pytest.mark.parametrize("lanes", EVERY_WIDTH)
@pytest.mark.parametrize(
    ("type", "length"), [("Attrib1f", 4096), ("Attrib3f", 1500), ("Attrib4f", 4096), ("Matrix3f", 500)]
)
def test_sizes_across_the_bound_at_every_width(type, length, lanes):
    """From a tenth of a group's bound to five times that of a single work item."""
    each = length * lanes * 4 * (4 if type == "Attrib3f" and lanes == 1 else COMPONENTS[type])
    most, whole = machine_of(None).most_private, 64 if lanes == 1 else 16
    sizes = {max(1, int(most * share / each)) for share in (0.1 / whole, 0.9 / whole, 1.2 / whole, 0.5, 0.9, 1.2, 2)}
    for arrays in sorted(sizes):
        if arrays <= 80:
            check(ran("opencl", type, length, arrays, lanes=lanes))


@pytest.mark.slow
@pytest.mark.parametrize("lanes", EVERY_WIDTH)
@pytest.mark.parametrize("calls", [1, 6, 12, 40])
def test_arrays_of_subroutines_count_at_each_call(calls, lanes):
    check(ran("opencl", "Attrib1f", 4096, calls, called=True, lanes=lanes))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["numpy", "glsl"])
def test_other_backends_bound_them_too(backend):
    check(ran(backend, "Attrib1f", 900, 2))
    told = ran(backend, "Attrib4f", 4096, 40)
    check(told)
    assert ("error" in told) is (backend == "glsl")


PEAK = """
import resource, sys
import numpy as np
import shpy as sh
from shpy import SH_FOR


@sh.program
def last(x: sh.Attrib1f) -> sh.Attrib1f:
    kept = sh.Array(sh.Attrib4f, 4096)
    with SH_FOR(0, 4096, 1023) as i:
        kept[i] = sh.Attrib4f(x, x + 1, x + 2, x + sh.Attrib1f(i))
    return kept[4092].w + kept[1].x


kernel = last.compile("numpy")
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
x = np.arange(100_000, dtype=np.float32)
assert np.array_equal(kernel(x), x + 4092)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""


def test_arrays_of_numpy_take_bounded_memory():
    """100,000 elements with 64 kB each run in blocks: 6.5 GB in all, some 2 GB in the tiles of other programs."""
    done = subprocess.run(
        [sys.executable, "-c", PEAK], env=os.environ | {"PYTHONPATH": ROOT}, text=True, capture_output=True,
        timeout=HANGING,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 256


def test_the_bound_of_a_stack():
    stack = thread_stack()
    assert stack is None or stack >= 1 << 14
    assert most_private(6 << 20, 8 << 20) == 3 << 20
    assert most_private(6 << 20, 2 << 20) == 768 << 10
    assert most_private(0, 128 << 10) == 48 << 10
    assert most_private(96 << 10, None) == 48 << 10
    assert most_private(0, None) == 16 << 10
    assert all(f"int big[{size // 4}]" in trial_of(size).statements for size in SIZES)
