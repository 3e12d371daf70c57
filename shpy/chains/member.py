"""Members: the kernels of a chain, connected with its streams by name.

Stage: run. An input reads the stream of its name, and an input annotated `sh.Table[…]` or `sh.Texture2D[…]` reads it by
index. An output replaces the stream of its name. A single output without a name replaces the only input of its type,
be it an element or a Table.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol

from shpy.algebra import alike, signature, type_name, with_article
from shpy.backend.registry import backend as backend_named
from shpy.errors import ShpyTypeError
from shpy.ir.nodes import Discard
from shpy.ir.traverse import walk
from shpy.lang.data.tables import TableType
from shpy.lang.data.textures import TextureType
from shpy.lang.programs.joined import MASK, guarded
from shpy.lang.programs.record import InputType, RecordedProgram
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Group, Layout, Leaf, Rows, layout_of
from shpy.programs import Program
from shpy.run.kernel import Kernel
from shpy.streams.stream import Place

RUN_ARGUMENTS = ("shape", "backend", "device", "precision")
"""Arguments of `Chain.run` besides the streams: no stream has these names."""


def is_gathered(type_: InputType) -> bool:
    """Return whether an input reads its stream by index."""
    return isinstance(type_, TableType | TextureType)


def element_layout(type_: InputType) -> Layout:
    """Return the layout of an element of the stream that an input reads."""
    return layout_of(type_.cls, "an element") if isinstance(type_, TableType | TextureType) else type_


class Step(NamedTuple):
    """A kernel at its place in a chain: whether the chain is certain to run it, and the names of numbers of passes."""

    kernel: Member
    runs: bool
    numbers: frozenset[str] = frozenset()

    @property
    def inputs(self) -> dict[str, InputType]:
        """The type of each input that reads a stream, by name; the others are numbers of passes."""
        return {name: type_ for name, type_ in self.kernel.inputs.items() if name not in self.numbers}


def stream_names(steps: Iterable[Step]) -> tuple[str, ...]:
    """Return the names of the streams, Tables and numbers that kernels read or write, without numbers of passes."""
    names = (name for step in steps for name in (*step.inputs, *(name for name, _ in step.kernel.outputs)))
    return tuple(dict.fromkeys(names))


@dataclass(frozen=True, eq=False)
class Member:
    """A program or kernel in a chain: `original` as the user gave it, `kernel` with its condition if there is one."""

    kernel: Program | Kernel
    original: Program | Kernel
    outputs: tuple[tuple[str, Layout], ...]

    @classmethod
    def of(cls, kernel: Program | Kernel, index: str | None = None) -> Member:
        """Return the member for a program or kernel; ShpyTypeError if an output needs a name and has none.

        An output without a name does not replace `index`, which is the number of the pass.
        """
        recorded = kernel.recorded
        for name in recorded.inputs:
            if name in RUN_ARGUMENTS:
                raise ShpyTypeError(
                    f"the input {name} of {signature(recorded)} cannot be a stream: {name} is an argument of run",
                    loc=here(),
                    cure=f"{recorded.module.name}.rename({name}=…)",
                )
        outputs = _outputs(recorded, index)
        for name, layout in outputs:
            _check_stream(name, layout, recorded)
        return cls(kernel, kernel, outputs)

    @property
    def kernels(self) -> tuple[Member, ...]:
        """The member itself, which is the smallest part of a chain."""
        return (self,)

    @property
    def steps(self) -> Iterator[Step]:
        """Yield the member itself, which runs."""
        yield Step(self, runs=True)

    def perform(self, run: Any) -> None:
        """Run the member once."""
        run.play(self)

    @property
    def recorded(self) -> RecordedProgram:
        """The recorded program, of the guarded kernel if there is a condition."""
        return self.kernel.recorded

    @property
    def name(self) -> str:
        """The program's name."""
        return self.recorded.module.name

    @property
    def inputs(self) -> dict[str, InputType]:
        """The type of each input by name."""
        return self.recorded.inputs

    @cached_property
    def signature(self) -> str:
        """The signature as messages spell it."""
        return signature(self.recorded)

    @cached_property
    def rejects(self) -> bool:
        """Return whether an element may write nothing."""
        functions = self.recorded.module.functions
        return any(isinstance(s, Discard) for f in functions for s in walk(f.body))

    def where(self, condition: str | Program) -> Member:
        """Return a member that runs only elements for which the condition, a stream or a program, holds."""
        recorded = self.recorded
        if isinstance(condition, str):
            _check_shared(recorded, condition, Leaf(MASK), f'where="{condition}"')
            program = guarded(recorded, None, condition)
        else:
            if not is_condition(condition):
                raise no_condition(condition, "where=", "program", 'where="alive"')
            for name, type_ in condition.recorded.inputs.items():
                _check_shared(recorded, name, type_, signature(condition.recorded))
            program = guarded(recorded, condition.recorded, "")
        if isinstance(self.kernel, Kernel):
            kernel: Program | Kernel = Kernel(program, backend_named(self.kernel.backend), self.kernel.options)
        else:
            kernel = Program(program)
        return replace(self, kernel=kernel)

    def compiled(self, place: Place) -> Kernel:
        """Return the kernel for a device; ShpyTypeError if the user gave a kernel for another device."""
        if isinstance(self.kernel, Program):
            return self.kernel.compile_at(place)
        if self.kernel.place != place:
            raise ShpyTypeError(
                f"{self.name} is compiled for {self.kernel.place}, and the streams of the chain lie on {place}",
                loc=here(),
                cure=f"the program {self.name} in the chain, which is compiled for the streams' device",
            )
        return self.kernel


class Node(Protocol):
    """A part of a chain, which knows how often and in which order its kernels run."""

    @property
    def kernels(self) -> Iterable[Member]:
        """Every kernel, in order."""

    @property
    def steps(self) -> Iterable[Step]:
        """Return every kernel in order, each with True if the chain is certain to run it."""

    def perform(self, run: Any) -> None:
        """Run this part once."""


@dataclass(slots=True, eq=False)
class Watch:
    """The kernels whose writes keep a loop going, every kernel if None; `wrote` tells whether one wrote an element."""

    kernels: frozenset[Member] | None
    wrote: bool = False

    def needs(self, member: Member) -> bool:
        """Return whether the loop has to know if this kernel wrote an element."""
        return not self.wrote and (self.kernels is None or member in self.kernels)


def _outputs(recorded: RecordedProgram, index: str | None) -> tuple[tuple[str, Layout], ...]:
    """Return the name and the layout of the stream that each output replaces."""
    layout = recorded.output
    form = layout.form if isinstance(layout, Group) else None
    if isinstance(layout, Group) and form == "dict":
        return tuple(zip(layout.names, layout.parts, strict=True))
    fitting = [] if form in ("tuple", "list") else _fitting(recorded, layout, index)
    if len(fitting) == 1:
        return ((fitting[0], layout),)
    if isinstance(layout, Group) and form in ("struct", "namedtuple") and not fitting:
        return tuple(zip(layout.names, layout.parts, strict=True))
    if form in ("tuple", "list"):
        problem = "the outputs of {} have no names"
    elif fitting:
        problem = f"the output of {{}} has no name, and could replace {' or '.join(fitting)}"
    else:
        problem = "the output of {} has no name, and no input has its type"
    raise ShpyTypeError(
        f"{problem.format(signature(recorded))}: an output of a chain replaces the stream of its name",
        loc=here(),
        cure=f'return {{"{fitting[0] if fitting else "name"}": value}}, or a NamedTuple of the streams',
    )


def _fitting(recorded: RecordedProgram, layout: Layout, index: str | None) -> list[str]:
    """Return the inputs whose elements have the type of the output; only those of the same kinds if there are any."""
    elements = {name: element_layout(type_) for name, type_ in recorded.inputs.items() if name != index}
    same = [name for name, element in elements.items() if element == layout]
    return same or [name for name, element in elements.items() if alike(element, layout)]


def _check_stream(name: str, layout: Layout, recorded: RecordedProgram) -> None:
    """Raise ShpyTypeError for an output of a type that no stream has; several values need a struct."""
    is_supported = isinstance(layout, Leaf | Rows) or (layout.form in ("struct", "namedtuple"))
    if not is_supported:
        raise ShpyTypeError(
            f"the output {name} of {signature(recorded)} is {type_name(layout)}, which is no type of a stream",
            loc=here(),
            cure="a @sh.struct, or an output for each value",
        )
    if name in RUN_ARGUMENTS:
        raise ShpyTypeError(
            f"the output {name} of {signature(recorded)} cannot be a stream: {name} is an argument of run",
            loc=here(),
            cure=f"{recorded.module.name}.rename({name}=…)",
        )


def is_condition(condition: Any) -> bool:
    """Return whether something is a program that returns one Attrib1b."""
    return isinstance(condition, Program) and condition.recorded.output == Leaf(MASK)


def no_condition(condition: Any, what: str, kind: str, cure: str) -> ShpyTypeError:
    """Return the error for a value that is not a condition; the message begins with `what`."""
    spoken = signature(condition.recorded) if isinstance(condition, Program) else repr(condition)
    return ShpyTypeError(
        f"{what}{spoken} is neither the name of a stream nor a {kind} that returns one Attrib1b",
        loc=here(),
        cure=f"{cure}, or a program of the element: alive(x: sh.Attrib1f) -> sh.Attrib1b",
    )


def _check_shared(recorded: RecordedProgram, name: str, type_: InputType, other: str) -> None:
    input_type = recorded.inputs.get(name)
    if input_type is not None and input_type != type_:
        raise ShpyTypeError(
            f"the stream {name} is {with_article(input_type)} in {signature(recorded)} "
            f"and {with_article(type_)} in {other}",
            loc=here(),
            cure=f"rename({name}=…) of one of the two",
        )
