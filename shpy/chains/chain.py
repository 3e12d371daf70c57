"""Chains: kernels in sequence, repeated, or in a loop, over named streams that stay on the device.

Stage: run.

    chain = sh.sequence(generate, sh.loop(traverse, intersect))
    result = chain.run(rays=rays, voxels=voxels)
    result.streams["rays"]
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import Any

from shpy.algebra import alike, with_article
from shpy.backend.registry import AUTO, default_backend
from shpy.chains.member import RUN_ARGUMENTS, Member, Step, Watch, element_layout, is_gathered
from shpy.chains.merging import COUNT
from shpy.chains.places import has_place
from shpy.chains.running import ChainResult, Run
from shpy.chains.share import Share
from shpy.chains.takeover import Takeover
from shpy.errors import LoopLimitExceeded, ShpyTypeError
from shpy.ieee import in_ieee_arithmetic
from shpy.ir.constants import is_int
from shpy.ir.nodes import Loc
from shpy.lang.programs.record import InputType
from shpy.lang.recording.location import here
from shpy.lang.recording.pickling import Unchanging
from shpy.lang.values.structure import Leaf
from shpy.passes.modes import Precision
from shpy.programs import Program
from shpy.run.kernel import Kernel


class Chain(Unchanging, ABC):
    """Kernels that run one after the other over named streams: see `sh.sequence`, `sh.repeat` and `sh.loop`.

    An input of a kernel reads the stream of its name: the element of each run, or, annotated `sh.Table[…]` or
    `sh.Texture2D[…]`, any element by index. An output replaces the stream of its name; a single output without a name
    replaces the stream of the only input of its type. A Table reads what the stream held before the kernel ran.
    """

    index: str | None = None
    """The name of the input that receives the number of the pass or round; None if it is not counted."""

    def __init__(self, members: tuple[Member | Chain, ...], *options: Any) -> None:
        self.members = members
        self._options = options
        self.loc: Loc | None = here()
        self._check_types()

    @cached_property
    def kernels(self) -> tuple[Member, ...]:
        """Every kernel of the chain and of the chains in it, in order."""
        return tuple(kernel for member in self.members for kernel in member.kernels)

    @property
    def steps(self) -> Iterator[Step]:
        """Every kernel in order, with whether the chain runs it: `sh.repeat(p, 0)` does not."""
        number = () if self.index is None else (self.index,)
        for member in self.members:
            for step in member.steps:
                yield step._replace(numbers=step.numbers.union(number)) if number else step

    @property
    def inputs(self) -> dict[str, Any]:
        """The type of each stream, Table or number that `run` takes, by name."""
        types: dict[str, Any] = {}
        written: set[str] = set()
        for step in self.steps:
            kernel = step.kernel
            for name, type_ in step.inputs.items():
                if name not in written and name not in kernel.recorded.defaults:
                    types.setdefault(name, getattr(type_, "cls", type_))
            written |= {name for name, _ in kernel.outputs} if step.runs and not kernel.rejects else set()
        return types

    @property
    def outputs(self) -> dict[str, Any]:
        """The type of each stream that the chain writes, by name."""
        return {name: getattr(layout, "cls", layout) for kernel in self.kernels for name, layout in kernel.outputs}

    @in_ieee_arithmetic
    def run(
        self,
        *,
        shape: Any = None,
        backend: str | None = None,
        device: int | None = None,
        precision: Precision | None = None,
        **streams: Any,
    ) -> ChainResult:
        """Run the chain on the device where the streams lie; return the streams that it wrote, and counts.

        `streams` are Streams, host arrays, which are copied to the device once, Tables and Textures, and numbers and
        Params, which hold for every element. They keep their elements: the chain writes into its own memory.
        Over arrays alone, the default backend "auto" is numpy, then OpenCL with the same bits once that pays
        (`runs_on`); the streams of the result lie on numpy, wherever the chain ran.
        `shape` is that of kernels which read no stream by element and write a new one. `backend`, `device` and
        `precision` say where arrays go if no stream is given.
        Raises ShpyTypeError before anything runs for missing and unknown streams, and for a `shape` where every kernel
        has another one from its streams; LoopLimitExceeded for a `loop` of the chain or a loop of a kernel that ran out
        of its iterations.
        """
        if backend is None and device is None and default_backend() == AUTO and not has_place(self, streams):
            return self._takeover.result(lambda name: Run(self, streams, shape, name, None, precision))
        return Run(self, streams, shape, backend, device, precision).result()

    @cached_property
    def _takeover(self) -> Takeover:
        return Takeover()

    @property
    def runs_on(self) -> str:
        """The name of the backend of the next run over arrays that names none: "numpy", or "opencl" once that pays."""
        return self._takeover.runs_on if default_backend() == AUTO else default_backend()

    @property
    def notes(self) -> tuple[str, ...]:
        """Return the reason why `runs_on` is that backend."""
        return (self._takeover.note,) if default_backend() == AUTO else (default_backend().why,)

    def where(self, condition: str | Program) -> Chain:
        """Return the chain with a condition on the elements of each kernel."""
        return self.with_members(_guarded(self.members, condition))

    def with_members(self, members: tuple[Member | Chain, ...]) -> Chain:
        """Return this chain with other members."""
        return type(self)(members, *self._options)

    @abstractmethod
    def perform(self, run: Run) -> None:
        """Run the members as often as this chain says."""

    def _check_types(self) -> None:
        """Raise ShpyTypeError where two kernels give the stream of one name different types."""
        types: dict[str, tuple[InputType, Member]] = {}
        for kernel in self.kernels:
            for name, type_ in [*kernel.inputs.items(), *kernel.outputs]:
                first, other = types.setdefault(name, (type_, kernel))
                if not alike(element_layout(first), element_layout(type_)):
                    raise ShpyTypeError(
                        f"the stream {name} is {with_article(first)} in {other.signature} and {with_article(type_)} in "
                        f"{kernel.signature}",
                        loc=here(),
                        cure=f'{kernel.name}.rename({name}="…"), or one type in both',
                    )

    def __repr__(self) -> str:
        return f"<Chain {self}>"

    def __str__(self) -> str:
        return f"{type(self).__name__.lower()}({', '.join(_spoken(m) for m in self.members)})"


class Sequence(Chain):
    """Each member once, in order: see `sh.sequence`."""

    @cached_property
    def _is_flat(self) -> bool:
        return all(isinstance(m, Member) or (isinstance(m, Sequence) and m._is_flat) for m in self.members)

    def perform(self, run: Run) -> None:
        """Run each member once."""
        if self._is_flat:
            run.play(self)
            return
        for member in self.members:
            member.perform(run)


class Repeat(Chain):
    """A chain that runs its members a number of times: see `sh.repeat`. The passes are counted from `first`."""

    def __init__(
        self, members: tuple[Member | Chain, ...], times: int, index: str | None = None, first: int = 0
    ) -> None:
        super().__init__(members, times, index, first)
        self.times, self.index, self.first = times, index, first

    @property
    def steps(self) -> Iterator[Step]:
        """Yield every kernel in order, each with True if the chain is certain to run it."""
        return (step._replace(runs=step.runs and self.times > 0) for step in super().steps)

    def perform(self, run: Run) -> None:
        """Run the members as often as the chain repeats."""
        outside, run.once = run.once, run.once and self.times < 2
        with run.numbered(self, self.index, self.first) as advance:
            for number in range(self.times):
                if number:
                    advance()
                for member in self.members:
                    member.perform(run)
                run.passed(self, (number + 1) / self.times)
        run.once = outside

    def __str__(self) -> str:
        index = "" if self.index is None else f', index="{self.index}"'
        return f"repeat({', '.join(_spoken(m) for m in self.members)}, {self.times}{index})"


class GatedMember(Chain):
    """A member of a loop that runs when a share of the elements is ready: see `sh.share`."""

    def __init__(self, members: tuple[Member | Chain, ...], share: Share) -> None:
        super().__init__(members, share)
        self.share = share

    @property
    def steps(self) -> Iterator[Step]:
        """Every kernel in order; no stream is certain to be written."""
        return (step._replace(runs=False) for step in super().steps)

    def perform(self, run: Run) -> None:
        """Run the member if enough elements are ready."""
        if run.admits(self.share):
            for member in self.members:
                member.perform(run)

    def __str__(self) -> str:
        return f"{', '.join(_spoken(m) for m in self.members)} when {self.share}"


class Loop(Chain):
    """A chain that runs its members until a round, or the member `until` in a round, writes nothing: see `sh.loop`."""

    def __init__(
        self,
        members: tuple[Member | Chain, ...],
        loop_limit: int | None,
        index: str | None = None,
        until: str | None = None,
    ) -> None:
        super().__init__(members, loop_limit, index, until)
        self.loop_limit, self.index, self.until = loop_limit, index, until
        self._round = Sequence(members)
        self._deciding = None if until is None else _kernels_named(members, until)
        for kernel in self.kernels if self._deciding is None else self._deciding:
            if not kernel.rejects:
                raise self._never_ends(kernel)

    def _never_ends(self, kernel: Member) -> ShpyTypeError:
        """Return the error for a kernel that keeps the loop going for ever."""
        rejecting = next((m.name for m in self.members if isinstance(m, Member) and m.rejects), None)
        other = f'until="{rejecting}", ' if rejecting is not None and self.until is None else ""
        end = "that writes nothing" if self.until is None else f"in which {self.until} writes nothing"
        return ShpyTypeError(
            f"{self} never ends: {kernel.signature} writes every element, and a loop ends with a round {end}",
            loc=here(),
            cure=f"SH_DISCARD in {kernel.name} where there is nothing left to do, where=, {other}or sh.repeat",
        )

    def perform(self, run: Run) -> None:
        """Run rounds until a round writes no element; raises LoopLimitExceeded where there are too many."""
        with run.numbered(self, self.index, 0) as advance:
            self._perform(run, advance)

    def _perform(self, run: Run, advance: Callable[[], None]) -> None:
        outside = run.once, run.holds_back, run.open
        run.once = run.open = False
        watch = Watch(self._deciding)
        run.watches.append(watch)
        rounds = 0
        while self.loop_limit is None or rounds < self.loop_limit:
            if rounds:
                advance()
            watch.wrote = run.holds_back = False
            self._round.perform(run)
            rounds += 1
            if not watch.wrote and not run.holds_back:
                run.once, run.holds_back, run.open = outside
                run.watches.pop()
                return
            run.open = not watch.wrote
        ends = "kernels that discard" if self.until is None else f"a kernel {self.until} that discards"
        raise LoopLimitExceeded(
            f"{self} took more than {self.loop_limit} rounds",
            loc=self.loc,
            cure=f"{ends} every element in the end, or loop_limit=N if it needs more (None: no limit)",
            result=run.so_far(),
        )

    def __str__(self) -> str:
        until = "" if self.until is None else f', until="{self.until}"'
        return f"loop({', '.join(_spoken(m) for m in self.members)}{until})"


def sequence(*members: Program | Kernel | Chain, where: str | Program | None = None) -> Chain:
    """Return the chain that runs each member once, in order; members are programs, kernels and chains.

    `sh.sequence(a, b, c)` gives the bits of `c << b << a` where these connect by name, with the results between them in
    streams. `where` selects the elements that run: it is the name of a stream of bools, or a program of one element
    that returns a bool. The other elements keep the values in the streams. Each kernel evaluates `where` when it runs.
    Raises ShpyTypeError where an output has no name, or where a stream would have two types.
    """
    return Sequence(_guarded(_members(members), where))


def repeat(
    member: Program | Kernel | Chain,
    times: int,
    *,
    where: str | Program | None = None,
    index: str | None = None,
) -> Chain:
    """Return the chain that runs a program, kernel or chain `times` times.

    `where`, the name of a stream of bools or a program of the element, tells which elements run. `index` names an input
    of type Attrib1i that receives the number of the pass, 0 to times - 1, in all kernels and conditions of the chain;
    of nested repeats and loops with one name the innermost counts. The device counts, and one kernel runs all passes.
    Raises ShpyTypeError for a number of times that is no int or negative, and for an `index` that no kernel reads, that
    one writes, or that is no element of type Attrib1i.

        @sh.program
        def smooth(u: sh.Table[sh.Attrib1f, 2]) -> sh.Attrib1f:
            i = sh.grid_index(2)
            return 0.25 * (u[i + (0, 1)] + u[i - (0, 1)] + u[i + (1, 0)] + u[i - (1, 0)])

        sh.repeat(smooth, 500).run(u=image).streams["u"]
    """
    if not is_int(times) or times < 0:
        raise ShpyTypeError(f"repeat takes a number of times, not {times!r}", loc=here(), cure="sh.repeat(step, 500)")
    return _numbered(Repeat(_guarded(_members((member,), index), where), int(times), index))


def loop(
    *members: Program | Kernel | Chain,
    where: str | Program | None = None,
    loop_limit: int | None = 1_048_576,
    when: Mapping[str, Share] | None = None,
    index: str | None = None,
    until: str | None = None,
) -> Chain:
    """Return the chain that runs its members in rounds until a round writes no element.

    Each kernel has to discard elements (`SH_DISCARD`) or to run under a condition: see `where` of `sh.sequence`. The
    round that writes nothing counts among the executions. `run` raises LoopLimitExceeded after `loop_limit` rounds, or
    never if that is None. `index` names an input that receives the number of the round: see `sh.repeat`.

    `until` names the member, a program or kernel, that decides alone: the loop ends with the round in which it writes
    no element, and the other members may write every element. Every member runs in that last round, too.
    Source: Christen 2005, section 4.3.4 and listing 4.8, a while-loop over several kernels.

    `when` names members, programs or kernels, and for each the share of the elements that have to be ready:
    `sh.loop(traverse, intersect, when={"intersect": sh.share("waiting", 0.2, of="moving")})`. In a round in which they
    are too few, the member is held back. After a round that wrote nothing, the next one lets those run that have any
    element ready, so that the loop ends only when none has.
    Raises ShpyTypeError for a kernel that writes every element and decides when the loop ends, for names in `when` and
    `until` that are no members, for shares of streams that no kernel of the loop has, and for an `index` as in
    `sh.repeat`.
    """
    if loop_limit is not None and not (is_int(loop_limit) and loop_limit > 0):
        raise ShpyTypeError(f"loop_limit={loop_limit!r}", loc=here(), cure="a number of rounds, or None for no limit")
    parts = _with_shares(_guarded(_members(members, index), where), {} if when is None else when)
    _check_until(until, parts)
    return _numbered(Loop(parts, None if loop_limit is None else int(loop_limit), index, until))


def _kernels_named(members: tuple[Member | Chain, ...], name: str) -> frozenset[Member]:
    """Return the kernels of the members, without those of chains among them, that have a name."""
    own = (m for member in members for m in (member.members if isinstance(member, GatedMember) else (member,)))
    return frozenset(m for m in own if isinstance(m, Member) and m.name == name)


def _check_until(until: str | None, members: tuple[Member | Chain, ...]) -> None:
    """Raise ShpyTypeError for an `until` that names no member of a loop."""
    if until is None or (isinstance(until, str) and _kernels_named(members, until)):
        return
    names = [kernel.name for member in members if isinstance(member, Member | GatedMember) for kernel in member.kernels]
    spoken = repr(until) if isinstance(until, str) else getattr(until, "__name__", None) or repr(until)
    raise ShpyTypeError(
        f"until={spoken} of a loop of {', '.join(_spoken(member) for member in members)} is no name of a member",
        loc=here(),
        cure=f'until="{names[-1]}"' if names else 'sh.loop(first, second, until="second"), whose members are programs',
    )


def _with_shares(members: tuple[Member | Chain, ...], when: Mapping[str, Share]) -> tuple[Member | Chain, ...]:
    """Return the members; each that `when` names waits until its share of the elements is ready."""
    names = dict.fromkeys(member.name for member in members if isinstance(member, Member))
    if not isinstance(when, Mapping):
        cure = f'when={{"{next(iter(names), "program")}": sh.share("waiting", 0.2)}}'
        raise ShpyTypeError(f"when={when!r} is no dict of members and their shares", loc=here(), cure=cure)
    kernels = [kernel for member in members for kernel in member.kernels]
    layouts = {n: layout for kernel in kernels for n, layout in kernel.outputs}
    layouts |= {n: element_layout(t) for kernel in kernels for n, t in kernel.inputs.items() if not is_gathered(t)}
    for name, share in when.items():
        if name not in names or not isinstance(share, Share):
            raise ShpyTypeError(
                f"when={{{name!r}: {share}}} of a loop of {', '.join(_spoken(member) for member in members)}",
                loc=here(),
                cure=f'when={{"{next(iter(names), "program")}": sh.share("waiting", 0.2)}}, by the name of a member',
            )
        share.check(layouts, f"the loop of {', '.join(_spoken(member) for member in members)}")
    return tuple(GatedMember((m,), when[m.name]) if isinstance(m, Member) and m.name in when else m for m in members)


def _numbered(node: Chain) -> Chain:
    """Return a chain; raise ShpyTypeError unless its kernels read the number of the pass, and none writes it."""
    index = node.index
    if index is None:
        return node
    if not isinstance(index, str) or not index.isidentifier() or index in RUN_ARGUMENTS:
        raise ShpyTypeError(
            f"index={index!r} is no name of an input", loc=here(), cure='index="k", and an input k: sh.Attrib1i'
        )
    number = f"the number of the {'round' if isinstance(node, Loop) else 'pass'}"
    readers = [step for member in node.members for step in member.steps if index in step.inputs]
    if not readers:
        listed = "; ".join(dict.fromkeys(kernel.signature for kernel in node.kernels))
        raise ShpyTypeError(
            f"no kernel of {node} reads {index}, {number}: {listed}",
            loc=here(),
            cure=f"an input {index}: sh.Attrib1i, or no index=",
        )
    for kernel, type_ in ((step.kernel, step.inputs[index]) for step in readers):
        if is_gathered(type_) or not alike(element_layout(type_), Leaf(COUNT)):
            raise ShpyTypeError(
                f"{index}, {number}, is {with_article(type_)} in {kernel.signature}",
                loc=here(),
                cure=f"{index}: sh.Attrib1i",
            )
    for kernel in node.kernels:
        if index in dict(kernel.outputs):
            raise ShpyTypeError(
                f"{kernel.signature} writes {index}, which is {number} in {node}",
                loc=here(),
                cure='return {"name": value} with the name of another stream, or another name for index=',
            )
    return node


def _members(values: tuple[Any, ...], index: str | None = None) -> tuple[Member | Chain, ...]:
    if not values:
        raise ShpyTypeError("a chain has at least one member", loc=here(), cure="sh.sequence(first, second)")
    return tuple(_member(value, index) for value in values)


def _member(value: Any, index: str | None) -> Member | Chain:
    if isinstance(value, Chain):
        return value
    if isinstance(value, Program | Kernel):
        return Member.of(value, index)
    spoken = getattr(value, "__name__", None) or repr(value)
    raise ShpyTypeError(
        f"{spoken} is neither a program nor a kernel nor a chain",
        loc=here(),
        cure=f"@sh.program above {spoken}" if callable(value) else "sh.sequence(first, second); sh.repeat(step, 500)",
    )


def _guarded(members: tuple[Member | Chain, ...], where: str | Program | None) -> tuple[Member | Chain, ...]:
    return members if where is None else tuple(member.where(where) for member in members)


def _spoken(member: Member | Chain) -> str:
    return member.name if isinstance(member, Member) else str(member)
