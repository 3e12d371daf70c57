"""`python -m shpy`, the same as the command `shpy`."""

import sys

from shpy_start import shpy

sys.exit(shpy())
