"""Recording, joining, parsing and emission take steps in proportion to the size of a program, counted at n and 2n.

A step is a call of a function, of Python or of C.
"""

import gc
import sys
import warnings
from functools import partial

import pytest
from source_text import made

import shpy as sh
from shpy.ir.traverse import walk


def steps(work):
    """Return the number of calls that `work` makes."""
    count = 0

    def counted(frame, event, arg):
        nonlocal count
        count += event in ("call", "c_call")

    gc.collect()
    before = sys.getprofile()
    sys.setprofile(counted)
    try:
        work()
    finally:
        sys.setprofile(before)
    return count


def function(lines, n):
    """Return a function whose body has some lines n times, with {k} for the number of the copy."""
    body = [f"    {line.format(k=k)}\n" for k in range(n) for line in lines.split("\n")]
    return made(f"def f(x: sh.Attrib1f, y: sh.Attrib1f):\n{''.join(body)}    return x\n")


LINES = {
    "assignments": "x = x * 2 + y",
    "names": "v{k} = x + {k}\nx = v{k} * 2",
    "paths": "v{k} = [x, y]\nv{k}[0] = x + 1\nx = v{k}[0]",
    "several names in a line": "a, b = x + 1, y",
    "stores": "x[:] = x + y",
    "stores through another name": "z{k} = sh.Attrib1f(x)\nz{k} += 1\nx[:] = z{k}",
    "branches": "with SH_IF(x > {k}):\n    x[:] = x + 1\nwith SH_ELSE():\n    x[:] = x - 1",
    "branches of names": "w{k} = x + 1\nwith SH_IF(x > {k}):\n    x[:] = w{k}",
    "loops": "with SH_FOR(4) as i:\n    x[:] = x + 1",
    "branches of Python": "if {k}:\n    x = x + 1\nelse:\n    x = x + 2",
}


def recorded(lines):
    return lambda n: partial(sh.program, function(lines, n))


def else_if(n):
    links = "".join(f"    with SH_ELIF(x < {k + 1}):\n        y[:] = {k}\n" for k in range(n))
    start = "    y = sh.Attrib1f(0)\n    with SH_IF(x < 0):\n        y[:] = -1\n"
    return partial(sh.program, made(f"def f(x: sh.Attrib1f):\n{start}{links}    return y\n"))


def wide(n):
    """Return a program of n inputs."""
    inputs, total = ", ".join(f"a{k}: sh.Attrib1f" for k in range(n)), " + ".join(f"a{k}" for k in range(n))
    return sh.program(made(f"def f({inputs}):\n    return {total}\n"))


@sh.program
def plus(x: sh.Attrib1f) -> sh.Attrib1f:
    return x + 1


def beside(n):
    program = plus
    for _ in range(n):
        program = program & plus
    return program


def after(n):
    program = plus
    for _ in range(n):
        program = plus << program
    return program


def bound(n):
    program = wide(n + 2)
    for k in range(n):
        program = program.bind(**{f"a{k}": float(k)})
    return program


def text(n):
    return str(sh.program(function("x = x * 2 + y", n)).ir)


def emitted(backend, **options):
    def at(n):
        program = sh.program(function("x = x * y + sh.max(x, {k})", n))
        return lambda: program.compile(backend, **options).source

    return at


WORK = {
    **{f"recording {name}": (recorded(lines), 60) for name, lines in LINES.items()},
    "recording else-ifs": (else_if, 60),
    "binding one of many inputs": (lambda n: partial(wide(n).bind, a0=1.0), 60),
    "binding the last of many": (lambda n: partial(bound(n).bind, **{f"a{n}": 1.0}), 30),
    "one more program beside": (lambda n: partial(beside(n).__and__, plus), 30),
    "one more program after": (lambda n: partial(plus.__lshift__, after(n)), 30),
    "printing": (lambda n: partial(str, sh.parse(text(n))), 60),
    "parsing": (lambda n: partial(sh.parse, text(n)), 60),
    "emission for numpy": (emitted("numpy"), 60),
    "emission for OpenCL": (emitted("opencl", lanes=1), 60),
    "emission for packets": (emitted("opencl", lanes=4), 120),
    "emission for GLSL": (emitted("glsl"), 60),
}


@pytest.mark.sampled(16)
@pytest.mark.parametrize("name", WORK)
def test_twice_the_program_takes_twice_the_steps(name):
    work, n = WORK[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sh.ShpyWarning)
        work(n // 2)()  # what is made once, such as a parser
        once, twice = steps(work(n)), steps(work(2 * n))
    assert twice < 2.1 * once, (once, twice)


@pytest.mark.parametrize("make", [beside, after, bound])
def test_joined_programs_grow_by_what_is_joined(make):
    sizes = [sum(1 for _ in walk(make(n).ir.entry.body)) for n in (10, 20, 30)]
    assert sizes[2] - sizes[1] == sizes[1] - sizes[0]


def test_joined_programs_compute_as_before():
    assert beside(3)(1, 2, 3, 4) == (2, 3, 4, 5)
    assert after(5)(1) == 7
    assert bound(4)(10, 20) == 36
