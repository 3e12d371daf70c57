"""Trials of a driver's compiler: each extra is built, run and compared.

Stage: compile. A driver may print errors of a build to the terminal, refuse a kernel that it has built, or end the
process. So the trials run in a process of their own (`works`), whose outcome is kept on disk for each device and
version of its driver. This file is what that process runs; it needs pyopencl and numpy alone. To start it and its
driver takes 0.4 to 1.8 s, so the trials of a driver that is known to be harmless run here, in one kernel (`outcomes`),
which takes 0.03 to 0.1 s.

    works((0, 0), [], {"double": Trial("int", "a[0] *= 2;", (3,), (6,))})                    # {"double"}
    outcomes(cl, context, [], {"double": Trial("int", "a[0] *= 2;", (3,), (6,))}, "")        # {"double"}
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
    needs: str = ""
    """The macro of a compiler that has what the statements call; without it they are left out of `outcomes`."""

    def text(self, name: str) -> str:
        """Return the kernel."""
        return f"__kernel void try_{name}(__global {self.type} *a) {{\n    {self.statements}\n}}\n"


class Unfinished(Exception):
    """The trials could not be run, through no fault of the driver; the message says why."""


_APART = 64
"""Numbers from the array of a trial in `outcomes` to the next: as many as the longest vector has."""


def outcomes(
    cl: Any, context: Any, options: list[str], trials: Mapping[str, Trial], declarations: str
) -> frozenset[str] | None:
    """Run trials in one kernel and in this process; return the names of those that succeed.

    `declarations` are of all functions that the trials call. Return None where the driver refuses the kernel.
    """
    import numpy as np

    blocks, array = [], np.zeros((len(trials), _APART), np.int32)
    for at, trial in enumerate(trials.values()):
        block = f"{{ __global {trial.type} *a = (__global {trial.type} *)(all + {at * _APART}); {trial.statements} }}"
        blocks.append(f"#ifdef {trial.needs}\n{block}\n#endif" if trial.needs else block)
        _numbers(array[at], trial)[: len(trial.given)] = trial.given
    text = declarations + "\n".join(["__kernel void try_all(__global int *all) {", *blocks, "}\n"])
    try:
        _run(cl, context, text, "try_all", options, array)
    except cl.Error:
        return None
    return frozenset(name for at, (name, t) in enumerate(trials.items()) if _is_wanted(_numbers(array[at], t), t))


def _numbers(array: Any, trial: Trial) -> Any:
    """Return an array of ints as the numbers of a trial."""
    import numpy as np

    return array.view(np.float32 if trial.type.startswith("float") else np.int32)


def _is_wanted(array: Any, trial: Trial) -> bool:
    import numpy as np

    expected = np.array(trial.wanted, array.dtype)
    return bool(np.array_equal(array[: len(expected)], expected))


def _run(cl: Any, context: Any, text: str, name: str, options: list[str], array: Any) -> None:
    """Build a kernel of a text, and run one work item of it on an array, which gets the results."""
    flags = cl.mem_flags
    buffer = cl.Buffer(context, flags.READ_WRITE | flags.COPY_HOST_PTR, hostbuf=array)
    program = cl.Program(context, text).build(options, cache_dir=False)
    queue = cl.CommandQueue(context)
    cl.Kernel(program, name)(queue, (1,), (1,), buffer)
    cl.enqueue_copy(queue, array, buffer)
    queue.finish()


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


def _succeeds(cl: Any, context: Any, name: str, fields: Mapping[str, Any], options: list[str]) -> bool:
    import numpy as np

    text = fields["text"]
    trial = Trial(**{key: value for key, value in fields.items() if key != "text"})
    array = np.array(trial.given, np.float32 if trial.type.startswith("float") else np.int32)
    more = [trial.option] if trial.option else []
    try:
        _run(cl, context, trial.declarations + text, f"try_{name}", [*options, *more], array)
    except cl.Error:
        return False
    return _is_wanted(array, trial)


if __name__ == "__main__":
    _main()
