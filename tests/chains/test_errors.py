"""A chain that cannot run says so at the user's line, with the signatures that do not fit."""

import inspect

import numpy as np
import pytest

import shpy as sh


@sh.program
def step(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a + b


@sh.program
def norm(p: sh.Point3f) -> sh.Attrib1f:
    return sh.length(p)


@sh.program
def pair(x: sh.Attrib1f):
    return x, x


@sh.program
def grow(x: sh.Attrib1f) -> sh.Attrib1f:
    return x + 1


@sh.program
def wide(x: sh.Point3f) -> sh.Point3f:
    return 2 * x


@sh.program
def look(x: sh.Attrib1f, image: sh.Table[sh.Attrib1f, 2]):
    return {"x": image[0, sh.Attrib1i(x)]}


@sh.program
def place(backend: sh.Attrib1f) -> sh.Attrib1f:
    return backend


@sh.program
def fill():
    return {"x": sh.Attrib1f(1)}


@sh.program
def sink(x: sh.Attrib1f) -> sh.Attrib1f:
    sh.SH_DISCARD(x <= 0)
    return x - 1


@sh.program
def spin(x: sh.Attrib1f) -> sh.Attrib1f:
    sh.SH_DISCARD(x < 0)
    n = sh.Attrib1i(0)
    with sh.SH_WHILE(lambda: n < sh.Attrib1i(x)):
        n += 1
    return x - 10


def message(call, error=sh.ShpyTypeError):
    """The error's text; its line is that of the call."""
    with pytest.raises(error) as caught:
        call()
    loc = caught.value.loc
    assert loc.file == __file__
    source, first = inspect.getsourcelines(call)
    assert first <= loc.line < first + len(source)
    return f"{caught.value.message}\n{caught.value.cure}"


STEP = "step(a: Attrib1f, b: Attrib1f) -> Attrib1f"
LOOK = "look(x: Attrib1f, image: Table[Attrib1f, 2]) -> (x: Attrib1f)"


def test_an_output_without_a_name():
    assert message(lambda: sh.sequence(step)) == (
        f"the output of {STEP} has no name, and could replace a or b: an output of a chain replaces the stream of its "
        'name\nreturn {"a": value}, or a NamedTuple of the streams'
    )
    assert message(lambda: sh.repeat(norm, 2)) == (
        "the output of norm(p: Point3f) -> Attrib1f has no name, and no input has its type: an output of a chain "
        'replaces the stream of its name\nreturn {"name": value}, or a NamedTuple of the streams'
    )
    assert message(lambda: sh.sequence(pair)) == (
        "the outputs of pair(x: Attrib1f) -> (Attrib1f, Attrib1f) have no names: an output of a chain replaces the "
        'stream of its name\nreturn {"name": value}, or a NamedTuple of the streams'
    )


def test_a_stream_of_two_types():
    assert message(lambda: sh.sequence(grow, wide)) == (
        "the stream x is an Attrib1f in grow(x: Attrib1f) -> Attrib1f and a Point3f in wide(x: Point3f) -> Point3f\n"
        'wide.rename(x="…"), or one type in both'
    )
    assert message(lambda: sh.sequence(sh.repeat(wide, 2), where="x")) == (
        'the stream x is a Point3f in wide(x: Point3f) -> Point3f and an Attrib1b in where="x"\n'
        "rename(x=…) of one of the two"
    )


def test_names_of_arguments():
    assert message(lambda: sh.sequence(place)) == (
        "the input backend of place(backend: Attrib1f) -> Attrib1f cannot be a stream: backend is an argument of run\n"
        "place.rename(backend=…)"
    )


def test_missing_and_unknown_streams():
    chain = sh.sequence(grow, sh.repeat(look, 3))
    assert message(lambda: chain.run(x=1)) == (
        f"sequence(grow, repeat(look, 3)) lacks image, which {LOOK} reads\nchain.run(x=…, image=…)"
    )
    assert message(lambda: chain.run(x=1, imag=2, image=3)) == (
        f"imag is no stream of sequence(grow, repeat(look, 3)): grow(x: Attrib1f) -> Attrib1f; {LOOK}\none of x, image"
    )


def test_members():
    def plain(x):
        return x

    assert message(lambda: sh.sequence(plain)) == (
        "plain is neither a program nor a kernel nor a chain\n@sh.program above plain"
    )
    assert message(lambda: sh.sequence()) == "a chain has at least one member\nsh.sequence(first, second)"
    assert message(lambda: sh.repeat(grow, -1)) == "repeat takes a number of times, not -1\nsh.repeat(step, 500)"
    assert message(lambda: sh.loop(sink, loop_limit=0)) == "loop_limit=0\na number of rounds, or None for no limit"
    assert message(lambda: sh.sequence(grow, where=norm)) == (
        "where=norm(p: Point3f) -> Attrib1f is neither the name of a stream nor a program that returns one Attrib1b\n"
        'where="alive", or a program of the element: alive(x: sh.Attrib1f) -> sh.Attrib1b'
    )


def test_a_loop_that_never_ends():
    assert message(lambda: sh.loop(sink, grow)) == (
        "loop(sink, grow) never ends: grow(x: Attrib1f) -> Attrib1f writes every element, and a loop ends with a round "
        'that writes nothing\nSH_DISCARD in grow where there is nothing left to do, where=, until="sink", or sh.repeat'
    )
    assert message(lambda: sh.loop(sink, grow, until="grow")) == (
        'loop(sink, grow, until="grow") never ends: grow(x: Attrib1f) -> Attrib1f writes every element, and a loop '
        "ends with a round in which grow writes nothing\nSH_DISCARD in grow where there is nothing left to do, where=, "
        "or sh.repeat"
    )


def test_the_member_that_decides_a_loop():
    cure = 'until="sink"'
    for until in ("gorw", "", 3, None.__class__):
        spoken = repr(until) if isinstance(until, str | int) else until.__name__
        assert message(lambda until=until: sh.loop(grow, sink, until=until)) == (
            f"until={spoken} of a loop of grow, sink is no name of a member\n{cure}"
        )
    assert message(lambda: sh.loop(grow, sink, until=sink)).startswith("until=sink of a loop of grow, sink is no name")
    inner = sh.sequence(grow, sink)
    assert message(lambda: sh.loop(inner, until="sink")) == (
        "until='sink' of a loop of sequence(grow, sink) is no name of a member\n"
        'sh.loop(first, second, until="second"), whose members are programs'
    )


def test_shapes():
    assert message(lambda: sh.sequence(fill).run()) == (
        "fill() -> (x: Attrib1f) reads no stream by element that would tell how many there are\n"
        "chain.run(shape=(h, w), …)"
    )
    assert message(lambda: sh.sequence(look).run(x=np.zeros(3), image=np.zeros(4))).startswith(
        "image is a Table[Attrib1f, 2], and this one a Table[Attrib1f, 1]"
    )
    stream = sh.Stream(np.zeros(4), sh.Attrib1f, backend="numpy")
    assert message(lambda: sh.sequence(look).run(x=np.zeros(3), image=stream)) == (
        f"the stream image has the shape (4,), and {LOOK} reads it as a Table of 2 axes\nsh.Table[sh.Attrib1f, 1]"
    )

    @sh.program
    def add(x: sh.Attrib1f, y: sh.Attrib1f):
        return {"x": x + y}

    assert message(lambda: sh.sequence(add).run(x=np.zeros(3), y=np.zeros(4), backend="numpy")) == (
        "the streams of add(x: Attrib1f, y: Attrib1f) -> (x: Attrib1f) have several shapes: x (3,), y (4,)\n"
        "streams of one shape; a Table reads one of another shape by index"
    )

    @sh.program
    def copy(y: sh.Attrib1f):
        return {"x": y}

    assert message(lambda: sh.sequence(copy).run(x=np.zeros(3), y=np.zeros(4), backend="numpy")) == (
        "the stream x has the shape (3,), and copy(y: Attrib1f) -> (x: Attrib1f) would replace it by one of the shape "
        "(4,)\nanother name for the output, or inputs of the shape (3,)"
    )


@sh.program
def move(p: sh.Point3f, v: sh.Vector3f) -> sh.Point3f:
    return p + v


@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_an_output_replaces_the_stream_of_its_own_kind(backend):
    """A vector has three floats, too, and is no point."""
    start, speed = np.float32([[1, 2, 3], [4, 5, 6]]), np.float32([[1, 0, 0], [0, 2, 0]])
    streams = sh.repeat(move, 3).run(p=start, v=speed, backend=backend).streams
    assert np.array_equal(streams["p"].numpy(), start + 3 * speed)


def test_a_shape_beside_an_output_of_a_new_name():
    """The second program runs over what the first one makes, whose shape the streams give."""

    @sh.program
    def double(u: sh.Attrib1f):
        return {"w": u * 2}

    @sh.program
    def add(w: sh.Attrib1f):
        return {"w": w + 1}

    chain = sh.sequence(double, add)
    given = np.zeros(4, np.float32)
    assert chain.run(u=given, shape=(4,)).streams["w"].shape == (4,)
    for shape in ((5,), (2, 2), (1,)):
        said = message(lambda shape=shape: chain.run(u=given, shape=shape))
        assert f"shape={shape}" in said
        assert "of the shape (4,)" in said
        assert said.endswith("no shape=: it is for kernels that read no stream by element")


def test_devices():
    stream = sh.Stream(np.zeros(4), sh.Attrib1f, backend="numpy")
    assert message(lambda: sh.sequence(grow).run(x=stream, backend="opencl")) == (
        "backend='opencl', and the chain runs where <Stream (4,) of Attrib1f on numpy> is\nno backend=, or arrays"
    )
    kernel = grow.compile("opencl")
    assert message(lambda: sh.sequence(kernel).run(x=stream)) == (
        "grow is compiled for opencl, and the streams of the chain lie on numpy\n"
        "the program grow in the chain, which is compiled for the streams' device"
    )


def test_a_loop_that_goes_on_names_the_kernel_that_decides():
    with pytest.raises(sh.LoopLimitExceeded, match="a kernel sink that discards every element in the end"):
        sh.loop(grow, sink, until="sink", loop_limit=3).run(x=[500.0], backend="numpy")


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_budgets(backend):
    chain = sh.loop(sink, loop_limit=3)
    with pytest.raises(sh.LoopLimitExceeded) as caught:
        chain.run(x=[0.5, 1.5, 5.0], backend=backend)
    assert caught.value.message == "loop(sink) took more than 3 rounds"
    assert caught.value.cure.startswith("kernels that discard every element in the end")
    lines, first = inspect.getsourcelines(test_budgets)
    assert caught.value.loc.line == first + next(n for n, line in enumerate(lines) if "sh.loop(" in line)
    np.testing.assert_array_equal(caught.value.result.streams["x"], [-0.5, -0.5, 2])
    assert caught.value.result.counts == {"sink": 6}
    with pytest.raises(sh.LoopLimitExceeded) as caught:
        sh.repeat(spin.compile(backend, loop_limit=20), 2).run(x=[5.0, 50.0, 15.0])
    assert caught.value.message == "this loop took more than 20 iterations in 1 element"
    assert caught.value.loc.line == inspect.getsourcelines(spin.__wrapped__)[1] + 4
    np.testing.assert_array_equal(caught.value.result.streams["x"], [-5, 50, -5])
