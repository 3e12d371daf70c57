"""Golden texts of the numpy printer, one feature each; what must never be in a text, and names that clash."""

import ast
from typing import Any

import numpy as np
import pytest

import shpy as sh
from shpy import SH_BREAK, SH_CONTINUE, SH_DISCARD, SH_DO, SH_ELIF, SH_ELSE, SH_FOR, SH_IF, SH_WHILE
from shpy.backend.emit.spell_python import PythonSpeller
from shpy.backend.emit.tree import BOOL, Expr, Literal, Name, call, infix, negation, prefix
from shpy.ir.types import Base, vec

INT, FLOAT = vec(Base.I), vec(Base.F)
heights = sh.Table(np.zeros((4, 5), np.float32), sh.Attrib1f, name="heights")
children = sh.Table(np.zeros((9, 2), np.int32), sh.Attrib2i, name="children")
sky = sh.Param(sh.Color3f, (0.2, 0.4, 0.8), name="sky")


@sh.program
def wave(x: sh.Attrib1f, k: sh.Attrib2f) -> sh.Attrib2f:
    y = sh.sin(x) * k + 0.25
    return sh.cond(y > 0, y, -k)


@sh.program
def terrain(cell: sh.Attrib2i) -> tuple[sh.Color3f, sh.Attrib2i]:
    h = heights[cell]
    return sky * h, sh.grid_index(2)


@sh.program
def histogram(x: sh.Attrib1i) -> tuple[sh.Attrib1i, sh.Attrib2f]:
    counts = sh.Array(sh.Attrib1i, 4)
    last = sh.Attrib2f()
    with SH_FOR(0, 10) as i:
        counts[(x >> i) % 4] += 1
        SH_CONTINUE(i % 3 == 1)
        last.y = sh.Attrib1f(counts[i])
    return counts[x], last


@sh.program
def positive(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    total = sh.Attrib1f(0)
    with SH_IF(x < 0):
        SH_DISCARD()
    with SH_ELSE():
        with SH_WHILE(lambda: n > 0):
            total += sh.min(x, 1) / sh.Attrib1f(n)
            n -= 1
    return total


@sh.program
def descend(x: sh.Attrib1f) -> sh.Attrib1i:
    """All lanes walk together: the node is a scalar, though they leave where they like."""
    node = sh.Attrib1i(0)
    with SH_FOR(0, 8) as level:
        SH_BREAK(x < sh.Attrib1f(level))
        with SH_IF(sh.any_lane(x > 5)):
            node[:] = children[node].x
        with SH_ELIF(level == 3):
            node[:] = children[node].y
        with SH_ELSE():
            node += 1
    return node


PROGRAMS: dict[str, Any] = {
    "wave": wave, "terrain": terrain, "histogram": histogram, "positive": positive,
    "descend": descend,
}  # fmt: skip


@pytest.mark.parametrize("name", PROGRAMS)
def test_golden_text(name: str, snapshots: Any) -> None:
    snapshots.check(f"{name}.py", PROGRAMS[name].compile("numpy").source)


@pytest.mark.parametrize("name", PROGRAMS)
def test_every_text_is_a_module_of_functions_without_superfluous_names(name: str) -> None:
    source = PROGRAMS[name].compile("numpy").source
    tree = ast.parse(source)
    assert all(isinstance(node, ast.Import | ast.ImportFrom | ast.FunctionDef) for node in tree.body)
    assert max(map(len, source.splitlines())) <= 120
    names = [node for node in ast.walk(tree) if isinstance(node, ast.Name)]
    stored = {node.id for node in names if isinstance(node.ctx, ast.Store)}
    assert stored <= {node.id for node in names if isinstance(node.ctx, ast.Load)}, "a name that nobody reads"


def test_names_of_users_and_of_the_text_do_not_meet() -> None:
    @sh.program
    def lanes(np: sh.Attrib3f, dot: sh.Attrib3f) -> sh.Attrib1f:
        where = sh.dot(np, dot)
        vector = sh.Attrib3f(where, 1, 2)
        vector[:] = vector * where
        return sh.length(vector)

    a, b = np.float32([[1, 2, 3]]), np.float32([[2, 0, 1]])
    kernel = lanes.compile("numpy")
    np.testing.assert_allclose(kernel(a, b), np.linalg.norm([25, 5, 10]), rtol=1e-6)
    assert "import numpy as np\n" in kernel.source


def test_a_file_name_cannot_leave_its_comment() -> None:
    scope: dict[str, Any] = {"sh": sh}
    text = "@sh.program\ndef f(x: sh.Attrib1f) -> sh.Attrib1f:\n    return x + 1\n"
    exec(compile(text, "a\nraise SystemExit\n.py", "exec"), scope)
    kernel = scope["f"].compile("numpy")
    assert "raise" in kernel.source
    assert kernel(np.float32(1)) == 2


def test_an_inlined_value_is_computed_before_what_it_reads_changes() -> None:
    @sh.program
    def swap(v: sh.Attrib3f) -> tuple[sh.Attrib3f, sh.Attrib1f, sh.Attrib3f]:
        w = sh.Attrib3f(v)
        x = sh.Attrib1f(w.x)
        doubled = 2 * w
        with SH_IF(v.y > 0):
            w.x = v.y
            w.yz = w.zx
        return w, x, doubled

    data = np.float32([[1, 2, 3], [4, -5, 6]])
    w, x, doubled = swap.compile("numpy")(data)
    assert w.tolist() == [[2, 3, 2], [4, -5, 6]]
    assert x.tolist() == [1, 4]
    assert doubled.tolist() == (2 * data).tolist()


def test_a_long_chain_of_conditions_stays_flat() -> None:
    @sh.program
    def chain(x: sh.Attrib1f) -> sh.Attrib1f:
        y = sh.Attrib1f(0)
        n = sh.Attrib1i(0)
        with SH_WHILE(lambda: n < 4):
            with SH_IF(n == 0):
                y += x
            with SH_ELIF(n == 1):
                y *= x
            with SH_ELIF(n == 2):
                y -= 1
            with SH_ELSE():
                y /= x
            n += 1
        return y

    source = chain.compile("numpy").source
    assert source.count("elif") == 2
    assert chain.compile("numpy")(np.float32([2, 4])).tolist() == [1.5, 3.75]


a, b, c = (Name(INT, n) for n in "abc")
x, y = Name(FLOAT, "x"), Name(FLOAT, "y")


@pytest.mark.parametrize(
    ("expression", "text"),
    [
        (infix("-", infix("-", a, b), c), "a - b - c"),
        (infix("-", a, infix("-", b, c)), "a - (b - c)"),
        (infix("*", infix("+", a, b), c), "(a + b) * c"),
        (infix("/", a, infix("*", b, c)), "a / (b * c)"),
        (prefix("-", infix("+", a, b)), "-(a + b)"),
        (prefix("-", prefix("-", a)), "-(-a)"),
        (infix("<", infix("<", a, b), c), "(a < b) < c"),
        (infix("==", a, infix("==", b, c)), "a == (b == c)"),
        (infix("&", infix("|", a, b), c), "(a | b) & c"),
        (infix("|", a, infix("&", b, c)), "a | (b & c)"),
        (infix("&", infix("<", a, b), prefix("~", c)), "(a < b) & ~c"),
        (infix("<<", infix("+", a, b), c), "(a + b) << c"),
        (prefix("~", infix("&", a, b)), "~(a & b)"),
        (infix("-", a, Literal(FLOAT, -1.0)), "a - -1.0"),
        (call("np.sqrt", INT, infix("+", a, b)), "np.sqrt(a + b)"),
    ],
)
def test_brackets(expression: Expr, text: str) -> None:
    assert PythonSpeller().text(expression) == text


def test_negations() -> None:
    def condition(e: Expr) -> str:
        return PythonSpeller().condition(e)[0]

    assert condition(negation(infix("<", a, b, BOOL))) == "a >= b"
    assert condition(negation(infix("<", x, y, BOOL))) == "not x < y"
    assert condition(negation(infix("==", x, y, BOOL))) == "x != y"
    assert negation(negation(a)) == a
    assert condition(negation(infix("&", a, b, BOOL))) == "not a & b"


@pytest.mark.parametrize("value", [0.1, -0.0, 1e-45, 3.4028235e38, float("inf"), float("nan"), 1 / 3, 16777217.0])
def test_literals_mean_the_constant_at_its_precision(value: float) -> None:
    for base, dtype in ((Base.F, np.float32), (Base.D, np.float64)):
        literal = PythonSpeller().text(Literal(vec(base), value))
        with np.errstate(all="ignore"):
            found = np.ones(1, dtype) * eval(literal, {"np": np})
            expected = dtype(value)
        assert found.dtype == dtype
        np.testing.assert_array_equal(found[0], expected)
        assert np.signbit(found[0]) == np.signbit(expected)


def test_loops_that_end_on_one_line_give_their_names_back_from_the_inside_out() -> None:
    @sh.program
    def nested(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
        total = sh.Attrib1f(0)
        with SH_DO():
            SH_BREAK(total >= a)
            with SH_FOR(40):
                total += b
                SH_BREAK(total > a * b)
        return total + a + b

    a, b = np.arange(100, dtype=np.float32), np.arange(100, dtype=np.float32)[::-1] % 7 + 1
    expected = []
    for x, y in zip(a, b, strict=True):
        total = np.float32(0)
        while True:
            if total >= x:
                break
            for _ in range(40):
                total += y
                if total > x * y:
                    break
        expected.append(total + x + y)
    kernel = nested.compile("numpy")
    assert "        a = all_a\n        b = all_b\n    a = all_a_2\n" in kernel.source
    np.testing.assert_array_equal(kernel(a, b), expected)


def test_a_shift_is_an_operator_where_it_is_known_to_be_less_than_32() -> None:
    @sh.program
    def shifted(u: sh.Attrib1u, i: sh.Attrib1i) -> tuple[sh.Attrib1u, sh.Attrib1u, sh.Attrib1i]:
        return (u >> (u & 31)) + 1, (u << (u & 63)) + 1, (i >> (i & 31)) + (i << (u & 15))

    kernel = shifted.compile("numpy")
    assert "u >> (u & 31)" in kernel.source
    assert "i >> (i & 31)" in kernel.source
    assert "shift_left(u, u & 63)" in kernel.source, "may be 32 and more"
    assert "shift_left(i, u & 15)" in kernel.source, "numpy would make 64 bits of an int and an unsigned one"
    u = np.array([0, 1, 31, 32, 33, 2**31, 2**32 - 1], np.uint32)
    i = np.array([0, 1, -1, 31, -33, -(2**31), 2**31 - 1], np.int32)
    found = kernel(u, i)
    n = [(int(k) & 31) for k in u]
    assert found[0].tolist() == [((int(k) >> m) + 1) % 2**32 for k, m in zip(u, n, strict=True)]
    assert found[1].tolist() == [((int(k) << m) + 1) % 2**32 for k, m in zip(u, n, strict=True)]
    wanted = [(int(k) >> (int(k) & 31)) + (int(k) << (m & 15)) for k, m in zip(i, n, strict=True)]
    assert found[2].tolist() == [(w + 2**31) % 2**32 - 2**31 for w in wanted]


def test_a_vector_of_equal_numbers_is_written_at_each_use() -> None:
    @sh.program
    def f(x: sh.Color3f, n: sh.Attrib1i) -> sh.Color3f:
        grey = sh.Color3f(0.5, 0.5, 0.5)
        with SH_IF(n > 2):
            x += grey
        return x * grey + grey

    source = f.compile("numpy").source
    assert "    x = select(n > 2, x + 0.5, x)" in source
    assert "    return x * 0.5 + 0.5" in source
