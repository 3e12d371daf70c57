"""Chains in a view: their pictures are those of `chain.run` wherever and whenever kernels become ready."""

import itertools

import numpy as np
import pytest
from pictured_chains import CHAINS, HEAD

from shpy.chains.chain import sequence
from shpy.display.screen import Moment
from shpy.ir.interpreter import Interpreter
from shpy.pictures.evolution import Evolution, last_stream
from shpy.run.background import Background
from shpy.view.kernels import Form
from shpy.view.ongoing import Ongoing
from shpy.view.source import open_file

SIZE = (12, 8)
QUICK = Form("numpy", "strict")


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    """Return each file of chains, opened."""
    folder = tmp_path_factory.mktemp("chains")

    def file(name):
        path = folder / f"{name}.py"
        if not path.exists():
            path.write_text(HEAD + CHAINS[name])
        return open_file(path)

    return file


def expected(found, subject, moments):
    """Return the pictures of the first steps, by chain.run on numpy."""
    start = found.start(SIZE[1], SIZE[0])
    evolution = Evolution(subject.chain, found.names.get("show"), start, size=subject.extent(SIZE), backend="numpy")
    pictures = []
    for before, after in itertools.pairwise(moments):
        evolution.step(before)
        pictures.append(evolution.picture(after))
    return pictures


class Locked(Background):
    """Results that are made when a test lets them."""

    def begin(self, key, make):
        pass

    def begin_after(self, seconds, key, make):
        pass

    def let(self, key, make):
        super().begin(key, make)
        self.wait(key)


class Gate(Ongoing):
    """A chain whose kernels are ready when a test says so."""

    def __init__(self, *given):
        super().__init__(*given)
        self._trials = Locked()
        if self.kernels:
            self.kernels._compiled = Locked()

    def let(self, what, form):
        """Let the chain, or `show`, be compiled in a form."""
        if what == "chain":
            self._trials.let((form, self.extent(SIZE)), lambda: None)
        elif self.kernels:
            self.kernels._compiled.let(form, lambda: self.kernels.program.compile(form.backend, math=form.math))


ORDERS = list(itertools.permutations([("show", False), ("show", True), ("chain", False), ("chain", True)]))
"""The orders in which the quick form (False) and the wanted one (True) of `show` and of the chain become ready."""
CASES = [(name, target, k) for name in CHAINS for target in ("opencl", "glsl") for k in range(len(ORDERS))]


@pytest.mark.sampled(354)
@pytest.mark.parametrize(("name", "target", "order"), CASES)
def test_a_chain_and_what_shows_it_may_become_ready_in_any_order(opened, name, target, order):
    found, wanted = opened(name), Form(target, "strict")
    subject = Gate(found.pick(None)[1], found, lambda: None)
    size = subject.extent(SIZE)
    moments = [Moment(size, 0.25 * k, k, (3.0, 2.0, 1.0, 1.0)) for k in range(10)]
    pictures, number, drawn = expected(found, subject, moments), 0, 0
    for what, is_wanted in ORDERS[order]:
        subject.let(what, wanted if is_wanted else QUICK)
        for _ in range(2):
            number += subject.advance(moments[number], wanted, 1)
            ready = subject.kernels is None or subject.kernels._compiled._results
            if ready and not subject.lacks_picture(SIZE):
                output, form = subject.draw(moments[number], wanted)
                assert form in (wanted, QUICK)
                if number:
                    assert np.array_equal(output, pictures[number - 1], equal_nan=True)
                    drawn += 1
    assert drawn >= 2


@pytest.mark.sampled(45)
@pytest.mark.parametrize(("name", "order"), [(n, k) for n in CHAINS for k in range(6)])
def test_a_page_may_choose_other_backends_and_modes_while_a_chain_runs(opened, name, order):
    found = opened(name)
    subject = Gate(found.pick(None)[1], found, lambda: None)
    moments = [Moment(subject.extent(SIZE), 0.25 * k, k, (3.0, 2.0, 1.0, 1.0)) for k in range(7)]
    pictures = expected(found, subject, moments)
    backends = list(itertools.permutations(["numpy", "opencl", "glsl"]))[order] * 2
    for number, backend in enumerate(backends):
        form = Form(backend, "strict" if number != 4 else "portable")
        for what in ("chain", "show"):
            subject.let(what, form)
        assert subject.advance(moments[number], form, 1)
        output, drawn = subject.draw(moments[number + 1], form)
        assert drawn == form
        if number < 4:
            assert np.array_equal(output, pictures[number], equal_nan=True)
        else:  # other formulas
            assert np.allclose(output, pictures[number], atol=1e-3, equal_nan=True)


def refuse(text):
    def make():
        raise ValueError(text)

    return make


def test_a_form_that_a_target_refuses_leaves_the_quick_one(opened):
    found, wanted = opened("two_buffers"), Form("glsl", "strict")
    subject, moment = Gate(found.pick(None)[1], found, lambda: None), Moment(SIZE)
    subject.let("chain", QUICK)
    subject._trials.let((wanted, SIZE), refuse("no"))
    assert subject.advance(moment, wanted, 1)
    assert str(subject.refused(wanted)) == "no"
    assert subject.draw(moment, wanted)[1] == QUICK
    subject._trials.forget((QUICK, SIZE))
    subject._trials.let((QUICK, SIZE), refuse("neither"))
    with pytest.raises(ValueError, match="no"):
        subject.advance(moment, wanted, 1)


@pytest.mark.parametrize("name", CHAINS)
def test_the_trace_of_a_chain_is_of_the_streams_before_its_last_step(opened, monkeypatch, name):
    found = opened(name)
    subject = Gate(found.pick(None)[1], found, lambda: None)
    for what in ("chain", "show"):
        subject.let(what, QUICK)
    moments = [Moment(subject.extent(SIZE), 0.25 * k, k, (3.0, 2.0, 1.0, 1.0)) for k in range(4)]
    for moment in moments[:3]:
        subject.advance(moment, QUICK, 2)
    held, at = subject.state(), (5, 3)
    interpreted, run = [], Interpreter.run_element

    def kept(interpreter, *given, **options):
        interpreted.append(run(interpreter, *given, **options)[0])
        return interpreted[-1], 0

    monkeypatch.setattr(Interpreter, "run_element", kept)
    stepped, drawn = subject.stepped(held, at), subject.drawn(held, moments[3], at)
    assert stepped is not None
    assert (drawn is None) == (subject.kernels is None)
    if drawn:
        assert np.array_equal(subject.draw(moments[3], QUICK)[0][at], interpreted[-1][0], equal_nan=True)
    if name != "a_struct":
        written = held.streams[subject._writer().outputs[0][0]]
        assert np.array_equal(written.numpy()[at], interpreted[0][0])


LOOPS = """
@sh.program
def lower(u: sh.Attrib1f, v: sh.Table[sh.Attrib1f, 2], round: sh.Attrib1i):
    sh.SH_DISCARD(u < 0.1)
    return {"u": 0.5 * u + 0.001 * sh.Attrib1f(round) * v[sh.grid_index(2)]}


@sh.program
def spread(w: sh.Attrib1f, v: sh.Attrib1f, k: sh.Attrib1i, round: sh.Attrib1i):
    sh.SH_DISCARD((w > v) | (v < 1.5))
    return {"w": w + 0.5 + 0.125 * sh.Attrib1f(k + 3 * round)}


@sh.program
def ready(u: sh.Attrib1f, v: sh.Attrib1f):
    return (u <= 0.5) & (v <= 3)


@sh.program
def lift(v: sh.Attrib1f, u: sh.Attrib1f):
    sh.SH_DISCARD((v > 3) | (u > 0.5))
    return {"v": v + 0.25}


held_back = {"lift": sh.share(ready, 0.4)}
chain = sh.sequence(near, sh.loop(lower, sh.repeat(spread, 2, index="k"), lift, when=held_back, index="round"))


def start(height, width):
    return {"u": 2 * board(height, width), "v": board(height, width, 2)}


@sh.program
def show(STREAM: sh.Attrib1f) -> sh.Attrib1f:
    return STREAM
"""


@pytest.mark.sampled(3)
@pytest.mark.parametrize("stream", ["u", "v", "w"])
def test_the_trace_in_a_loop_is_of_the_last_round_that_wrote_the_pixel(tmp_path, monkeypatch, stream):
    path = tmp_path / "loops.py"
    path.write_text((HEAD + LOOPS).replace("STREAM", stream))
    found = open_file(path)
    subject = Gate(found.names["chain"], found, lambda: None)
    subject.let("chain", QUICK)
    first = subject.start(*SIZE[::-1])
    first["w"] = 0.5 * first["u"] + 0.5 * np.roll(first["u"], -1, axis=1)  # by near, before the loop
    assert subject.advance(Moment(SIZE), QUICK, 1)
    held = subject.state()
    written, interpreted, run = held.streams[stream].numpy(), [], Interpreter.run_element
    changed = written != np.float32(first[stream])
    places = [(0, 0), (1, 5), (2, 3), (3, 11), (5, 3), (7, 0), (7, 11)]
    monkeypatch.setattr(
        Interpreter, "run_element", lambda *a, **named: interpreted.append(run(*a, **named)) or interpreted[-1]
    )
    for at in places:
        subject.stepped(held, at)
        if changed[at]:
            assert interpreted[-1][0][0] == written[at]
    assert sum(changed[at] for at in places) >= 3


def test_the_last_stream_is_the_one_that_is_written_last(opened):
    found = opened("its_last_stream_comes_first")
    assert last_stream(found.pick(None)[1]) == "u"
    near, back = found.names["near"], found.names["back"]
    assert last_stream(sequence(near, back, near)) == "w"
