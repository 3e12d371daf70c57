"""Compare a run with its golden hash; find inputs whose results differ, with numpy on this machine.

Stage: test. Takes a program and its arrays, returns a `Finding`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from shpy.testing.arrays import Array, differing, flat_leaves
from shpy.testing.certify.findings import SHOWN, DeviceChoice, Finding
from shpy.testing.certify.golden import digest
from shpy.testing.denormals import meets_denormals
from shpy.testing.observers import Setting


def results(setting: Setting, target: DeviceChoice) -> list[Array]:
    """Run a program on a target; return the leaves of its outputs."""
    kernel = target.compile(setting.program, **setting.options)
    return flat_leaves(kernel(*setting.inputs, **setting.named, shape=setting.shape))


def compare(setting: Setting, target: DeviceChoice, expected: str | None) -> tuple[Finding, list[Array]]:
    """Run a program on a target and compare its bits with the golden hash `expected`.

    If the hashes differ, the finding names inputs whose results differ from numpy's on this machine.
    """
    outputs = results(setting, target)
    checksum = digest(outputs)
    if checksum == expected:
        return Finding("same", hash=checksum), outputs
    if target.backend == "numpy":
        return Finding("differs", _strange(checksum, expected), checksum), outputs
    here = results(setting, DeviceChoice("numpy"))
    if digest(here) != expected:
        return Finding(
            "differs", f"numpy on this machine differs too: {_strange(digest(here), expected)}", checksum
        ), outputs
    return compare_arrays(setting, target, outputs, here), outputs


def _strange(checksum: str, expected: str | None) -> str:
    return f"the hash is {checksum}, and the package ships {expected or 'none'}"


def compare_arrays(setting: Setting, target: DeviceChoice, outputs: list[Array], expected: list[Array]) -> Finding:
    """Compare results with numpy's: the same bits, the same except for denormals, or the first inputs that differ."""
    count = int(np.prod(setting.shape)) if setting.shape else len(setting.inputs[0])
    rows = [[leaf.reshape(count, -1) for leaf in leaves] for leaves in (outputs, expected)]
    wrong = np.zeros(count, np.bool_)
    for a, b in zip(*rows, strict=True):
        wrong |= differing(a, b).any(axis=1)
    if wrong.any() and target.flushes:
        wrong &= ~meets_denormals(replace(setting, options={}))
        if not wrong.any():
            return Finding("denormals", hash=digest(outputs))
    elements = np.flatnonzero(wrong)
    if not len(elements):
        return Finding("same", hash=digest(outputs))
    shown = [f"{len(elements):,} of {count:,} elements differ"]
    for k in map(int, elements[:SHOWN]):
        a, b = ([leaf[k].tolist() for leaf in leaves] for leaves in rows)
        inputs = ", ".join(repr(x[k].tolist()) for x in setting.inputs) or f"element {k}"
        shown.append(f"for {inputs}: {_plain(a)}, not {_plain(b)}")
    return Finding("differs", "\n".join(shown), digest(outputs))


def _plain(leaves: list[Any]) -> str:
    flat = [number for leaf in leaves for number in leaf]
    return repr(flat[0]) if len(flat) == 1 else repr(flat)
