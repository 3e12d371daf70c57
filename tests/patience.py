"""Give the limits of waiting tests, which only end what hangs: they are far above the time that a busy machine takes.

Clocks go on while a virtual machine is paused, for half an hour at times. So a loop that polls counts its pauses: it is
`wait_until` of `benchmarks.pages`.
"""

from typing import Final

HANGING: Final = 900.0
"""Seconds after which a process hangs; `faulthandler_timeout` of pyproject ends a test that takes twice as long."""
PAGE: Final = 120_000
"""Milliseconds that a test waits for a change of a page."""
