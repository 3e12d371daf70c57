"""First answers: the errors that a new user meets name the mistake that was made, and a cure that works."""

import ast
import re
from pathlib import Path
from typing import Annotated, NewType

import numpy as np
import pytest
from source_text import made

import shpy as sh
from shpy.lang.values.builtins import FUNCTIONS

Place = NewType("Place", sh.Point3f)


def refused(text):
    with pytest.raises(sh.ShpyError) as caught:
        sh.program(made(text))
    return caught.value


BRANCHES = """
def f(c: sh.Attrib1b) -> sh.Color3f:
    {start}
    with SH_IF(c):
        col = sh.vec3(1, 0, 0)
    with SH_ELSE():
        col = sh.vec3(0, 1, 0)
    return col
"""


@pytest.mark.parametrize(
    ("start", "verb", "cure"),
    [
        ("col = sh.vec3(0)", "rebound", "col[:] = sh.vec3(0, 1, 0)"),
        ("col = 0", "rebound", "`col = sh.vec3(0)` before the SH_IF, `col[:] = sh.vec3(0, 1, 0)` inside the block"),
        ("pass", "made", "`col = sh.vec3()` before the SH_IF, `col[:] = sh.vec3(0, 1, 0)` inside the block"),
    ],
)
def test_a_name_of_both_branches_is_told_what_it_lacks(start, verb, cure):
    error = refused(BRANCHES.format(start=start))
    assert f"`col` is {verb} inside `with SH_ELSE()`" in error.message
    assert error.cure == cure


@pytest.mark.parametrize(
    ("text", "cure"),
    [
        ("a < b | b > c", "(a < b) | (b > c)"),
        ("a < 1 | b > 2", "(a < 1) | (b > 2)"),
        ("a > 0 & b > 1 | c > 2", "(a > 0) & (b > 1) | (c > 2)"),
        ("0 < a & b > c", "(0 < a) & (b > c)"),
        ("a < b | b < c | c < a", "(a < b) | (b < c) | (c < a)"),
    ],
)
def test_comparisons_that_lack_parentheses_get_them(text, cure):
    error = refused(f"def f(a: sh.Attrib1f, b: sh.Attrib1f, c: sh.Attrib1f) -> sh.Attrib1b:\n    return {text}\n")
    assert error.cure == cure
    meant = re.sub(r"\|", "or", re.sub("&", "and", text))
    program = sh.program(
        made(f"def f(a: sh.Attrib1f, b: sh.Attrib1f, c: sh.Attrib1f) -> sh.Attrib1b:\n    return {cure}\n")
    )
    for a, b, c in np.random.default_rng(3).integers(-2, 4, (30, 3)).tolist():
        assert program(a, b, c) == eval(meant, {"a": a, "b": b, "c": c})


@sh.program
def double(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * 2


@pytest.mark.parametrize("option", ["out", "where"])
def test_options_of_a_run_name_it(option):
    given = {"out": np.zeros(3, np.float32), "where": np.array([True, False, True])}[option]
    with pytest.raises(sh.ShpyTypeError, match=f"{option} is no input of double") as caught:
        double([1, 2, 3], **{option: given})
    assert caught.value.cure == f"double.compile().run(x, {option}={option})"
    result = eval(caught.value.cure, {"double": double, "x": [1, 2, 3], option: given})
    assert np.asarray(result.outputs).tolist() == ([2, 4, 6] if option == "out" else [2, 0, 6])


def same(x):
    return x


@pytest.mark.parametrize(
    "hint", ["sh.Attrib1f", "'sh.Attrib1f'", Annotated[sh.Attrib1f, "metres"], NewType("Length", sh.Attrib1f)]
)
def test_annotations_stand_for_their_types(hint):
    def case(x):
        return x * 2

    case.__annotations__ = {"x": hint, "return": hint}
    case.__globals__["sh"] = sh
    program = sh.program(case)
    assert program.inputs == {"x": sh.Attrib1f}
    assert program([1, 2]).tolist() == [2, 4]


def test_a_subroutine_may_be_annotated_so_too():
    @sh.subroutine
    def twice(x: Annotated[sh.Attrib1f, "m"]) -> NewType("Length", sh.Attrib1f):
        return x * 2

    @sh.program
    def case(x: sh.Attrib1f) -> sh.Attrib1f:
        return twice(x)

    assert case(3) == 6


def test_inputs_named_at_and_self_are_traced():
    def plus(at: sh.Attrib1f, self: sh.Attrib1f) -> sh.Attrib1f:
        total = at + self
        return total

    program = sh.program(plus)
    for steps in (program.trace(at=3, self=4), program.trace(3, 4), program.trace(3, self=4)):
        assert steps[-1].value == 7
    assert double.trace(x=[1, 2, 3], at=2)[-1].value == 6


def test_an_update_of_no_elements_changes_nothing():
    table = sh.Table(np.arange(4.0), sh.Attrib1f)
    table.update(np.zeros(0), start=2)
    assert np.array_equal([table[k] for k in range(4)], [0, 1, 2, 3])
    with pytest.raises(sh.ShpyTypeError, match=r"keeps the shape: \(4,\), not \(0,\)"):
        table.update(np.zeros(0))


def test_a_masked_array_names_a_cure_that_runs():
    masked = np.ma.masked_array([1.0, 2.0], [0, 1])
    for make in (double, lambda x: sh.Table(x, sh.Attrib1f), lambda x: sh.Stream(x, sh.Attrib1f, "numpy")):
        with pytest.raises(sh.ShpyTypeError, match="is a masked array") as caught:
            make(masked)
        cure = caught.value.cure.partition(",")[0]
        assert eval(cure, {"x": masked, "array": masked}).tolist() == [1, 0]


def test_the_version_is_that_of_the_installed_package():
    assert sh.__version__ == sh.packages.installed(sh.packages.DISTRIBUTION)
    assert re.fullmatch(r"\d+\.\d+.*", sh.__version__)


class Tensor:
    """A tensor of another library, which has no `__array__`."""

    def __init__(self, array, device=None):
        self.array, self.device = array, device

    def __dlpack__(self, **options):
        if self.device:
            raise BufferError("the tensor lies on a GPU")
        return self.array.__dlpack__(**options)

    def __dlpack_device__(self):
        return self.device or self.array.__dlpack_device__()


@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_a_tensor_that_has_dlpack_alone_is_taken(backend):
    x = np.arange(3, dtype=np.float32)
    assert double.compile(backend)(Tensor(x)).tolist() == [0, 2, 4]
    assert sh.Stream(Tensor(x), sh.Attrib1f, backend).numpy().tolist() == [0, 1, 2]
    table = sh.Table(Tensor(x), sh.Attrib1f)
    x[:] = 7
    assert table[1].x == 1


def test_a_tensor_elsewhere_is_refused():
    with pytest.raises(sh.ShpyTypeError, match="x is not an array that numpy can read") as caught:
        double(Tensor(np.arange(3.0), (2, 0)))
    assert caught.value.cure == "an array in the memory of the host"


def test_no_copy_is_made_of_a_tensor():
    from shpy.lang.data.hostdata import as_array

    x = np.arange(3.0)
    assert np.shares_memory(as_array(Tensor(x), "x"), x)


def test_editors_show_what_each_function_does():
    tree = ast.parse(Path(sh.__file__).with_name("__init__.pyi").read_text())
    said = {node.name for node in tree.body if isinstance(node, ast.FunctionDef) and ast.get_docstring(node)}
    assert {"smoothstep", "mix", "normalize", "hash", "noise", "unit_float", "radians", "grid_index"} <= said
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert {name for name in functions - said if name in sh.__all__ and name in FUNCTIONS} == set()


def test_a_store_into_the_value_of_a_param_is_refused():
    for type_, value, index in ((sh.Attrib3f, (1, 2, 3), 0), (sh.Matrix2f, np.eye(2), (0, 0))):
        param = sh.Param(type_, value, name="p")
        with pytest.raises(ValueError, match="read-only"):
            param.value[index] = 50
        assert np.array_equal(param.value, value)


@pytest.mark.parametrize("frozen", [(True, True), (True, False), (False, True), (False, False)])
def test_a_table_has_a_copy_of_an_array_that_is_changed_later(frozen):
    """The array is read-only when the table is made, and again before the next run, or not."""
    given = np.arange(4, dtype=np.float32)
    given.flags.writeable = not frozen[0]
    table = sh.Table(given, sh.Attrib1f, name="held")

    @sh.program
    def read(i: sh.Attrib1i) -> sh.Attrib1f:
        return table[i]

    kernels = [read.compile(backend) for backend in ("numpy", "opencl", "glsl")]
    assert [kernel([1]).tolist() for kernel in kernels] == [[1]] * 3
    given.flags.writeable = True
    given[1] = 50
    given.flags.writeable = not frozen[1]
    assert [kernel([1]).tolist() for kernel in kernels] == [[1]] * 3
    assert table[1] == 1
