"""Random sequences of calls over streams, in the stress mode, beside a model of host arrays.

Streams are made, run over, written as `out`, read by index, wrapped and dropped in any order, while objects of the
device's own library are held. Every stream and every such object must hold what the model says, at all times.
Hypothesis shrinks a failure to the calls that it takes.
"""

import gc
import itertools
import zlib

import numpy as np
import pytest
from hypothesis import HealthCheck, settings, strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, consumes, initialize, invariant, multiple, rule
from stress.mode import stressed

import shpy as sh

SIZES = (1, 60, 2100)
"""Elements: in one dispatch, and in several."""


@sh.program
def mix(x: sh.Attrib1i, y: sh.Attrib1i) -> sh.Attrib1i:
    return 3 * x - y


@sh.program
def halve_even(x: sh.Attrib1i) -> sh.Attrib1i:
    sh.SH_DISCARD(x % 2 != 0)
    return x // 2


@sh.program
def both(x: sh.Attrib1i):
    return {"up": x + 1, "down": x - 1}


@sh.program
def mirrored(x: sh.Attrib1i, t: sh.Table[sh.Attrib1i, 1]) -> sh.Attrib1i:
    return x + t[sh.grid_shape(1) - 1 - sh.grid_index(1)]


@sh.program
def step(x: sh.Attrib1i, t: sh.Table[sh.Attrib1i, 1]):
    return {"x": x + t[sh.grid_index(1) + 1]}


PROGRAMS = (mix, halve_even, both, mirrored)


class Held:
    """A stream, or an object of the device's library, and the array that the model has for it.

    Objects over one memory have one array.
    """

    def __init__(self, thing, model):
        self.thing = thing
        self.model = model

    def read(self):
        """Return the elements, read from the object itself."""
        if isinstance(self.thing, sh.Stream):
            return self.thing.numpy()
        if isinstance(self.thing, np.ndarray):
            return self.thing.copy()
        return self.thing.get().reshape(-1)


class Machine(RuleBasedStateMachine):
    """Calls in any order. The backend is that of the subclass."""

    backend = "numpy"
    streams = Bundle("streams")
    natives = Bundle("natives")

    @initialize(seed=st.integers(0, 2**16), size=st.sampled_from(SIZES))
    def begin(self, seed, size):
        self.size = size
        self.random = np.random.default_rng(seed)
        self.kernels = {p.name: p.compile(self.backend) for p in PROGRAMS}
        self.held = []
        gc.freeze()  # what there is by now: each collection after a drop would search it, for most of the time
        self.block = stressed(zlib.crc32(f"{seed}".encode()))
        self.mode = self.block.__enter__()

    def teardown(self):
        if hasattr(self, "block"):
            self.held.clear()
            self.block.__exit__(None, None, None)

    def keep(self, thing, model):
        held = Held(thing, model)
        self.held.append(held)
        return held

    def look(self, held):
        np.testing.assert_array_equal(held.read(), held.model)

    def shares(self, *helds):
        """Return whether two of them lie in one memory."""
        return any(np.may_share_memory(a.model, b.model) for a, b in itertools.combinations(helds, 2))

    @rule(target=streams)
    def make(self):
        array = self.random.integers(-1000, 1000, self.size).astype(np.int32)
        return self.keep(sh.Stream(array, sh.Attrib1i, self.backend), array.copy())

    @rule(target=streams, x=streams, y=streams)
    def run(self, x, y):
        return self.keep(self.kernels["mix"](x.thing, y.thing), 3 * x.model - y.model)

    @rule(x=streams, y=streams, out=streams)
    def run_into(self, x, y, out):
        result = 3 * x.model - y.model
        self.kernels["mix"].run(x.thing, y.thing, out=out.thing)
        out.model[...] = result

    @rule(x=streams, out=streams)
    def run_some(self, x, out):
        even = x.model % 2 == 0
        result = np.where(even, x.model // 2, out.model)
        found = self.kernels["halve_even"].run(x.thing, out=out.thing)
        assert found.count == even.sum()
        out.model[...] = result

    @rule(x=streams, up=streams, down=streams)
    def run_two(self, x, up, down):
        """Two outputs in one memory are refused."""
        results = x.model + 1, x.model - 1
        out = {"up": up.thing, "down": down.thing}
        if self.shares(up, down):
            with pytest.raises(sh.ShpyTypeError, match=r"memory|same stream"):
                self.kernels["both"].run(x.thing, out=out)
            return
        self.kernels["both"].run(x.thing, out=out)
        up.model[...], down.model[...] = results

    @rule(x=streams, t=streams, out=streams)
    def run_over_a_table(self, x, t, out):
        """An output that the kernel reads by index is refused."""
        result = x.model + t.model[::-1]
        table = sh.Table(t.thing)
        if self.shares(t, out):
            with pytest.raises(sh.ShpyTypeError):
                self.kernels["mirrored"].run(x.thing, table, out=out.thing)
            return
        self.kernels["mirrored"].run(x.thing, table, out=out.thing)
        out.model[...] = result

    @rule(target=streams, x=streams, t=streams, times=st.integers(0, 5))
    def run_a_chain(self, x, t, times):
        model = x.model.copy()
        later = np.append(t.model[1:], t.model[-1])
        for _ in range(times):
            model = model + later
        found = sh.repeat(step, times).run(x=x.thing, t=sh.Table(t.thing)).streams["x"]
        return self.keep(found, model)

    @rule(target=streams, x=streams)
    def sort(self, x):
        return self.keep(sh.sort(x.thing), np.sort(x.model, kind="stable"))

    @rule(x=streams)
    def add_up(self, x):
        assert int(x.thing.sum()) == int(x.model.sum(dtype=np.int32))

    @rule(x=streams)
    def update(self, x):
        x.model[...] = self.random.integers(-1000, 1000, self.size)
        x.thing.update(x.model.copy())

    @rule(target=streams, x=streams)
    def copy(self, x):
        return self.keep(x.thing.copy(), x.model.copy())

    @rule(x=consumes(streams))
    def drop(self, x):
        """Let go of a stream: its memory may be used again, unless an object of the device's library holds it."""
        self.held.remove(x)
        x.thing = None
        gc.collect()

    @invariant()
    def everything_holds_what_it_should(self):
        for held in self.held if hasattr(self, "held") else []:
            self.look(held)


class Natives(Machine):
    """The same with objects of the device's library, which numpy and OpenCL let the caller's thread touch."""

    @rule(target=Machine.natives, x=Machine.streams)
    def native(self, x):
        return self.keep(x.thing.native(), x.model)

    @rule(target=Machine.streams, native=Machine.natives)
    def wrap(self, native):
        return self.keep(sh.Stream.wrap(native.thing, sh.Attrib1i), native.model)

    @rule(native=consumes(Machine.natives))
    def drop_native(self, native):
        self.held.remove(native)
        native.thing = None
        gc.collect()


class OnNumpy(Natives):
    """On numpy, whose native arrays have views that overlap."""

    @rule(target=Machine.streams)
    def views(self):
        base = self.random.integers(-1000, 1000, self.size + 1).astype(np.int32)
        model = base.copy()
        return multiple(
            *(self.keep(sh.Stream.wrap(base[k:][: self.size], sh.Attrib1i), model[k:][: self.size]) for k in (0, 1))
        )


class OnOpenCL(Natives):
    backend = "opencl"


class OnGlsl(Machine):
    backend = "glsl"


def machine(kind, examples, steps):
    """Return the test case of a machine. It is a class of its own: `kind.TestCase` is one class for all who ask."""

    class Case(kind.TestCase):
        settings = settings(
            max_examples=examples, stateful_step_count=steps, deadline=None, suppress_health_check=list(HealthCheck)
        )

    return Case


TestOnNumpy = machine(OnNumpy, 10, 50)
TestOnOpenCL = machine(OnOpenCL, 7, 50)
TestOnGlsl = machine(OnGlsl, 5, 50)


@pytest.mark.slow
class TestManyOnNumpy(machine(OnNumpy, 400, 50)):
    """At length."""


@pytest.mark.slow
class TestManyOnOpenCL(machine(OnOpenCL, 300, 50)):
    """At length."""


@pytest.mark.slow
class TestManyOnGlsl(machine(OnGlsl, 200, 50)):
    """At length."""
