"""Options that are bools, counts and shapes: any other value is an error, and no value is ignored."""

import numpy as np
import pytest

import shpy as sh


@sh.program
def add(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a + b


@sh.program
def grow(x: sh.Attrib1f) -> sh.Attrib1f:
    return x + 1


@sh.program
def made() -> dict:
    return {"y": sh.Attrib1f(sh.grid_index(1))}


@sh.program
def started(x: sh.Table[sh.Attrib1f]) -> dict:
    return {"y": x[0] + sh.Attrib1f(sh.grid_index(1))}


@pytest.fixture
def numbers():
    return sh.Stream([3.0, 1.0, 2.0], sh.Attrib1f, "numpy")


@pytest.mark.parametrize("answer", ["no", "", 0, 1, None, 1.0, np.array([True]), []])
def test_a_bool_is_true_or_false(numbers, answer):
    calls = {
        "descending": [lambda: sh.sort(numbers, descending=answer), lambda: sh.argsort(numbers, None, answer)],
        "exclusive": [lambda: sh.scan(add, numbers, exclusive=answer)],
    }
    for option, given in calls.items():
        for call in given:
            with pytest.raises(sh.ShpyTypeError) as caught:
                call()
            assert caught.value.message == f"{option}={answer!r} is neither True nor False"
            assert caught.value.cure == f"{option}=True"
            assert caught.value.loc.file == __file__


def test_bools_of_numpy_are_bools(numbers):
    assert sh.sort(numbers, descending=np.True_).numpy().tolist() == [3, 2, 1]
    assert sh.scan(add, numbers, exclusive=np.False_).numpy().tolist() == [3, 4, 6]


def test_bools_are_no_counts(numbers):
    ints = sh.Stream([0, 1, 1], sh.Attrib1i, "numpy")
    for call in (
        lambda: sh.histogram(ints, True),
        lambda: sh.histogram(ints, np.True_),
        lambda: sh.histogram(numbers, True, range=(0, 4)),
        lambda: sh.Stream([1.0], sh.Attrib1f, "numpy", device=False),
        lambda: sh.Stream.empty(True, sh.Attrib1f, "numpy"),
        lambda: numbers.sum(axis=False),
        lambda: sh.repeat(grow, True),
        lambda: sh.loop(grow, loop_limit=True),
    ):
        with pytest.raises(sh.ShpyTypeError):
            call()
    assert sh.Stream([1.0], sh.Attrib1f, "numpy", device=np.int64(0)).device == 0
    with pytest.raises(sh.ShpyTypeError, match=r"range=\(0, 4\) beside edges"):
        sh.histogram(numbers, [0, 1, 2], range=(0, 4))


def test_a_shape_that_no_kernel_takes_is_an_error():
    x = np.zeros(6, np.float32)
    for chain in (grow, sh.repeat(grow, 3)):
        with pytest.raises(sh.ShpyTypeError) as caught:
            sh.sequence(chain).run(x=x, shape=(7,), backend="numpy")
        assert caught.value.message == (
            "shape=(7,), and grow(x: Attrib1f) -> Attrib1f runs over the stream x of the shape (6,)"
        )
    with pytest.raises(sh.ShpyTypeError, match=r"runs over the stream y of the shape \(6,\)"):
        sh.sequence(grow.rename(x="y")).run(y=x, shape=7, backend="numpy")


def test_a_shape_that_a_kernel_takes_is_its_shape():
    x = np.zeros(6, np.float32)
    assert sh.sequence(grow).run(x=x, shape=6, backend="numpy").streams["x"].shape == (6,)
    assert sh.sequence(grow).run(x=1.0, shape=(2, 2), backend="numpy").streams["x"].shape == (2, 2)
    assert sh.sequence(started).run(x=x, shape=7, backend="numpy").streams["y"].shape == (7,)
    both = sh.sequence(grow, made).run(x=x, shape=9, backend="numpy").streams
    assert (both["x"].shape, both["y"].shape) == ((6,), (9,))


def test_a_kernel_that_never_runs_writes_no_stream():
    use = grow.rename(x="y")
    for times, inputs in ((0, ["y"]), (1, [])):
        chain = sh.sequence(sh.repeat(made, times), use)
        assert list(chain.inputs) == inputs
        assert list(sh.sequence(chain, use).inputs) == inputs
    with pytest.raises(sh.ShpyTypeError, match=r"lacks y, which grow\(y: Attrib1f\) -> Attrib1f reads"):
        sh.sequence(sh.repeat(made, 0), use).run(shape=3, backend="numpy")
    inner = sh.sequence(made)  # the same kernels in two places, one of which runs
    assert list(sh.sequence(sh.repeat(inner, 0), use, inner).inputs) == ["y"]
    assert list(sh.sequence(inner, sh.repeat(inner, 0), use).inputs) == []
    found = sh.sequence(sh.repeat(made, 0), use).run(y=[1.0, 2.0], backend="numpy")
    assert found.streams["y"].numpy().tolist() == [2, 3]


def test_an_option_that_is_not_one_is_named_with_the_choices():
    image, faces = np.zeros((2, 2), np.float32), np.zeros((6, 2, 2), np.float32)
    refused = {
        "backend=3 names no backend": lambda: grow.compile(3),
        "compile does not take math='quick'": lambda: grow.compile("numpy", math="quick"),
        "backend='gl' names no backend": lambda: sh.Stream.empty(3, sh.Attrib1f, backend="gl"),
        "precision='f8' is unknown": lambda: sh.Stream.empty(3, sh.Attrib1f, backend="numpy", precision="f8"),
        "wrap='tile' is not a wrap": lambda: sh.Texture2D(image, wrap="tile"),
        "wrap=('clamp',) does not have 2 wraps": lambda: sh.Texture2D(image, wrap=("clamp",)),
        "filter='cubic' is not a filter of a cube": lambda: sh.library.TextureCube(faces, filter="cubic"),
    }
    for said, call in refused.items():
        with pytest.raises(sh.ShpyTypeError) as error:
            call()
        what, _, cure = str(error.value).partition("\n  write instead: ")
        assert what.endswith(f": {said}")
        assert "test_options.py:" in what
        assert f"{said.split('=')[0].split()[-1]}=" in cure
