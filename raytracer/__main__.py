"""`python -m raytracer`, the same as the command `raytracer`."""

import sys

from shpy_start import raytracer

sys.exit(raytracer())
