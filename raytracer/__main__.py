"""`python -m raytracer`, the same as the command `raytracer`."""

import sys

from raytracer.cli import main

sys.exit(main())
