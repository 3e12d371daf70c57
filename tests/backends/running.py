"""What tests of backends run programs with: the names of shpy.testing.conformance.running."""

from shpy.testing.conformance.running import (
    BACKENDS,
    LANES,
    PACKETS,
    TARGETS,
    TILES,
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
    "WIDTHS",
    "DenormalWatch",
    "differs",
    "flushes_denormals",
    "kernel",
    "run",
]
