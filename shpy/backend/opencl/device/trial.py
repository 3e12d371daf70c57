"""Trials of a driver's compiler: each extra is built, run and compared, where it can harm nobody.

Stage: compile. A driver may print errors of a build to the terminal, refuse a kernel that it has built, or end the
process. So the trials run in a process of their own, whose outcome is kept on disk for each device and version of its
driver. This file is what that process runs; it needs pyopencl and numpy alone.

    works((0, 0), [], {"double": Trial("int", "a[0] *= 2;", (3,), (6,))})        # {"double"}
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

DECLARES = "declares"
"""The name of the trial that succeeds where a program may declare the functions of OpenCL C itself."""
_SECONDS = 120


@dataclass(frozen=True, slots=True)
class Trial:
    """Statements on `__global T *a`, which holds `given` numbers of 32 bits before and `wanted` ones after them."""

    type: str
    statements: str
    given: tuple[float, ...]
    wanted: tuple[float, ...]
    declarations: str = ""
    """The functions that the statements call, for a compiler for which the trial DECLARES has succeeded."""
    option: str = ""
    """The option that goes with the declarations."""

    def text(self, name: str) -> str:
        """Return the kernel."""
        return f"__kernel void try_{name}(__global {self.type} *a) {{\n    {self.statements}\n}}\n"


class Unfinished(Exception):
    """The trials could not be run, through no fault of the driver; the message says why."""


def works(place: tuple[int, int], options: list[str], trials: Mapping[str, Trial]) -> frozenset[str]:
    """Return the names of the trials that succeed on this device of this platform, in a process of their own.

    A trial that crashes or hangs its process fails, and the others continue in another process. Raises Unfinished if
    no process can be started, or if it runs no trial.
    """
    with tempfile.TemporaryDirectory() as folder:
        return _works(place, options, trials, folder)


def _works(place: tuple[int, int], options: list[str], trials: Mapping[str, Trial], folder: str) -> frozenset[str]:
    """Run the trials. pyopencl may leave the text of a failing build among the temporary files: in `folder`."""
    left = dict(trials)
    successes: set[str] = set()
    environment = {**os.environ, "TMPDIR": folder, "TEMP": folder, "TMP": folder}
    while left:
        asked = {name: {**asdict(trial), "text": trial.text(name)} for name, trial in left.items()}
        task = json.dumps({"place": place, "options": options, "trials": asked})
        try:
            ended = subprocess.run(
                [sys.executable, "-P", __file__],
                input=task,
                capture_output=True,
                text=True,
                timeout=_SECONDS,
                check=False,
                env=environment,
            )
            done, why = (
                ended.stdout,
                ((ended.stderr or "").strip().splitlines() or [f"exit status {ended.returncode}"])[-1],
            )
        except subprocess.TimeoutExpired as late:
            done, why = _text(late.stdout), f"no answer after {_SECONDS} s"
        except OSError as error:
            raise Unfinished(str(error)) from error
        told = [line.split() for line in done.splitlines() if line.startswith("trial ")]
        successes |= {name for _, name, outcome in told if outcome == "works"}
        begun = {name for _, name, _ in told}
        if not begun:
            raise Unfinished(why)
        left = {name: trial for name, trial in left.items() if name not in begun}
    return frozenset(successes)


def _text(output: bytes | str | None) -> str:
    """Return the text that a killed process wrote; subprocess gives bytes here even where text was requested."""
    return output.decode(errors="replace") if isinstance(output, bytes) else output or ""


def _main() -> None:
    task = json.load(sys.stdin)
    import pyopencl as cl

    platform, device = task["place"]
    chosen = cl.get_platforms()[platform].get_devices()[device]
    context = cl.Context([chosen])
    declares = False
    for name, trial in task["trials"].items():
        print("trial", name, "begun", flush=True)
        if name != DECLARES and not declares:
            trial = {**trial, "declarations": "", "option": ""}
        if _succeeds(cl, context, name, trial, task["options"]):
            print("trial", name, "works", flush=True)
            declares |= name == DECLARES


def _succeeds(cl: Any, context: Any, name: str, trial: Mapping[str, Any], options: list[str]) -> bool:
    import numpy as np

    dtype = np.float32 if trial["type"].startswith("float") else np.int32
    array = np.array(trial["given"], dtype)
    try:
        flags = cl.mem_flags
        buffer = cl.Buffer(context, flags.READ_WRITE | flags.COPY_HOST_PTR, hostbuf=array)
        text, more = trial["declarations"] + trial["text"], [trial["option"]] if trial["option"] else []
        program = cl.Program(context, text).build([*options, *more], cache_dir=False)
        queue = cl.CommandQueue(context)
        cl.Kernel(program, f"try_{name}")(queue, (1,), (1,), buffer)
        cl.enqueue_copy(queue, array, buffer)
        queue.finish()
    except cl.Error:
        return False
    expected = np.array(trial["wanted"], dtype)
    return bool(np.array_equal(array[: len(expected)], expected))


if __name__ == "__main__":
    _main()
