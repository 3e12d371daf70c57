import numpy as np
import pytest
from effort import calls

from shpy.errors import ShpyTypeError
from shpy.ir.constants import DTYPES
from shpy.ir.interpreter import Interpreter
from shpy.ir.nodes import Function, Let, Loc, Module, Port, Status, Store, Value, Variable
from shpy.ir.ops import OPS, result_type
from shpy.ir.parser import parse
from shpy.ir.traverse import limited_loops
from shpy.ir.types import Base, vec
from shpy.ir.verifier import verify


def module(main, before="", outputs="$y.0: f", inputs="%x.0: f"):
    """A module whose entry has these lines, inputs and outputs."""
    ports = "".join(f"input i{n}: any\n" for n in range(inputs.count(":")))
    ports += "".join(f"output o{n}: any\n" for n in range(outputs.count(":")))
    made = parse(
        f'module m\nfile 1 "user.py"\n{ports}{before}\nfunction main({inputs}) -> ({outputs}) {{\n{main}\n}}\n'
    )
    verify(made)
    return made


def run(main, *given, before="", outputs="$y.0: f", inputs="%x.0: f", **options):
    made = module(main, before, outputs, inputs)
    keys = {"params", "tables", "index", "shape", "trace", "lane_oracle"} & set(options)
    now = {key: options.pop(key) for key in keys}
    return Interpreter(made, **options).run_element(given, **now)


def first(main, *given, **options):
    results, status = run(main, *given, **options)
    assert status == Status.WRITTEN
    return results[0]


# Operations


def rows():
    """Every row of the table with every type that it takes, one of each size."""
    for op in OPS.values():
        for base in Base:
            for size in (1, 2, 3, 4):
                args = op.arguments(vec(base, size), Base.U)
                if args is not None:
                    yield op.name, args, result_type(op.name, args)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("precision", ["f16", "f32", "f64"])
def test_every_operation_gives_its_type_at_every_precision(precision):
    rng = np.random.default_rng(7)
    dtypes = {**DTYPES, Base.F: {"f16": np.float16, "f32": np.float32, "f64": np.float64}[precision]}
    seen = set()
    for op, types, result in rows():
        values = [Value(n, t) for n, t in enumerate(types)]
        slot, made = Variable(0, result), Value(len(types), result)
        body = (Let(made, op, tuple(range(len(types)))), Store(0, made.id))
        entry = Function("main", tuple(values), (slot,), (), body)
        ports = tuple(Port(str(n), "") for n in range(len(types)))
        whole = Module("m", ports, (Port("y", ""),), (), (), (entry,))
        verify(whole)
        given = [rng.uniform(0, 1, t.size) > 0.5 if t.is_bool else rng.uniform(0, 3, t.size) for t in types]
        interpreter = Interpreter(whole, precision)
        (output,), _ = interpreter.run_element(given)
        with np.errstate(all="ignore"):
            cast = [interpreter.cast(t, g) for t, g in zip(types, given, strict=True)]
            raw = np.asarray(OPS[op].meaning(*cast))
        assert raw.shape == ((result.size,) if result.size > 1 else ()), (op, types)
        wanted = dtypes[result.base]
        if op not in ("float_from_bits", "unit_float"):  # whatever the working precision, their meaning is a binary32
            assert raw.dtype == wanted, (op, types)
        assert output.dtype == wanted
        assert np.array_equal(output, raw.astype(wanted), equal_nan=True)
        seen.add(op)
    assert seen == set(OPS)


@pytest.mark.parametrize(
    ("line", "type", "result"),
    [
        ("const (0x1p-1, -0x0p+0)", "f2", [0.5, -0.0]),
        ("const (true, false)", "b2", [True, False]),
        ("const -7", "i", -7),
        ("const 4294967295", "u", 2**32 - 1),
        ("construct %x.0, %v.1", "f4", [2.75, 10, 20, 30]),
        ("splat %x.0", "f3", [2.75, 2.75, 2.75]),
        ("swizzle.zzx %v.1", "f3", [30, 30, 10]),
        ("swizzle.y %v.1", "f", 20),
        ("component %v.1, %i.2", "f", 30),
        ("convert %x.0", "i", 2),
        ("convert %v.1", "u3", [10, 20, 30]),
        ("convert %i.2", "u", 5),
        ("convert %i.2", "b", True),
        ("half %x.0", "f", 2.75),
        ("param sky", "f2", [0.25, 0.5]),
        ("param count", "i", 9),
        ("table_size line", "i", 3),
        ("table_size image", "i2", [2, 3]),
        ("table line[%i.2]", "i", 102),
        ("table image[%at.3]", "f2", [8, 9]),
        ("neighbour image[%i.2, %i.2]", "f2", [10, 11]),
        ("grid_index", "i2", [1, 4]),
        ("grid_shape", "i2", [2, 5]),
        ("call twice(%v.1)", "f3", [20, 40, 60]),
        ("any_lane %c.4", "b", False),
        ("all_lanes %c.4", "b", False),
    ],
)
def test_structural_operations(line, type, result):
    before = """\
param sky: any f2 = (0x1p-2, 0x1p-1)
param count: any i = 8
table line: i[?]
table image: f2[2, 3]
pure function twice(%0: f3) -> ($0: f3) {
  %1: f3 = add %0, %0
  store $0 = %1
}"""
    got = first(
        f"  %9: {type} = {line}\n  store $y.0 = %9",
        2.75,
        [10, 20, 30],
        5,
        [7, 1],
        False,
        before=before,
        inputs="%x.0: f, %v.1: f3, %i.2: i, %at.3: i2, %c.4: b",
        outputs=f"$y.0: {type}",
        params={"count": 9},
        tables={"line": np.array([100, 101, 102]), "image": np.arange(12.0).reshape(2, 3, 2)},
        index=(1, 4),
        shape=(2, 5),
    )
    assert got.tolist() == result
    assert np.array_equal(np.signbit(np.asarray(got, float)), np.signbit(np.asarray(result, float)))


@pytest.mark.parametrize(
    ("by", "modulus", "place"), [(-3, 2, 0), (3, 2, 0), (0, 2, 1), (2, 0, 0), (0, -5, 0), (4, 9, 2)]
)
def test_a_neighbour_modulo_something(by, modulus, place):
    got = first(
        f"  %0: i = const {by}\n  %1: i = const {modulus}\n  %2: f = neighbour line[%0, %1]\n  store $y.0 = %2",
        before="table line: f[?]",
        inputs="",
        outputs="$y.0: f",
        tables={"line": np.array([10.0, 11, 12])},
        index=(1,),
        shape=(2,),
    )
    assert got == 10 + place


@pytest.mark.parametrize(("index", "element"), [(-5, 1.0), (0, 1.0), (1, 2.0), (2, 3.0), (3, 3.0), (2**31 - 1, 3.0)])
def test_reads_out_of_range_give_the_nearest(index, element):
    lines = "  %9: f = table t[%i.0]\n  %8: f3 = const (0x1p+0, 0x1p+1, 0x1.8p+1)\n  %7: f = component %8, %i.0\n"
    lines += "  store $y.0 = %9\n  store $z.1 = %7"
    results, _ = run(
        lines,
        index,
        inputs="%i.0: i",
        outputs="$y.0: f, $z.1: f",
        before="table t: f[3]",
        tables={"t": np.array([1, 2, 3])},
    )
    assert results == [element, element]


def test_half_rounds_to_binary16_and_stays_f():
    got = first("  %1: f = half %x.0\n  store $y.0 = %1", 0.1)
    assert got.dtype == np.float32
    assert got == np.float32(np.float16(0.1))
    assert first("  %1: f = half %x.0\n  store $y.0 = %1", 1e6) == np.inf


def test_constants_are_rounded_to_the_working_precision():
    lines = f"  %1: f = const {(0.1).hex()}\n  store $y.0 = %1"
    for precision, dtype in (("f16", np.float16), ("f32", np.float32), ("f64", np.float64)):
        got = first(lines, 0, precision=precision)
        assert got.dtype == dtype
        assert got == dtype(0.1)


# Variables


def test_arrays_start_at_zero_clamp_reads_and_drop_writes():
    lines = """\
  var $a.1: f[3]
  var $b.2: f2[2]
  store $a.1[%i.0] = %x.1
  %3: i = const 1
  store.y $b.2[%3] = %x.1
  %4: f = load $a.1[%i.0]
  %5: i = const 9
  %6: f2 = load $b.2[%5]
  %7: f3 = construct %4, %6
  store $y.0 = %7"""
    for index, stored in ((0, 7), (2, 7), (3, 0), (-1, 0)):
        made = first(lines, index, 7.0, inputs="%i.0: i, %x.1: f", outputs="$y.0: f3")
        assert made.tolist() == [stored, 0, 7]


def test_what_was_loaded_stays_when_components_are_stored():
    lines = """\
  var $v.1: f2
  var $a.2: f2[1]
  %1: f2 = load $v.1
  store.x $v.1 = %x.0
  %2: i = const 0
  %3: f2 = load $a.2[%2]
  store.x $a.2[%2] = %x.0
  %4: f4 = construct %1, %3
  store $y.0 = %4"""
    assert first(lines, 5.0, outputs="$y.0: f4").tolist() == [0, 0, 0, 0]


# Control flow

COUNT = """\
  var $n.1: f
  var $i.2: i
  loop {{
    %1: i = load $i.2
    %2: i = const 1
    %3: i = add %1, %2
    store $i.2 = %3
    %4: i = const {most}
    %5: b = gt %3, %4
    if %5 {{
      break
    }}
    %6: i = const 1
    %7: i = and %3, %6
    %8: i = const 0
    %9: b = eq %7, %8
    if %9 {{
      continue
    }}
    %10: f = load $n.1
    %11: f = add %10, %x.0
    store $n.1 = %11
  }} continuing {{
    %12: f = load $y.0
    %13: f = const 0x1p+0
    %14: f = add %12, %13
    store $y.0 = %14
    %15: f = const 0x1p+6
    %16: b = ge %14, %15
  }} until %16
  %17: f = load $n.1
  store $z.1 = %17"""


def test_continue_runs_the_continuing_part_and_break_does_not():
    lines = COUNT.format(most=10).replace("$i.2", "$i.3").replace("$n.1", "$n.2")
    results, status = run(lines, 2.0, outputs="$y.0: f, $z.1: f")
    assert (results, status) == ([10.0, 10.0], Status.WRITTEN)
    results, status = run(lines.replace("const 10", "const 100"), 2.0, outputs="$y.0: f, $z.1: f")
    assert results == [64.0, 64.0]


def test_return_ends_the_function_and_discard_the_element():
    helper = """\
function helper(%0: f, $n.0: f) -> () {
  %1: f = const 0x0p+0
  %2: b = lt %0, %1
  if %2 {
    discard
  }
  loop {
    %3: f = const 0x1p+0
    %4: b = lt %0, %3
    if %4 {
      return
    }
    store $n.0 = %0
    break
  }
}"""
    lines = "  call helper(%x.0, $y.0)\n  %1: f = load $y.0\n  %2: f = add %1, %1\n  store $y.0 = %2"
    assert run(lines, 0.5, before=helper) == ([0.0], Status.WRITTEN)
    assert run(lines, 3.0, before=helper) == ([6.0], Status.WRITTEN)
    assert run(lines, -1.0, before=helper) == ([0.0], Status.DISCARDED)
    assert run(lines, -1.0, before=helper.replace("discard", "discard 7")) == ([0.0], 7)


def test_calls_pass_values_arrays_and_references_and_start_at_zero():
    before = """\
pure function square(%0: f) -> ($0: f) {
  %1: f = mul %0, %0
  store $0 = %1
}
function fill(%0: f, $list.0: f[2], $sum.1: f) -> ($old.2: f, $last.3: f) {
  var $own.4: f
  %1: f = call square(%0)
  %2: i = const 1
  store $list.0[%2] = %1
  %3: f = load $sum.1
  store $old.2 = %3
  %4: f = add %3, %1
  store $sum.1 = %4
  %5: f = load $own.4
  %6: f = add %5, %0
  store $own.4 = %6
  store $last.3 = %6
}"""
    lines = """\
  var $a.1: f[2]
  var $s.2: f
  call fill(%x.0, $a.1, $s.2) -> %1: f, %2: f
  call fill(%x.0, $a.1, $s.2) -> %3: f, %4: f
  %5: i = const 1
  %6: f = load $a.1[%5]
  %7: f = load $s.2
  %8: f4 = construct %3, %4, %6, %7
  store $y.0 = %8"""
    assert first(lines, 3.0, before=before, outputs="$y.0: f4").tolist() == [9, 3, 9, 18]


LIMITED = """\
function inner(%0: b) -> () {
  loop turns 4 {
    loop {
    } until %0
    break
  }
}"""


def test_loops_count_their_iterations_each_time_they_are_entered():
    lines = """\
  var $n.1: i
  loop turns 5 {
    %9: i = const 1
    loop {
      %1: i = load $n.1
      %2: i = add %1, %9
      store $n.1 = %2
      %3: i = const 3
      %4: i = floormod %2, %3
      %5: i = const 0
      %6: b = eq %4, %5
    } until %6
    %7: i = const 15
    %8: b = ge %2, %7
  } until %8"""
    lines = lines.replace("%8: b = ge %2, %7", "%10: i = load $n.1\n    %8: b = ge %10, %7")
    assert run(lines, 0, loop_limit=3)[1] == Status.WRITTEN
    assert run(lines, 0, loop_limit=2)[1] == Status.FIRST_LOOP
    assert run(lines, 0, loop_limit=None)[1] == Status.WRITTEN


def test_the_status_names_the_loop_in_the_order_of_the_text():
    lines = """\
  call inner(%a.0)
  if %a.0 {
    loop {
      loop {
      } until %b.1
    } until %c.2
  }
  loop {
  } until %d.3"""
    inputs = "%a.0: b, %b.1: b, %c.2: b, %d.3: b"
    made = module(lines, LIMITED, "", inputs)
    assert [loop.until for loop in limited_loops(made)] == [0, 2, 1, 3]
    for k, given in enumerate([(0, 1, 1, 1), (1, 1, 0, 1), (1, 0, 1, 1), (1, 1, 1, 0)]):
        assert Interpreter(made, loop_limit=50).run_element(given) == ([], Status.FIRST_LOOP + k)
    assert Interpreter(made, loop_limit=1).run_element((1, 1, 1, 1)) == ([], Status.WRITTEN)


def test_a_lowered_module_gives_its_own_status():
    lines = """\
  %1: i = const {status}
  store $status.1 = %1
  %2: b = const true
  loop {{
  }} until %2
  store $y.0 = %x.0"""
    for status in (Status.WRITTEN, Status.DISCARDED, 3):
        made = module(lines.format(status=status), outputs="$y.0: f, $status.1: i")
        lowered = Module(made.name, made.inputs, made.outputs[:1], (), (), made.functions)
        verify(lowered)
        results, got = Interpreter(lowered, loop_limit=0).run_element([5.0])
        assert got == status
        assert results == [5.0 if status == Status.WRITTEN else 0.0]


# Lanes, traces, grids


def test_an_oracle_may_lie_only_where_the_other_lanes_could():
    lines = "  %1: b = any_lane %c.0\n  %2: b = all_lanes %c.0\n  store $y.0 = %1\n  store $z.1 = %2"
    ports = {"inputs": "%c.0: b", "outputs": "$y.0: b, $z.1: b"}
    for c in (False, True):
        assert run(lines, c, **ports)[0] == [c, c]
        for lie in (False, True):
            answered = run(lines, c, lane_oracle=lambda lie=lie: lie, **ports)[0]
            assert answered == [True if c else lie, lie if c else False]


def test_a_trace_tells_line_name_and_value():
    lines = """\
  var $v.1: f2
  var $a.2: f[2]
  var $3: f
  %twice.1: f = add %x.0, %x.0 @1:4
  %2: f = neg %x.0 @1:5
  store.y $v.1 = %twice.1 @1:6
  store.x $v.1 = %2 @1:7
  %3: i = const 1
  store $a.2[%3] = %2 @1:8
  store $3 = %2 @1:9
  store $y.0 = %2 @1:10"""
    steps = []

    def note(loc, name, value, iterations):
        steps.append((loc, name, np.asarray(value).tolist()))

    results, _ = run(lines, 3.0, trace=note)
    assert results == [-3.0]
    assert steps == [
        (Loc("user.py", 4), "twice", 6.0),
        (Loc("user.py", 6), "v", [0.0, 6.0]),
        (Loc("user.py", 7), "v", [-3.0, 6.0]),
        (Loc("user.py", 8), "a[1]", -3.0),
        (Loc("user.py", 10), "y", -3.0),
    ]


def test_elements_of_a_grid_know_their_place():
    lines = """\
  %1: i2 = grid_index
  %2: f2 = convert %1
  %3: f2 = splat %x.0
  %4: f2 = mul %2, %3
  store $y.0 = %4
  %5: i = swizzle.x %1
  %6: b = convert %5
  if %6 {
    discard
  }"""
    made = module(lines, outputs="$y.0: f2")
    ran = [Interpreter(made).run_element([10.0], index=index, shape=(2, 3)) for index in np.ndindex(2, 3)]
    assert [output.tolist() for (output,), _ in ran] == [[0, 0], [0, 10], [0, 20], [0, 0], [0, 0], [0, 0]]
    assert [status for _, status in ran] == [1, 1, 1, 0, 0, 0]


def test_mistakes_of_the_caller_are_named():
    with pytest.raises(ShpyTypeError, match="m takes 1 inputs, not 2"):
        run("  store $y.0 = %x.0", 1.0, 2.0)
    with pytest.raises(ShpyTypeError, match="grid_index of 2 axes in a run over 1"):
        run("  %1: i2 = grid_index", 1.0, index=(1,), shape=(4,))


def test_an_iteration_takes_a_few_calls_a_statement():
    lines = ["  var $v.1: f", "  var $n.2: i", "  loop {", "    %1: f = load $v.1"]
    lines += [f"    %{n}: f = add %{n - 1}, %x.0" for n in range(2, 9)]
    lines += ["    store $v.1 = %8", "    %9: i = load $n.2", "    %10: i = const 1", "    %11: i = add %9, %10"]
    lines += ["    store $n.2 = %11", "    %12: i = const 10000", "    %13: b = ge %11, %12", "  } until %13"]
    lines += ["  %14: f = load $v.1", "  store $y.0 = %14"]
    text = "\n".join(lines)
    assert calls(lambda: first(text, 1.0)) < 10_000 * 13 * 10
    assert first(text, 1.0) == 70_000
