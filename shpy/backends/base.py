"""What a backend is: the protocol between `Kernel` (above) and the targets (below).

Stage: emit, compile, run. A backend takes a verified module as it was recorded, prepares it with `passes`, prints it
and runs it. It knows nothing of user arrays: `Kernel` checks and flattens them, and shapes what comes back.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Protocol

from numpy.typing import NDArray

from shpy.ir.nodes import Loc, Module
from shpy.ir.tabledata import TableData
from shpy.passes.modes import Math

__all__ = ["Array", "Backend", "Call", "Device", "Executable", "Math", "Options", "Precision", "TableData"]

Array = NDArray[Any]
Precision = Literal["f16", "f32", "f64"]


@dataclass(frozen=True, slots=True)
class Options:
    """How to compile. `loop_limit` None lets every loop run on; `device` is an index into `Backend.devices()`.

    `lanes` is how many elements a target that runs packets runs together; the others take only "auto" and 1.
    `math` says how exact functions are: see docs/numerics.md.
    """

    precision: Precision = "f32"
    loop_limit: int | None = 1_048_576
    device: int | None = None
    lanes: int | Literal["auto"] = "auto"
    math: Math = "strict"


@dataclass(frozen=True, slots=True)
class Device:
    """One device of a backend: its name, driver version, and what it can do, in words (`f64`, `images`, ...)."""

    name: str
    version: str
    features: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Call:
    """One run over `shape` elements (n of them in C order).

    `inputs` follow the entry's: each C-contiguous, (n, size) or (n,) for scalars, or with 1 instead of n for a
    uniform. `outputs` likewise with n, to be written in place, only where the element's status is WRITTEN. dtypes are
    those of `ir.constants.DTYPES` at the working precision (f is float64 at f64; float16 at f16).
    `params` are arrays of shape () or (size,) by name; `tables` by name.
    """

    shape: tuple[int, ...]
    inputs: tuple[Array, ...]
    outputs: tuple[Array, ...]
    params: dict[str, Array]
    tables: dict[str, TableData]

    @property
    def count(self) -> int:
        """The number of elements."""
        n = 1
        for extent in self.shape:
            n *= extent
        return n


class Executable(Protocol):
    """A compiled module."""

    @property
    def source(self) -> str:
        """The emitted text, as it was given to the target."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Facts for the user: flushed denormals, for example."""

    @property
    def loops(self) -> tuple[Loc | None, ...]:
        """The k-th limited loop's line: status FIRST_LOOP + k names it."""

    @property
    def writes_all(self) -> bool:
        """Return whether every element is written, whatever the data: no discard, and no loop that could be stopped."""

    def run(self, call: Call) -> Array | None:
        """Run it; gives the int32 status of each element, (n,), or None when every element was written."""


class Backend(Protocol):
    """A target."""

    name: str

    def devices(self) -> list[Device]:
        """Every device there is; raises BackendUnavailable, with the command that mends it, when there is none."""

    def compile(self, module: Module, options: Options) -> Executable:
        """Prepare, print and build; raises CompileError naming the user's line."""
