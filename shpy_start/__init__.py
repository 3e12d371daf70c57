"""How the commands start: Ctrl-C while Python still imports packages is one line and status 130, and no traceback.

A package of its own, since whatever stands in `shpy` is imported after `shpy`, which takes most of that time.

    sys.exit(start("shpy", "shpy.cli"))     # calls shpy.cli.main()
"""

from __future__ import annotations

import importlib
import os
import signal
from types import FrameType


def start(name: str, module: str) -> int:
    """Import a module and call its `main`; gives the exit status. `name` is the command's."""

    def leave(number: int, frame: FrameType | None) -> None:
        # An exception would pass through half of an import, where some packages turn it into another one.
        os.write(2, f"{name}: stopped\n".encode())
        os._exit(130)

    before = signal.signal(signal.SIGINT, leave) if _is_usual() else None
    try:
        main = importlib.import_module(module).main
    finally:
        if before is not None:
            signal.signal(signal.SIGINT, before)
    status: int = main()
    return status


def _is_usual() -> bool:
    """Return whether Ctrl-C raises KeyboardInterrupt: it is ignored in what a shell runs in the background."""
    return signal.getsignal(signal.SIGINT) is signal.default_int_handler


def shpy() -> int:
    """Run the command `shpy`."""
    return start("shpy", "shpy.cli")


def raytracer() -> int:
    """Run the command `raytracer`."""
    return start("raytracer", "raytracer.cli")
