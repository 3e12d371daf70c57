"""A chain in a view: its streams continue from frame to frame; `show` draws them, or its last stream is the picture.

Stage: view. The kernels of the chain and those of `show` are compiled in threads, and each may become ready first: so
streams are brought to where the kernel is that reads them.

    subject = Ongoing(chain, opened, wake)
    if subject.advance(moment, Form("opencl", "strict"), steps=1):
        subject.draw(moment, Form("opencl", "strict"))      # (output, the form that computed it)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np

from shpy.chains.chain import Chain, Repeat, Sequence
from shpy.chains.member import Member
from shpy.display.screen import Moment, first_output, is_filled, values_of
from shpy.errors import ShpyError
from shpy.pictures.evolution import extent, given_to, last_stream, stepped
from shpy.programs import Program
from shpy.run.background import Background
from shpy.streams.stream import Stream
from shpy.view.kernels import Form, Kernels
from shpy.view.rounds import read_before
from shpy.view.source import SHOW, START, OpenedFile

Key = tuple[Form, tuple[int, int]]


@dataclass(frozen=True)
class PictureParts:
    """The parts of a picture: its streams, and for its last step the streams before, the moment and the form."""

    streams: Mapping[str, Any]
    before: Mapping[str, Any] | None = None
    moment: Moment | None = None
    form: Form | None = None


class Ongoing:
    """A chain that continues its streams from frame to frame."""

    params: Mapping[str, Any]
    moves: bool = True
    evolves: bool = True
    coarse: bool = False

    def __init__(self, chain: Chain, opened: OpenedFile, wake: Callable[[], None]) -> None:
        self.chain = chain
        self.start = opened.start
        show = opened.names.get(SHOW)
        self.kernels = Kernels(show, wake) if isinstance(show, Program) else None
        self.shown = last_stream(chain)
        programs = [kernel.recorded for kernel in chain.kernels]
        self.takes_mouse = any("mouse" in names for names in (*(p.inputs for p in programs), self.show_inputs))
        self.read = {name for step in chain.steps for name, type_ in step.inputs.items() if _is_filled(name, type_)}
        """The inputs of the chain that are filled by their names."""
        self.stepping = {name: p for recorded in programs for name, p in recorded.params.items()}
        """The Params of the chain."""
        self.params = self.stepping | (self.kernels.program.params if self.kernels else {})
        self._in_form = cache(self._compiled)
        self._state: PictureParts | None = None
        self._size: tuple[int, int] | None = None
        self._own: tuple[int, int] | None = None
        """The size of the streams, which `start` may choose itself."""
        self._trials: Background[Key, None] = Background(wake)
        """The first run in each form, which compiles the kernels."""

    @property
    def show_inputs(self) -> Mapping[str, Any]:
        """The inputs of `show`."""
        return self.kernels.program.inputs if self.kernels else {}

    @property
    def fresh(self) -> bool:
        """True while the streams are those of `start`."""
        return self._state is None or self._state.before is None

    # Pictures

    def draw(self, moment: Moment, choice: Form) -> tuple[Any, Form]:
        """Return the colours of the current streams."""
        state = self._present(moment.size)
        if self.kernels is None:
            return np.asarray(state.streams[self.shown]), state.form or choice
        kernel, form = self.kernels.best(choice)
        return self._shown(kernel, moment, form), form

    def exactly(self, moment: Moment, form: Form) -> Any:
        """Return the colours of the current streams in a form; compile it first if it is new."""
        if self.kernels is None:
            return np.asarray(self._present(moment.size).streams[self.shown])
        return self._shown(self.kernels.exactly(form), moment, form)

    def _shown(self, kernel: Any, moment: Moment, form: Form) -> Any:
        inputs = _placed(values_of(self.show_inputs, moment, self._present(moment.size).streams), form)
        return np.asarray(first_output(kernel(**inputs, shape=moment.shape)))

    def extent(self, size: tuple[int, int]) -> tuple[int, int]:
        """Return the width and height of the streams, which `start` may choose itself."""
        return extent(self.chain, self._present(size).streams, size)

    def lacks_picture(self, size: tuple[int, int]) -> bool:
        """Return whether the picture is of streams that the chain has yet to write."""
        filled = {name for name, type_ in self.show_inputs.items() if is_filled(name, type_)}
        read = self.show_inputs if self.kernels else [self.shown]
        return bool((set(read) & self.chain.outputs.keys()) - filled - self._present(size).streams.keys())

    # Steps

    def advance(self, moment: Moment, choice: Form, steps: int) -> bool:
        """Run some steps and return True; return False while neither the wanted form nor a quick one is compiled."""
        streams = dict(self._present(moment.size).streams)
        forms = tuple(dict.fromkeys((choice, choice.quick())))
        for form in reversed(forms):
            self._trials.begin((form, moment.size), partial(self._try, moment, form, streams))
        ready = [form for form in forms if self._trials.is_done((form, moment.size))]
        if not ready:
            refused = [error for form in forms if (error := self._trials.error((form, moment.size)))]
            if len(refused) == len(forms):
                raise refused[0]
            return False
        self.run_on(moment, ready[0], steps)
        return True

    def run_on(self, moment: Moment, form: Form, steps: int) -> None:
        """Run some steps in a form; compile it first if it is new."""
        state = self._present(moment.size)
        for _ in range(steps):
            written = self._run(moment, form, state.streams)
            state = PictureParts({**state.streams, **written}, state.streams, moment, form)
        self._state = state

    def _try(self, moment: Moment, form: Form, streams: Mapping[str, Any]) -> None:
        """Compile the kernels by one run, whose results are discarded."""
        self._run(moment, form, streams)

    def _run(self, moment: Moment, form: Form, streams: Mapping[str, Any]) -> dict[str, Any]:
        return stepped(self._in_form(form), moment, _placed(streams, form), form.backend)

    def _compiled(self, form: Form) -> Chain:
        """Return the chain with its programs compiled in the mode of a form."""
        if form.mode == "strict":
            return self.chain

        def compile_members(node: Any) -> Any:
            if isinstance(node, Chain):
                return node.with_members(tuple(map(compile_members, node.members)))
            if isinstance(node.kernel, Program):
                return replace(node, kernel=node.kernel.compile(form.backend, **form.options))
            return node

        return compile_members(self.chain)  # type: ignore[no-any-return]

    def _present(self, size: tuple[int, int]) -> PictureParts:
        """Return what is shown; restart from the first streams if the size has changed."""
        if self._state is None or size not in (self._size, self._own):
            self._state, self._size = PictureParts(self._begin(size)), size
            self._own = extent(self.chain, self._state.streams, size)
        return self._state

    def _begin(self, size: tuple[int, int]) -> dict[str, Any]:
        if self.start is None:
            names = ", ".join(f'"{name}": …' for name in self.chain.inputs)
            raise ShpyError(
                f"{self.chain} needs streams to begin with", cure=f"def {START}(height, width): return {{{names}}}"
            )
        streams = self.start(size[1], size[0])
        if not isinstance(streams, dict):
            raise ShpyError(f"{START}(height, width) gives {type(streams).__name__}", cure="a dict of arrays by name")
        return dict(streams)

    def reset(self) -> None:
        """Restart from the first streams."""
        self._state = None

    # What the page asks

    def is_awaited(self, choice: Form) -> bool:
        """Return whether the chain or `show` is compiled for the wanted form."""
        waits = self._trials.is_awaited((choice, self._own or (0, 0)))
        return waits or (self.kernels is not None and self.kernels.is_awaited(choice))

    def refused(self, choice: Form) -> Exception | None:
        """Return the error with which a target refuses the chain or `show`; a quick form draws in its place."""
        error = self._trials.error((choice, self._own or (0, 0)))
        return error or (self.kernels.refused(choice) if self.kernels else None)

    def state(self) -> PictureParts | None:
        """Return the inputs of the present picture."""
        return self._state

    def stepped(self, state: PictureParts, at: tuple[int, int]) -> tuple[Program, list[Any]] | None:
        """Return the kernel that wrote the element `at` of what is shown, and its steps in the last round.

        In a loop they are those of the last round that wrote the element. None before the first step, and for a kernel
        that runs over other elements than the pixels.
        """
        member = self._writer()
        if member is None or state.before is None or state.moment is None or state.form is None:
            return None
        program, shown = Program(member.recorded), state.streams[member.outputs[-1][0]]
        if shown.shape != state.moment.shape:
            return None
        streams, backend = _placed(state.before, state.form), state.form.backend
        before = _before(self.chain, member)
        if before is None:
            streams |= read_before(self.chain, member, at, state.moment, streams, backend)
        else:
            prefix, numbers = before
            streams |= stepped(Sequence(tuple(prefix)), state.moment, streams, backend) if prefix else {}
            streams |= numbers
        inputs = given_to(Sequence((member,)), state.moment, streams)
        inputs = {name: value for name, value in inputs.items() if name in program.inputs}
        return program, program.trace(**inputs, shape=state.moment.shape, at=at)

    def _writer(self) -> Member | None:
        """Return the kernel that writes last what the picture is made of; None if it shows what no kernel writes."""
        names = self.show_inputs.keys() if self.kernels else {self.shown}
        return next((k for k in reversed(self.chain.kernels) if names & {name for name, _ in k.outputs}), None)

    def drawn(self, state: PictureParts, moment: Moment, at: tuple[int, int]) -> tuple[Program, list[Any]] | None:
        """Return `show` and the steps of one pixel in it; None without it."""
        if self.kernels is None:
            return None
        program = self.kernels.program
        inputs = values_of(program.inputs, moment, state.streams)
        return program, program.trace(**inputs, shape=moment.shape, at=at)

    def sources(self, form: Form) -> list[tuple[str, str]]:
        """Return the name of each program and the text that is emitted for it in a form."""
        programs = {kernel.name: kernel.kernel for kernel in self.chain.kernels}
        texts = [(name, _source(kernel, form)) for name, kernel in programs.items()]
        return texts + ([(SHOW, self.kernels.exactly(form).source)] if self.kernels else [])


def _is_filled(name: str, type_: Any) -> bool:
    return is_filled(name, getattr(type_, "cls", type_))


def _source(kernel: Any, form: Form) -> str:
    if isinstance(kernel, Program):
        kernel = kernel.compile(form.backend, **form.options)
    return str(kernel.source)


def _placed(values: Mapping[str, Any], form: Form) -> dict[str, Any]:
    """Return the values with their streams where a form runs."""
    return {name: v.to(form.backend) if isinstance(v, Stream) else v for name, v in values.items()}


def _before(node: Chain | Member, member: Member) -> tuple[list[Chain | Member], dict[str, int]] | None:
    """Return what a chain runs before its last execution of a member; None in a loop, where only a run tells.

    The second result has the numbers of the passes in that execution, by the names of the inputs.
    """
    if node is member:
        return [], {}
    if not isinstance(node, Sequence | Repeat) or (isinstance(node, Repeat) and not node.times):
        return None
    places = [k for k, part in enumerate(node.members) if member in part.kernels]
    inner = _before(node.members[places[-1]], member)
    if inner is None:
        return None
    last, numbers = [*node.members[: places[-1]], *inner[0]], inner[1]
    if not isinstance(node, Repeat):
        return last, numbers
    final = node.first + node.times - 1
    earlier = [Repeat(node.members, node.times - 1, node.index, node.first)] if node.times > 1 else []
    if node.index is not None:
        last = [Repeat(tuple(last), 1, node.index, final)] if last else []
        numbers = {node.index: final} | numbers
    return [*earlier, *last], numbers
