"""`python -m shpy`, the same as the command `shpy`."""

import sys

from shpy.cli import main

sys.exit(main())
