"""Nodes of the IR: values are assigned once, variables are slots, control flow is a tree.

Stage: represent. `lang` makes these, `passes` rewrite them, `backend` prints them.

    Stmt = Let | Store | Call | If | Loop | Break | Continue | Return | Discard
    Region = tuple[Stmt, ...]

Nodes refer to values and variables by id (unique in their function, two separate counts). A value is visible in its
region and those nested in it; besides, `continuing` and `until` see the values that the body's own region makes, when
no `Continue` of that loop can skip them. Anything else leaves a region through a variable only.
Every variable is zero at the function's start; loading one is the op `load`.
Exits (Break, Continue, Return, Discard) are last in their region. Locations and names of values and variables do not
count for equality, nor does the metadata of params; names of ports, params, tables and functions do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field

from shpy.errors import Loc as Loc
from shpy.ir.frozen import dataclass
from shpy.ir.metadata import NOTHING, About
from shpy.ir.types import Type

MAX_REGION_DEPTH = 64
MAX_LOOP_DEPTH = 12
MAX_ARRAY = 4096
MAX_PART_DEPTH = 64
"""The largest depth of nested structures of inputs and outputs."""
MAX_TABLE = 2**31 - 1
"""The most elements of a table, so that an `i` can index them."""


@dataclass(frozen=True, slots=True)
class Value:
    """A result that is assigned once."""

    id: int
    type: Type
    name: str | None = field(default=None, compare=False)
    loc: Loc | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Variable:
    """A slot: `length` None for one value of `type`, else an array of that many."""

    id: int
    type: Type
    length: int | None = None
    name: str | None = field(default=None, compare=False)
    loc: Loc | None = field(default=None, compare=False)


Attr = None | int | str | tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Let:
    """`value = op(args)`.

    The content of `attr` depends on the op:
    `const`: one number a component: ints and bools as they are, floats as the bits of the binary64 that holds them;
    `load`: the variable's id (an array's takes the index as its one argument);
    `swizzle`: the components picked; `param`, `table`, `table_size`, `call`: the name. Others: None.
    """

    value: Value
    op: str
    args: tuple[int, ...] = ()
    attr: Attr = None


@dataclass(frozen=True, slots=True)
class Store:
    """`variable[index].components = value`; `components` None stores all, `index` is for arrays only.

    An index out of range drops the store. The value has as many components as are stored.
    """

    variable: int
    value: int
    components: tuple[int, ...] | None = None
    index: int | None = None
    loc: Loc | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Call:
    """Call a function that is more than an expression.

    `args` follows `Function.inputs`: a value's id for a Value, a variable's id for a Variable (by reference).
    `results` are new values, one for each of `Function.outputs`.
    """

    function: str
    args: tuple[int, ...]
    results: tuple[Value, ...] = ()
    loc: Loc | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class If:
    """Run `then` where the bool value `condition` holds, else `orelse`."""

    condition: int
    then: Region
    orelse: Region = ()
    loc: Loc | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Loop:
    """`while true: body; continuing; if until: break`.

    `Continue` goes to `continuing`, in which no exit may stand. `until` None never ends the loop.
    `turns` is the number of iterations that it takes at most, if that is known when it is recorded.
    """

    body: Region
    continuing: Region = ()
    until: int | None = None
    turns: int | None = None
    loc: Loc | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Break:
    """Leave the innermost loop."""

    loc: Loc | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Continue:
    """Jump to the `continuing` region of the innermost loop."""

    loc: Loc | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Return:
    """Leave the function; its outputs were stored before."""

    loc: Loc | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Discard:
    """End the whole element, from any function: it writes nothing. `status` says why: see `Status`."""

    status: int = 0
    loc: Loc | None = field(default=None, compare=False)


class Status:
    """The end of an element: the value of the status output that every executable gives."""

    DISCARDED = 0
    WRITTEN = 1
    FIRST_LOOP = 2  # 2 + k: the k-th limited loop ran out of iterations
    DEVICE_STOPPED = -1  # the device stopped a loop of its own accord


Stmt = Let | Store | Call | If | Loop | Break | Continue | Return | Discard
Region = tuple[Stmt, ...]
EXITS = (Break, Continue, Return, Discard)


@dataclass(frozen=True, slots=True)
class Function:
    """`inputs`: Values come by value, Variables by reference. `outputs` are slots, stored before it ends.

    `variables` are all other slots. `pure` marks straight-line code (no Call, no control flow but an If of an
    `any_lane` without `orelse`, one output, inputs by value): such a function is called by the op `call`, as an
    expression. Any other is called by the statement `Call`.
    `alone` marks a function that each lane of a packet should run by itself. It has no array parameters.
    `tangent` is the name of the user's rule for its derivative, None for the derivative of its body: a function of the
    outputs, the inputs, and a tangent of each input of floats, that gives the tangents of the outputs.
    """

    name: str
    inputs: tuple[Value | Variable, ...]
    outputs: tuple[Variable, ...]
    variables: tuple[Variable, ...]
    body: Region
    pure: bool = False
    loc: Loc | None = field(default=None, compare=False)
    alone: bool = False
    tangent: str | None = None


@dataclass(frozen=True, slots=True)
class Port:
    """The user's view of an input or output of the entry: its name and language type (`Point3f`, `Attrib1i`)."""

    name: str
    kind: str


@dataclass(frozen=True, slots=True)
class Param:
    """A uniform, with its initial value in the form of a `const`, and its metadata."""

    name: str
    kind: str
    type: Type
    value: tuple[int, ...]
    about: About = field(default=NOTHING, compare=False)


@dataclass(frozen=True, slots=True)
class Table:
    """Random-access data of `rank` axes, given at run time; `size` is its shape where that is fixed."""

    name: str
    type: Type
    rank: int
    size: tuple[int, ...] | None = None


@dataclass(frozen=True, slots=True)
class Module:
    """A recorded program. `functions` come callees first; the last is the entry, whose inputs are all Values."""

    name: str
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    params: tuple[Param, ...]
    tables: tuple[Table, ...]
    functions: tuple[Function, ...]

    @property
    def entry(self) -> Function:
        """The function that runs for every element."""
        return self.functions[-1]

    def __str__(self) -> str:
        return _printer(self)


_printer: Callable[[Module], str] = repr


def bind_printer(printer: Callable[[Module], str]) -> None:
    """Have `str` of a module call this function, `shpy.ir.text.print_module`: the text imports the nodes."""
    global _printer
    _printer = printer
