import pytest
from effort import calls
from hypothesis import given, settings, strategies as st

from shpy.errors import ParseError
from shpy.ir.builder import Builder
from shpy.ir.constants import encode
from shpy.ir.nodes import (
    Break,
    Call,
    Continue,
    Discard,
    Function,
    If,
    Let,
    Loc,
    Loop,
    Module,
    Param,
    Port,
    Return,
    Store,
    Table,
    Value,
    Variable,
)
from shpy.ir.ops import OPS
from shpy.ir.parser import parse
from shpy.ir.text import print_module, quote, unquote
from shpy.ir.types import Base, vec

EVERYTHING = """\
module "every thing"
file 1 "first.py"
file 2 "a \\"b\\"\\u{a}.py"
input x: Attrib1f
input "on top": "Attrib3b[2]"
output y: Attrib1f
param sky: Color3f f3 = (0x1p+0, 0x1.8p+1, -0x0p+0)
param n: Attrib1i i = -3 range (-4, 0x1.8p+1) step 1 title "how \\"many\\"" description ""
param on: Attrib1b b = true
table grid: f4[?, ?, ?]
table tree: u[16]

pure function "dot 2"(%a.0: f2, %b.1: f2) -> ($2: f) @1:1 {
  %2: f2 = mul %a.0, %b.1 @1:2
  %3: f = swizzle.x %2
  %4: f = swizzle.y %2
  %5: f = add %3, %4
  store $2 = %5
}

function helper(%0: f, $total.0: f @1:4, $list.1: i[4]) -> ($a.2: f, $b.3: i) {
  store $total.0 = %0 @1:5
}

function main(%x.0: f, %"on top".1: b3) -> ($y.0: f @2:1) @1:7 {
  var $v.1: f3 @1:8
  var $"näme \\u{a}\\\\".2: i[4]
  var $t.3: f
  %é.2: f3 = const (0x1p-1, inf, nan) @2:9
  %3: i = const -7
  %4: b3 = const (true, false, true)
  %5: i = load $"näme \\u{a}\\\\".2[%3]
  %6: f3 = load $v.1
  %7: i = grid_index
  %8: f3 = param sky
  %9: i3 = table_size grid
  %10: f4 = table grid[%9]
  %11: f2 = swizzle.wx %10
  %12: f = call "dot 2"(%11, %11) @1:10
  store.zx $v.1 = %11 @1:11
  store $"näme \\u{a}\\\\".2[%3] = %5
  call helper(%x.0, $t.3, $"näme \\u{a}\\\\".2) @1:12 -> %p.13: f, %q.14: i @2:3
  call nothing()
  if %4 @1:13 {
    discard 3 @1:14
  } else {
    if %4 {
      discard
    }
  }
  loop turns 8 @1:15 {
    if %4 {
      break @1:16
    }
    loop {
      continue
    }
  } continuing {
    %15: b = isnan %x.0
  } until %15
  return @1:17
}
"""


def facts(module):
    """Everything, also what does not count for equality."""
    return repr(module)


def test_everything_is_read_back_word_for_word():
    module = parse(EVERYTHING)
    assert print_module(module) == EVERYTHING
    assert facts(parse(print_module(module))) == facts(module)


def test_what_the_text_means():
    main = parse(EVERYTHING).entry
    assert main.inputs == (Value(0, vec("f")), Value(1, vec("b", 3)))
    assert main.inputs[1].name == "on top"
    assert main.variables[1] == Variable(2, vec("i"), 4)
    assert main.variables[1].name == "näme \n\\"
    constant = main.body[0]
    assert constant == Let(Value(2, vec("f", 3)), "const", (), encode(vec("f", 3), [0.5, float("inf"), float("nan")]))
    assert constant.value.loc == Loc('a "b"\n.py', 9)
    assert main.body[3] == Let(Value(5, vec("i")), "load", (3,), 2)
    assert main.body[11] == Store(1, 11, (2, 0))
    assert main.body[13] == Call("helper", (0, 3, 2), (Value(13, vec("f")), Value(14, vec("i"))))
    assert main.body[14] == Call("nothing", ())
    assert main.body[15] == If(4, (Discard(3),), (If(4, (Discard(),)),))
    inner = Loop((Continue(),))
    step = Let(Value(15, vec("b")), "isnan", (0,))
    assert main.body[16] == Loop((If(4, (Break(),)), inner), (step,), 15, 8)
    assert main.body[17] == Return()


def test_names_and_locations_can_be_left_out():
    module = parse(EVERYTHING)
    plain = print_module(module, names=False, locations=False)
    assert "@" not in plain
    assert "file" not in plain
    assert "%é" not in plain
    assert 'input "on top"' in plain  # a port's name is part of the module
    assert parse(plain) == module
    renamed = parse(EVERYTHING.replace("$v.1", "$w.1").replace("@1:11", "@1:19"))
    assert print_module(renamed) != EVERYTHING
    assert print_module(renamed, names=False, locations=False) == plain


def test_comments_blank_lines_and_windows_line_ends_are_ignored():
    text = "# a module\n\n" + EVERYTHING.replace("\n", "  # why\r\n\r\n")
    assert facts(parse(text)) == facts(parse(EVERYTHING))


def test_a_person_may_write_decimals():
    text = "module m\nfunction main() -> () {\n  %0: f3 = const (1, -2.5, 1e-3)\n  %1: f = const -inf\n}"
    constants = parse(text).entry.body
    assert constants[0].attr == encode(vec("f", 3), [1.0, -2.5, 0.001])
    assert constants[1].attr == encode(vec("f"), [-float("inf")])


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("%1: f = add %2 %3", "column 18: expected ',', a location such as @1:12 or the end of the line, found '%3'"),
        ("%1: g = add %2", "column 7: expected a type such as f or i3, found 'g'"),
        ("%1: f5 = add %2", "column 7: expected a type such as f or i3, found 'f5'"),
        ("%1 = add %2", "column 6: expected ':', found '='"),
        ("%1: f =", "column 10: expected an operation, found the end of the line"),
        ("%1: f = const true", "column 17: expected a number of f, found true"),
        ("%1: b = const 1", "column 17: expected true or false, found 1"),
        ("%1: i = const 1.5", "column 17: expected a whole number, found 1.5"),
        ("%1: f2 = const 1", "column 18: f2 has 2 components, found 1"),
        ("%1: f = const 1e999", "column 17: 1e999 is too large"),
        ("%1: f = const 0x1p+2000", "column 17: 0x1p+2000 is too large"),
        ("%1: f = const __import__", "column 17: expected '(' or a number, found '__import__'"),
        ("%1: f = swizzle.q %0", "column 19: expected components such as xz, found 'q'"),
        ("%1: f = neg %b.0", "column 15: %b.0 is called %a.0 on line 4"),
        ("%1: f = neg %0 @7:2", "column 18: file 7 is not declared"),
        ("store $0 %0", "column 12: expected '=' or '[', found '%0'"),
        ("call g($0)", "column 10: g takes a value such as %3 here, found '$0'"),
        ("jump", "column 3: expected a statement or '}', found 'jump'"),
        ("if %0", "column 8: expected '{' or a location such as @1:12, found the end of the line"),
        ("return; return", "column 9: expected a location such as @1:12 or the end of the line, found ';'"),
        ('%"\\u{110000}".1: b = neg %0', "column 3: no character has this number"),
    ],
)
def test_malformed_lines_are_explained(line, error):
    head = "module m\npure function g(%0: f) -> ($0: f) {\n}\nfunction main(%a.0: f) -> ($0: f) {\n"
    text = f"{head}  {line}\n}}"
    number = text.split("\n").index("  " + line) + 1
    with pytest.raises(ParseError) as raised:
        parse(text)
    message, shown, pointer = str(raised.value).split("\n")
    assert message == f"line {number}, {error}"
    assert shown == "    " + line
    assert pointer.index("^") == 1 + int(error.split(":")[0].removeprefix("column "))


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", "line 1, column 1: expected 'module', found the end of the text"),
        ("module", "line 1, column 7: expected a name, found the end of the line"),
        (
            "module m\nfunction main() -> () {",
            "line 2, column 24: expected a statement or '}', found the end of the text",
        ),
        ("module m\ninput x f", "line 2, column 9: expected ':', found 'f'"),
        ("module m\ntable t: f[0.5]", "line 2, column 13: expected ',' or ']', found '.'"),
        ("import os", "line 1, column 1: expected 'module', found 'import'"),
        ('module "m', "line 1, column 8: expected a name, found '\"'"),
        ("modulestructural", "line 1, column 1: expected 'module', found 'modulestructural'"),
        (
            "module m\nfunction main() -> () {\n  returns\n}",
            "line 3, column 3: expected a statement or '}', found 'returns'",
        ),
        (
            "module m\nfunction main() -> () {\n  loop turns8 {",
            "line 3, column 8: expected 'turns', '{' or a location such as @1:12, found 'turns8'",
        ),
    ],
)
def test_malformed_modules_are_explained(text, error):
    with pytest.raises(ParseError) as raised:
        parse(text)
    assert str(raised.value).split("\n")[0] == error


def long_module(count):
    b = Builder("main")
    x = b.input(vec("f"), "x", Loc("long.py", 1))
    y = b.output(vec("f"), "y")
    for line in range(count // 2):
        x = b.let("add", x, x, name="x", loc=Loc("long.py", line))
        b.store(y, x)
    return Module("long", (Port("x", "Attrib1f"),), (Port("y", "Attrib1f"),), (), (), (b.finish(),))


@pytest.mark.slow
def test_effort_is_linear_in_statements():
    few, many = long_module(1_000), long_module(10_000)
    short, long = print_module(few), print_module(many)
    assert parse(long) == many
    assert calls(lambda: print_module(many)) < 11 * calls(lambda: print_module(few))
    assert calls(lambda: parse(long)) < 11 * calls(lambda: parse(short))


def test_deep_nesting_costs_no_recursion():
    depth = 3000
    text = "module m\nfunction main(%0: b) -> () {\n" + "if %0 {\n" * depth + "}\n" * depth + "}\n"
    module = parse(text)
    assert print_module(module).count("if %0 {") == depth


# Any module at all, well formed or not

names = st.one_of(
    st.none(), st.text(max_size=6), st.sampled_from(["x", "é", "if", "a.b", "1", "\n", '"', "\\u{41}", "x "])
)
words = st.text(max_size=6)
ids = st.integers(0, 99)
locs = st.one_of(st.none(), st.builds(Loc, st.text(max_size=4), st.integers(0, 999)))
types = st.sampled_from([vec(base, size) for base in Base for size in (1, 2, 3, 4)])
some_ids = st.lists(ids, max_size=4).map(tuple)
components = st.lists(st.integers(0, 3), min_size=1, max_size=4).map(tuple)


def values(type=None):
    return st.builds(Value, ids, types if type is None else st.just(type), names, locs)


def constants(type):
    floats = st.floats(allow_nan=True)
    ints = {Base.I: st.integers(-(2**31), 2**31 - 1), Base.U: st.integers(0, 2**32 - 1), Base.B: st.booleans()}
    component = ints.get(type.base, floats)
    return st.lists(component, min_size=type.size, max_size=type.size).map(lambda c: encode(type, c))


@st.composite
def lets(draw):
    value = draw(values())
    op = draw(st.sampled_from(["const", "load", "swizzle", "param", "table", "table_size", "call", *sorted(OPS)[:9]]))
    match op:
        case "const":
            return Let(value, op, (), draw(constants(value.type)))
        case "load":
            return Let(value, op, draw(some_ids)[:1], draw(ids))
        case "swizzle":
            return Let(value, op, (draw(ids),), draw(components))
        case "param" | "table_size":
            return Let(value, op, (), draw(words))
        case "table":
            return Let(value, op, (draw(ids),), draw(words))
        case "call":
            return Let(value, op, draw(some_ids), draw(words))
    return Let(value, op, draw(some_ids))


leaves = st.one_of(
    lets(),
    st.builds(Store, ids, ids, st.none() | components, st.none() | ids, locs),
    st.builds(Call, words, some_ids, st.lists(values(), max_size=2).map(tuple), locs),
    st.builds(Break, locs),
    st.builds(Continue, locs),
    st.builds(Return, locs),
    st.builds(Discard, st.integers(0, 5), locs),
)
regions = st.recursive(
    st.lists(leaves, max_size=3).map(tuple),
    lambda inner: st.lists(
        st.one_of(
            leaves,
            st.builds(If, ids, inner, inner, locs),
            st.builds(Loop, inner, inner, st.none() | ids, st.none() | st.integers(0, 999), locs),
        ),
        max_size=3,
    ).map(tuple),
    max_leaves=12,
)
variables = st.builds(Variable, ids, types, st.none() | st.integers(1, 99), names, locs)


@st.composite
def functions(draw, name):
    """Ids are unique, so that each has one name; the statements may mention any."""
    inputs = draw(st.lists(values(), max_size=2, unique_by=lambda v: v.id))
    outputs, others = draw(st.lists(variables, max_size=2)), draw(st.lists(variables, max_size=2))
    return Function(name, tuple(inputs), tuple(outputs), tuple(others), draw(regions), draw(st.booleans()), draw(locs))


@st.composite
def modules(draw):
    params = st.lists(types.flatmap(lambda t: st.builds(Param, words, words, st.just(t), constants(t))), max_size=2)
    tables = st.lists(
        st.builds(Table, words, types, st.integers(1, 3)) | st.builds(Table, words, types, st.just(2), st.just((4, 5))),
        max_size=2,
    )
    ports = st.lists(st.builds(Port, words, words), max_size=2).map(tuple)
    return Module(
        draw(words),
        draw(ports),
        draw(ports),
        tuple(draw(params)),
        tuple(draw(tables)),
        (draw(functions("f")), draw(functions("main"))),
    )


@settings(max_examples=60, deadline=None)
@given(modules())
def test_any_module_is_read_back(module):
    assert parse(print_module(module, names=False)) == module
    assert parse(print_module(module, names=False, locations=False)) == module


@settings(max_examples=200, deadline=None)
@given(st.text())
def test_any_name_is_read_back(name):
    assert unquote(quote(name)) == name
    head = Function("f", (Value(0, vec("f"), name, Loc(name, 3)),), (), (), ())
    module = Module(name, (Port(name, name),), (), (), (), (head,))
    assert facts(parse(print_module(module))) == facts(module)


@settings(max_examples=200, deadline=None)
@given(st.text(alphabet=st.sampled_from('%$@:=(){}[]<>,.\n "\\#abf012'), max_size=60))
def test_noise_is_an_error_and_nothing_else(noise):
    with pytest.raises(ParseError, match=r"^line \d+, column \d+: "):
        parse("module m\n" + noise + "\nfunction main(")
