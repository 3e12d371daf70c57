"""Tools that show whether a program gives the same everywhere, and where it does not.

Stage: test, above programs and kernels; `import shpy as sh` brings it as `sh.testing`.

    sh.testing.assert_equivalent(program, x)         # every backend, every lane width, every bit
    sh.testing.assert_golden(program, x, name="p")   # the bits of golden/p.npz, in this version and later ones
    sh.testing.first_nan(program, x)                 # the first operation that gives NaN or infinity
    sh.testing.first_divergence(program, x)          # the first statement at which two backends part
    sh.testing.programs()                            # a hypothesis strategy of programs
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from shpy.errors import ShpyError
from shpy.packages import install
from shpy.testing.divergence import Divergence, Row, first_divergence
from shpy.testing.equivalence import Agreement, assert_equivalent
from shpy.testing.flushes import Flush
from shpy.testing.generated.inputs import inputs
from shpy.testing.golden import assert_golden
from shpy.testing.nonfinite import NonFinite, first_nan
from shpy.testing.reference import targets

if TYPE_CHECKING:
    from hypothesis.strategies import SearchStrategy

    from shpy.testing.generated.source import Generated

__all__ = [
    "Agreement",
    "Divergence",
    "Flush",
    "NonFinite",
    "Row",
    "assert_equivalent",
    "assert_golden",
    "first_divergence",
    "first_nan",
    "inputs",
    "programs",
    "targets",
]


def programs(endless: bool = False, derives: bool = False) -> SearchStrategy[Generated]:
    """Return a hypothesis strategy of well-typed programs that end, with nested loops, branches and exits, that shrink.

    Each is a recorded program with the same four inputs, for which `inputs(program, count)` gives arrays; its `text` is
    the source. Only operations with one exact answer are used: every backend must give the same bits. With `endless`,
    loops may run on until `loop_limit=program.tree.loop_limit` stops them. With `derives`, programs compute with
    denormals and with numbers that a driver's compiler can derive. Raises ShpyError without hypothesis.
    """
    try:
        from shpy.testing.generated import strategy
    except ImportError as error:
        raise ShpyError(f"programs() needs {error.name}", cure=install("hypothesis")) from error
    return strategy.programs(endless=endless, derives=derives)
