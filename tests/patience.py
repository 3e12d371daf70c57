"""Give the limits of waiting tests, which only end what hangs: they are far above the time that a busy machine takes.

Clocks go on while a virtual machine is paused, for half an hour at times. So loops that poll count their pauses.
"""

import time
from collections.abc import Iterator
from typing import Final

HANGING: Final = 3600.0
"""Seconds after which a process hangs."""
PAGE: Final = 120_000
"""Milliseconds that a test waits for a change of a page."""
_PAUSE: Final = 0.005
_PAUSES: Final = 20_000


def polls() -> Iterator[None]:
    """Pause before each iteration but the first one; raise AssertionError after at least 100 seconds of pauses."""
    yield
    for _ in range(_PAUSES):
        time.sleep(_PAUSE)
        yield
    raise AssertionError(f"it does not happen within {_PAUSES} pauses of {_PAUSE} s")
