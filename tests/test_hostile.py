"""Hostile input to the compiler: names that would be code, texts that lie. A clear error, or a correct result."""

from __future__ import annotations

import tracemalloc
import unicodedata
from types import SimpleNamespace

import numpy as np
import pytest
from effort import calls

import shpy as sh
from shpy import SH_FOR
from shpy.ir.interpreter import Interpreter
from shpy.testing.arrays import flat_leaves

NAMES = [
    "float", "vec3", "main", "in", "out_", "sample", "texture", "kernel", "__global", "int4", "convert_int",
    "gl_FragCoord", "gl_x", "sh_min", "np", "lambda", "print", "__import__", "__class__", "self", "_", "__", "1", "",
    " ", "a b", "a[0]", "a;}", "a;}\nint b(){", "*/ x /*", "//", "\\", "\\\n", "\n#error x\n",
    "#define float int", '"', "'''", "{0}", "%s", "θ", "größe", "日本語", "\ufb01", "\u202e", "\0",
    "a" * 10_000, "é" * 10_000, "a_" * 5_000,
]  # fmt: skip

TEXT = """module {name}
file 1 {quoted}
input {name}: Attrib1f
output {name}: Attrib1f
param {other}: Attrib1f f = 0x1p+1
table {third}: f[3]

pure function {third}(%{name}.0: f @1:1) -> (${name}.0: f) @1:7 {{
  %{name}.1: f = add %{name}.0, %{name}.0 @1:2
  store ${name}.0 = %{name}.1 @1:3
}}

function {other}(%{name}.0: f, ${name}.0: f) -> (${other}.1: f) @1:1 {{
  %{name}.1: f = load ${name}.0 @1:2
  store ${name}.0 = %{name}.0 @1:2
  store ${other}.1 = %{name}.1 @1:2
  %{third}.2: f = const 0x0p+0
  %{third}.3: b = lt %{name}.0, %{third}.2 @1:2
  if %{third}.3 @1:9 {{
    store ${name}.0 = %{third}.2 @1:9
  }}
}}

function {name}(%{name}.0: f @1:1) -> (${name}.0: f @1:1) @1:1 {{
  var ${name}.1: f @1:3
  var ${name}.2: f[2] @1:3
  store ${name}.1 = %{name}.0 @1:4
  %{name}.1: f = const 0x1.8p+1 @1:4
  call {other}(%{name}.1, ${name}.1) @1:5 -> %{name}.2: f @1:5
  %{other}.3: f = load ${name}.1 @1:6
  %{other}.4: f = param {other} @1:6
  %{other}.5: i = const 1 @1:6
  %{other}.6: f = table {third}[%{other}.5] @1:6
  store ${name}.2[%{other}.5] = %{other}.6 @1:6
  %{other}.7: f = load ${name}.2[%{other}.5] @1:6
  %{other}.8: f = mul %{name}.2, %{other}.4 @1:6
  %{other}.9: f = add %{other}.8, %{other}.3 @1:6
  %{other}.10: f = add %{other}.9, %{other}.7 @1:6
  %{other}.11: f = call {third}(%{other}.10) @1:6
  store ${name}.0 = %{other}.11 @1:6
}}
"""
X = np.float32([-1.5, 0, 2, 1e10])
TABLE = np.float32([10, 20, 30])
EXPECTED = 2 * (X * 2 + 3 + 20)


def quote(name: str) -> str:
    escaped = {"\\": "\\\\", '"': '\\"'}
    return '"' + "".join(escaped.get(c, c if c.isprintable() else f"\\u{{{ord(c):x}}}") for c in name) + '"'


def shown(name: str) -> str:
    return ascii(name) if len(name) < 40 else f"{name[:4]!a} {len(name)}"


@pytest.mark.sampled(24)
@pytest.mark.parametrize("name", NAMES, ids=shown)
def test_a_name_is_only_a_name(name):
    """In every role at once: module, input, output, param, table, functions, values, variables, file."""
    text = TEXT.format(name=quote(name), other=quote(f"{name}2"), third=quote(f"3{name}"), quoted=quote(f"{name}.py"))
    module = sh.parse(text)
    assert module.inputs[0].name == name
    assert sh.parse(str(module)) == module
    bad = not name or "[" in name
    if bad:
        with pytest.raises(sh.VerifyError, match="is part of no structure"):
            sh.Program.from_ir(module)
        return
    program = sh.Program.from_ir(module)
    for target in ("numpy", "opencl-1", "glsl", *["opencl-4"] * (name in ("a;}", "kernel"))):
        backend, _, lanes = target.partition("-")
        kernel = program.compile(backend, lanes=int(lanes or 0) or "auto")
        (found,) = flat_leaves(kernel(X, TABLE))
        np.testing.assert_array_equal(found, EXPECTED, err_msg=target)
        code = (line.partition("#" if backend == "numpy" else "//")[0] for line in kernel.source.splitlines())
        assert max(map(len, code)) < 1000


ARGUMENTS = [
    "float_",
    "vec3",
    "gl_FragCoord",
    "kernel",
    "sample",
    "θ",
    "größe",
    "日本語",
    "sh_min",
    "_x",
    "a" * 10_000,
]


@pytest.mark.sampled(8)
@pytest.mark.parametrize("name", ARGUMENTS, ids=shown)
def test_an_argument_of_any_name_that_python_takes(name):
    """Through exec, as a field, a Param's and a subroutine's name as well."""
    names = {"sh": sh}
    exec(
        f"@sh.struct\nclass {name}:\n    {name}: sh.Attrib1f\n    v: sh.Attrib3f\n\n"
        f"gain = sh.Param(sh.Attrib1f, 2, name={name!r})\n\n"
        f"@sh.subroutine\ndef inner({name}: sh.Attrib1f):\n    {name} += 1\n    return {name} * gain\n\n"
        f"@sh.program\ndef f({name}: {name}) -> sh.Attrib1f:\n    x = sh.Attrib1f({name}.{name})\n"
        f"    return inner(x) + {name}.v.y\n",
        names,
    )
    given = SimpleNamespace(**{unicodedata.normalize("NFKC", name): X, "v": np.ones((4, 3), np.float32)})
    for backend in ("numpy", "opencl", "glsl"):
        np.testing.assert_array_equal(names["f"].compile(backend)(given), (X + 1) * 2 + 1)


def text(
    body="  store $y.0 = %x.0", head="", sig="%x.0: f", out="$y.0: f", ports="input x: Attrib1f\noutput y: Attrib1f\n"
):
    return f"module m\n{ports}{head}function m({sig}) -> ({out}) {{\n{body}\n}}\n"


def wrapped(opening: str, closing: str, count: int, core: str) -> str:
    return text("  %1: b = isnan %x.0\n" + opening * count + core + closing * count)


LIES = {
    "input x is an Attrib3f, whose type is f3, and holds an f": text(ports="input x: Attrib3f\noutput y: Attrib1f\n"),
    "output y is an Attrib1i, whose type is i, and holds an f": text(ports="input x: Attrib1f\noutput y: Attrib1i\n"),
    "input x is of Banana, which is no type of the language": text(ports="input x: Banana\noutput y: Attrib1f\n"),
    "param p is an Attrib3f, whose type is f3": text(head="param p: Attrib3f f = 0x1p+0\n"),
    "the entry has a status": text("  %1: i = const 7\n  store $s.1 = %1", out="$y.0: f, $s.1: i"),
    "discard 7 is made by the passes": text("  discard 7"),
    "lane_mask is made by the passes": text("  %1: b = lane_mask\n  if %1 {\n  }"),
    'input "a..b" is part of no structure': text(ports='input "a..b": Attrib1f\noutput y: Attrib1f\n'),
    'input "a[7]" is part of no structure': text(ports='input "a[7]": Attrib1f\noutput y: Attrib1f\n'),
    "the parts of input a do not stand together": text(
        sig="%x.0: f, %1: f, %2: f",
        ports='input "a.x": Attrib1f\ninput b: Attrib1f\ninput "a.y": Attrib1f\noutput y: Attrib1f\n',
    ),
    "an array of one element's own has at most 4096 elements, not 9999999999999": text(
        "  var $a.1: f[9999999999999]\n  store $y.0 = %x.0"
    ),
    "a table has at most 2,147,483,647 elements, not 999,999,999,999,999,999": text(
        "  %1: i = table_size t\n  store $y.0 = %x.0", "table t: f[999999999999999999]\n"
    ),
    "the structure of this input is nested more than 64 deep": text(
        ports=f'input "a{".a" * 500}": Attrib1f\noutput y: Attrib1f\n'
    ),
    "line 2: a line has at most 1,048,576 characters, not 10,000,008": f"module m\nfile 1 {'a' * 10_000_000} \n",
    "line 16777217: a text has at most 16,777,216 characters": "\n" * 20_000_000,
    "an array has at least one element": text("  var $a.1: f[-3]\n  store $y.0 = %x.0"),
    "a table is not empty": text(head="table t: f[0]\n"),
    "regions are nested more than 64 deep": wrapped("  if %1 {\n", "  }\n", 4_000, "  store $y.0 = %x.0\n"),
    "loops are nested more than 12 deep": wrapped("  loop {\n", "  break\n  }\n", 40, "").replace(
        "  break\n  }\n}", "  }\n}"
    ),
    "a component of i lies between": text("  %1: i = const 99999999999\n  store $y.0 = %x.0"),
    "two inputs are called x": text(
        ports="input x: Attrib1f\ninput x: Attrib1f\noutput y: Attrib1f\n", sig="%x.0: f, %1: f"
    ),
    "expected 'module', found the end of the text": "",
    "expected 'alone', 'function', 'pure' or the end of the text": text() + "}",
}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("said", LIES)
def test_a_text_that_lies_is_refused_at_once(said):
    sh.parse(text())  # makes the parser
    errors = []

    def take():
        with pytest.raises(sh.ShpyError) as error:
            sh.Program.from_ir(sh.parse(LIES[said]))
        errors.append(str(error.value))

    assert calls(take) < 100_000 + 20 * len(LIES[said])
    assert said in errors[0]


@pytest.mark.parametrize(
    "long",
    [
        f"module {'a' * 500_000} a",
        f"module m\nfile 1 {'a' * 500_000}",
        text().replace("input x", f"input {'a' * 500_000}").replace("Attrib1f", "Banana"),
        text(f'  %1: f = "{"a b" * 100_000}" %x.0'),
        text(f"  %1: f = call {'a' * 500_000}(%x.0)"),
    ],
    ids=["module", "file", "input", "operation", "function"],
)
def test_an_error_is_not_as_long_as_the_text(long):
    with pytest.raises(sh.ShpyError) as error:
        sh.Program.from_ir(sh.parse(long))
    assert len(str(error.value)) < 5_000


@pytest.mark.parametrize("blank", ["\n", " \n", "# a comment\n"], ids=["empty", "blank", "comment"])
def test_blank_lines_take_little_memory(blank):
    """They took 300 bytes each."""
    short = str(sh.parse(text()))
    tracemalloc.start()
    try:
        module = sh.parse(text().replace("function", blank * 30_000 + "function"))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert str(module) == short
    assert peak < 3_000_000


LYING_LOOP = text(
    """  loop turns 5 {
    %1: f = load $y.0
    %2: f = add %1, %x.0
    store $y.0 = %2
    %3: f = const 0x1p+6
    %4: b = gt %2, %3
  } until %4"""
)


@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_a_loop_that_promises_too_few_iterations_takes_those_it_needs(backend):
    program = sh.Program.from_ir(sh.parse(LYING_LOOP))
    assert program.compile(backend)(np.float32([1, 30])).y.tolist() == [65, 90]
    with pytest.raises(sh.LoopLimitExceeded, match="in 1 element"):
        program.compile(backend, loop_limit=50)(np.float32([1, 30]))


@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_a_loop_without_end_that_promises_one_is_stopped(backend):
    program = sh.Program.from_ir(sh.parse(text("  loop turns 5 {\n    store $y.0 = %x.0\n  }")))
    with pytest.raises(sh.LoopLimitExceeded):
        program.compile(backend, loop_limit=50)(X)


def test_recorded_loops_keep_their_promises():
    @sh.program
    def counts(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
        for bounds in ((5,), (7, -4, -2), (0, 100, 3), (5, 0)):
            with SH_FOR(*bounds):
                with SH_FOR(n):
                    x += 1
        return x

    assert sh.Program.from_ir(counts.ir).ir == counts.ir


def test_a_table_has_the_size_that_is_declared():
    program = sh.Program.from_ir(
        sh.parse(text("  %1: i = const 2\n  %2: f = table t[%1]\n  store $y.0 = %2", "table t: f[3]\n"))
    )
    assert program([0, 1], TABLE).y.tolist() == [30, 30]
    with pytest.raises(sh.ShpyTypeError, match=r"t is declared with the shape \(3,\), and this table has \(5,\)"):
        program([0, 1], np.zeros(5, np.float32))


def test_an_array_that_no_driver_takes():
    with pytest.raises(sh.ShpyTypeError, match="holds at most 4096, not 5000"):

        @sh.program
        def large(x: sh.Attrib1f) -> sh.Attrib1f:
            a = sh.Array(sh.Attrib1f, 5000)
            return a[0] + x


def test_a_long_text_is_read():
    """2,000 operations, each on the one before: more than Python's stack holds."""
    lines = (f"  %{k}: f = add %{k - 1 or 'x.0'}, %x.0" for k in range(1, 2_001))
    long = text("\n".join(lines).replace("%x.0, %x.0", "%x.0, %x.0") + "\n  store $y.0 = %2000")
    module = sh.parse(long)
    assert sh.parse(str(module)) == module
    outputs, _ = Interpreter(module).run_element([1])
    assert outputs == [2_001]
