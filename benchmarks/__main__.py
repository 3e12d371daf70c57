"""`python -m benchmarks`: see `benchmarks.command`."""

import sys

from shpy_start import start

if __name__ == "__main__":
    sys.exit(start("benchmarks", "benchmarks.command"))
