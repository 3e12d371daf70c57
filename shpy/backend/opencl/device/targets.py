"""The functions that OpenCL C has, for the passes that replace all others.

Stage: compile.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from shpy.ir.ops import TRANSCENDENTALS
from shpy.passes.pipeline import Target

TARGET: Final = Target("opencl", native=TRANSCENDENTALS)
PACKET_TARGET: Final = replace(TARGET, vector=True)
