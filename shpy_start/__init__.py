"""The start of the commands: Ctrl-C during imports gives one line and status 130, without a traceback.

A package of its own, since whatever stands in `shpy` is imported after `shpy`, which takes most of that time. For the
same reason `shpy` and `raytracer` import it first: `python -m shpy` imports `shpy` before the module that starts the
command, and Ctrl-C is quiet from the import of this package on. pytest's plugin stands beside it, since every run of
pytest loads that.

    sys.exit(start("shpy", "shpy.cli"))     # calls shpy.cli.main()
"""

from __future__ import annotations

import atexit
import gc
import importlib
import os
import signal
import sys
from dataclasses import dataclass
from types import FrameType

COMMANDS = ("shpy", "raytracer")


@dataclass(frozen=True)
class _Leave:
    """A handler of SIGINT that ends the process. `name` is the command's."""

    name: str

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """End the process: an exception would pass through half of an import, where some packages catch it."""
        os.write(2, f"{self.name}: stopped\n".encode())
        os._exit(130)


def start(name: str, module: str) -> int:
    """Import a module and call its `main`; return the exit status. `name` is the command's.

    The cycle collector does not walk over the objects of imports, nor over all objects at the end, when the system
    takes back the memory: a path-traced `raytracer render mixed` of 64 x 48 takes 1.92 s of CPU for 2.12, compiled
    before.
    """
    _be_quiet(name)
    gc.disable()
    try:
        main = importlib.import_module(module).main
    finally:
        if isinstance(signal.getsignal(signal.SIGINT), _Leave):
            signal.signal(signal.SIGINT, signal.default_int_handler)
    gc.freeze()
    gc.enable()
    atexit.register(gc.freeze)
    status: int = main()
    return status


def _be_quiet(name: str) -> None:
    """Let Ctrl-C end the process in one line, if it raises KeyboardInterrupt: a shell's background jobs ignore it."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _Leave(name))


def _run_by_name() -> str | None:
    """Return the package that `python -m` is still importing, or None.

    While `-m` looks for the module, `sys.argv[0]` is "-m"; `sys.orig_argv` has the name.
    """
    if sys.argv[:1] != ["-m"]:
        return None
    option = sys.orig_argv[-len(sys.argv)]
    return option.rpartition("m")[2] if option.startswith("-") else option  # -mshpy, -Imshpy


def shpy() -> int:
    """Run the command `shpy`."""
    return start("shpy", "shpy.cli")


def raytracer() -> int:
    """Run the command `raytracer`."""
    return start("raytracer", "raytracer.cli")


if (_name := _run_by_name()) in COMMANDS:
    _be_quiet(str(_name))
