"""The names of shpy.testing.conformance.running, with which tests of backends run programs."""

from shpy.testing.conformance.running import (
    BACKENDS,
    LANES,
    PACKETS,
    TARGETS,
    TILES,
    WIDE,
    WIDTHS,
    DenormalWatch,
    differs,
    flushes_denormals,
    kernel,
    run,
)

__all__ = [
    "BACKENDS",
    "LANES",
    "PACKETS",
    "TARGETS",
    "TILES",
    "WIDE",
    "WIDTHS",
    "DenormalWatch",
    "differs",
    "flushes_denormals",
    "kernel",
    "run",
]
