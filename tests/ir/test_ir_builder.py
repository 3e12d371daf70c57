import pytest

from shpy.ir.builder import Builder
from shpy.ir.nodes import Break, Continue, Discard, If, Let, Loc, Loop, Module, Port, Return, Store, Value
from shpy.ir.text import print_module
from shpy.ir.traverse import continues, limited_loops, map_regions, results, rewrite, uses, walk
from shpy.ir.types import vec
from shpy.ir.verifier import verify

F, B = vec("f"), vec("b")


def module(function, *earlier):
    inputs = tuple(Port(f"i{n}", "any") for n in range(len(function.inputs)))
    outputs = tuple(Port(f"o{n}", "any") for n in range(len(function.outputs)))
    return Module("m", inputs, outputs, (), (), (*earlier, function))


def text(function, *earlier):
    made = module(function, *earlier)
    verify(made)
    return print_module(made)[print_module(made).index("\n\n") + 2 :]


def sample():
    b = Builder("main", loc=Loc("a.py", 1))
    x, c = b.input(vec("f", 3), "x"), b.input(B, "c")
    y = b.output(F, "y")
    n = b.variable(F, name="n")
    with b.loop(turns=9) as loop:
        with b.when(c):
            b.store(n, b.swizzle(x, (0,), name="first"))
            b.exit(Break)
        with b.otherwise():
            b.store(n, b.let("dot", x, x))
        loop.continuing()
        end = b.let("gt", b.load(n), b.const(F, [4.0]), name="end")
        loop.until(end)
    b.loc = Loc("a.py", 2)
    b.store(y, b.load(n))
    b.exit(Return)
    return b.finish()


def test_a_builder_writes_what_its_blocks_say():
    assert (
        text(sample())
        == """\
function main(%x.0: f3 @1:1, %c.1: b @1:1) -> ($y.0: f @1:1) @1:1 {
  var $n.1: f @1:1
  loop turns 9 @1:1 {
    if %c.1 @1:1 {
      %first.2: f = swizzle.x %x.0 @1:1
      store $n.1 = %first.2 @1:1
      break @1:1
    } else {
      %3: f = dot %x.0, %x.0 @1:1
      store $n.1 = %3 @1:1
    }
  } continuing {
    %4: f = load $n.1 @1:1
    %5: f = const 0x1p+2 @1:1
    %end.6: b = gt %4, %5 @1:1
  } until %end.6
  %7: f = load $n.1 @1:2
  store $y.0 = %7 @1:2
  return @1:2
}
"""
    )


def test_a_builder_continues_a_function():
    function = sample()
    b = Builder(function=function)
    assert b.let("neg", 7).id == 8  # the type of %7 is known
    assert b.variable(F).id == 2
    assert b.type_of(0) is vec("f", 3)
    made = b.finish()
    assert made.inputs == function.inputs
    assert made.loc == function.loc
    assert made.body == (Let(Value(8, F), "neg", (7,)),)


def test_calls_are_operations_or_statements():
    b = Builder("half")
    b.pure = True
    b.store(b.output(F), b.let("mul", b.input(F), b.const(F, [0.5])))
    half = b.finish()
    b = Builder("move")
    a, target, r = b.input(F), b.reference(F, "target"), b.output(F, "r")
    b.store(target, a)
    b.store(r, a)
    move = b.finish()
    b = Builder()
    x, y, v = b.input(F, "x"), b.output(F, "y"), b.variable(F, name="v")
    (h,) = b.call(half, x)
    (r_value,) = b.call(move, h, v)
    b.store(y, r_value)
    assert text(b.finish(), half, move).endswith("""\
function main(%x.0: f) -> ($y.0: f) {
  var $v.1: f
  %1: f = call half(%x.0)
  call move(%1, $v.1) -> %r.2: f
  store $y.0 = %r.2
}
""")


def test_arrays_splats_and_components():
    b = Builder()
    x, i = b.input(F, "x"), b.input(vec("i"), "i")
    y, a = b.output(vec("f", 2), "y"), b.variable(F, 4, "a")
    b.store(a, x, index=i)
    b.store(y, b.splat(b.load(a, i), 2))
    b.store(y, b.splat(x, 1), components=(1,))
    assert (
        text(b.finish())
        == """\
function main(%x.0: f, %i.1: i) -> ($y.0: f2) {
  var $a.1: f[4]
  store $a.1[%i.1] = %x.0
  %2: f = load $a.1[%i.1]
  %3: f2 = splat %2
  store $y.0 = %3
  store.y $y.0 = %x.0
}
"""
    )


def test_mistakes_are_named_at_once():
    b = Builder()
    x = b.input(F)
    with pytest.raises(TypeError, match="the type of splat is not in the table: give type="):
        b.let("splat", x)
    with pytest.raises(TypeError, match=r"add takes \(T, T\)"):
        b.let("add", x)
    with pytest.raises(ValueError, match="otherwise follows a when"), b.otherwise():
        pass
    with pytest.raises(ValueError, match="the body of the function is closed by finish"):
        b.pop()
    b.push()
    with pytest.raises(ValueError, match="1 regions are still open"):
        b.finish()


# Traversal


def test_walk_goes_in_the_order_of_the_text():
    names = [type(s).__name__ for s in walk(sample().body)]
    assert names == [
        "Loop",
        "If",
        "Let",
        "Store",
        "Break",
        "Let",
        "Store",
        "Let",
        "Let",
        "Let",
        "Let",
        "Store",
        "Return",
    ]


def test_walk_needs_no_recursion():
    region = ()
    for _ in range(5000):
        region = (If(0, region),)
    assert sum(1 for _ in walk(region)) == 5000


def test_rewrite_replaces_removes_and_multiplies():
    function = sample()
    assert rewrite(function.body, lambda s: s) is function.body
    without = rewrite(function.body, lambda s: None if isinstance(s, Store) else s)
    assert not any(isinstance(s, Store) for s in walk(without))
    assert len(list(walk(without))) == len(list(walk(function.body))) - 3
    doubled = rewrite(function.body, lambda s: (s, s) if isinstance(s, Store) else s)
    assert len(list(walk(doubled))) == len(list(walk(function.body))) + 3
    seen = []
    rewrite((If(0, (Break(),)),), lambda s: seen.append(type(s)) or s)
    assert seen == [Break, If]  # innermost first


def test_map_regions_keeps_what_is_unchanged():
    loop = Loop((Break(),), (), None, 3, Loc("a.py", 1))
    assert map_regions(loop, lambda r: r) is loop
    changed = map_regions(loop, lambda r: r and (Discard(), *r))
    assert changed == Loop((Discard(), Break()), (), None, 3)
    assert changed.loc == loop.loc


def test_uses_and_results():
    body = sample().body
    assert uses(body[0]) == (6,)
    assert results(body[1])[0].id == 7
    assert uses(Store(0, 5, None, 6)) == (5, 6)
    b = Builder("g")
    b.input(F)
    b.reference(F)
    callee = b.finish()
    caller = Builder()
    caller.call(callee, caller.input(F), caller.variable(F))
    assert uses(caller.finish().body[0], {"g": callee}) == (0,)


def test_continues_looks_for_its_own():
    b = Builder()
    c = b.input(B)
    with b.loop(), b.loop(turns=1), b.when(c):
        b.exit(Continue)
    function = b.finish()
    (outer,) = function.body
    assert not continues(outer)
    assert continues(outer.body[0])
    assert limited_loops(module(function)) == (outer,)
