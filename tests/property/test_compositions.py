"""Programs made of programs give what their parts give, called one after the other in plain Python.

50 compositions in every run, 500 others with `pytest -m slow`. Parts run on the interpreter, compositions on the
interpreter and a share on numpy. The model below knows the rules of the language's page, and no recording.
"""

from __future__ import annotations

import linecache
import random
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from backends.running import run

import shpy as sh
from shpy.backend.base import Array
from shpy.testing.arrays import differing, flat_leaves

TYPES = ("Attrib1f", "Attrib3f", "Attrib1i")
NAMES = ("x", "y", "z", "w")
TERMS = {
    ("Attrib1f", "Attrib1f"): "{0}",
    ("Attrib1f", "Attrib3f"): "sh.dot({0}, (1, 2, -3))",
    ("Attrib1f", "Attrib1i"): "0.5 * {0}",
    ("Attrib3f", "Attrib1f"): "{0} * sh.vec3(1, 3, -2)",
    ("Attrib3f", "Attrib3f"): "{0}.zxy",
    ("Attrib3f", "Attrib1i"): "sh.vec3({0}, 1, {0} * 2)",
    ("Attrib1i", "Attrib1f"): "sh.Attrib1i({0})",
    ("Attrib1i", "Attrib3f"): "sh.Attrib1i({0}.y)",
    ("Attrib1i", "Attrib1i"): "{0}",
}
COUNT = 5


class Refused(Exception):
    """The rules say that it is an error."""


@dataclass
class Part:
    """A program beside its model: typed inputs, outputs with names or None, and plain Python from a dict to a list."""

    program: sh.Program
    inputs: dict[str, str]
    outputs: list[tuple[str | None, str]]
    call: Callable[[dict[str, Array]], list[Array]]
    told: str


def arrays(types: dict[str, str], r: random.Random) -> dict[str, Array]:
    """Return COUNT random elements for each input."""
    rng = np.random.default_rng(r.randrange(1 << 30))
    made: dict[str, Array] = {}
    for name, type in types.items():
        shape = (COUNT, 3) if "3" in type else (COUNT,)
        whole = type.endswith("i")
        made[name] = rng.integers(-9, 9, shape).astype(np.int32) if whole else rng.normal(size=shape).astype(np.float32)
    return made


def fitted(value: Array, old: str, new: str) -> Array:
    """Convert a value to another type of argument: an int to a float, a scalar to a vector."""
    if (old.endswith("f") and new.endswith("i")) or ("3" in old and "1" in new):
        raise Refused
    made = value.astype(np.float32) if new.endswith("f") else value
    return np.repeat(made[:, None], 3, axis=1) if "3" in new and "1" in old else made


def leaf(r: random.Random, number: int) -> Part:
    """A program of one to three inputs and outputs, in which every input counts; ints are places of an array, too."""
    inputs = {name: r.choice(TYPES) for name in r.sample(NAMES, r.randint(1, 3))}
    named = r.random() < 0.5
    names: list[str | None] = list(r.sample((*NAMES, "p", "q"), r.randint(1, 3)))
    types = [r.choice(TYPES) for _ in names]
    lines = ["from typing import NamedTuple", "import shpy as sh", ""]
    if named:
        lines += ["class Result(NamedTuple):"] + [f"    {n}: sh.{t}" for n, t in zip(names, types, strict=True)] + [""]
    lines += ["@sh.program", f"def part{number}({', '.join(f'{n}: sh.{t}' for n, t in inputs.items())}):"]
    places = [name for name, type in inputs.items() if type == "Attrib1i" and r.random() < 0.5]
    if places:
        stored = r.choice((2, places[0]))
        lines += ["    own = sh.Array(sh.Attrib1f, 4)", "    own[1] = 2.5", f"    own[{stored}] = -0.5"]
    values = []
    for k, type in enumerate(types):
        terms = [TERMS[type, t].format(n) for n, t in inputs.items() if n not in places]
        terms += [TERMS[type, "Attrib1f"].format(f"own[{place}]") for place in places]
        values.append(f"sh.{type}({' + '.join(f'{t} * {j + k + 1}' for j, t in enumerate(terms))})")
    lines.append(f"    return {'Result' if named else ''}({', '.join(values)})")
    text, file = "\n".join(lines) + "\n", f"<part {number} of {r.random()}>"
    linecache.cache[file] = (len(text), None, text.splitlines(True), file)
    space: dict[str, Any] = {"__name__": file}
    exec(compile(text, file, "exec"), space)
    program = space[f"part{number}"]
    outputs = list(zip(names if named else [None] * len(names), types, strict=True))

    def call(given: dict[str, Array]) -> list[Array]:
        return flat_leaves(run(program, "interpreter", *(given[n] for n in inputs)).outputs)

    return Part(program, inputs, outputs, call, "\n".join(lines[2:]))


def free(name: str, taken: Any) -> str:
    """The name, or with the first number from 2 on that makes it new."""
    tries = [name, *(f"{name}_{n}" for n in range(2, 20))]
    return next(t for t in tries if t not in taken)


def joined(outputs: list[tuple[str | None, str]]) -> list[tuple[str | None, str]]:
    """Outputs keep their names where all have different ones."""
    names = {n for n, _ in outputs if n is not None}
    return outputs if len(names) == len(outputs) else [(None, t) for _, t in outputs]


def beside(f: Part, g: Part, share: bool) -> Part:
    """`f & g`, `f.merge(g)`."""
    inputs, own = dict(f.inputs), {}
    for name, type in g.inputs.items():
        own[name] = name if share and f.inputs.get(name) == type else free(name, inputs)
        inputs[own[name]] = type

    def call(given: dict[str, Array]) -> list[Array]:
        return f.call(given) + g.call({n: given[fresh] for n, fresh in own.items()})

    program = f.program.merge(g.program) if share else f.program & g.program
    told = f"({f.told}\n{'merge' if share else '&'}\n{g.told})"
    return Part(program, inputs, joined(f.outputs + g.outputs), call, told)


def fed(g: Part, f: Part) -> list[str | None]:
    """The input of g that each output of f goes to; Refused where both ways of reading it are possible."""
    by_name = [name if name in g.inputs else None for name, _ in f.outputs]
    if not any(by_name):
        targets: list[str | None] = [*g.inputs, *[None] * len(f.outputs)]
        return targets[: len(f.outputs)]
    left = [type for name, type in g.inputs.items() if name not in by_name]
    if any(target is None and type in left for target, (_, type) in zip(by_name, f.outputs, strict=True)):
        raise Refused
    return by_name


def after(g: Part, f: Part) -> Part:
    """`g << f`."""
    targets = fed(g, f)
    for target, (_, type) in zip(targets, f.outputs, strict=True):
        if target is not None:
            fitted(np.zeros((1, 3)[: 1 + ("3" in type)], np.float32), type, g.inputs[target])
    inputs, own = dict(f.inputs), {}
    for name, type in g.inputs.items():
        if name not in targets:
            own[name] = free(name, inputs)
            inputs[own[name]] = type
    rest = [o for o, target in zip(f.outputs, targets, strict=True) if target is None]

    def call(given: dict[str, Array]) -> list[Array]:
        first = f.call(given)
        to_g = {n: given[fresh] for n, fresh in own.items()}
        for target, (_, type), value in zip(targets, f.outputs, first, strict=True):
            if target is not None:
                to_g[target] = fitted(value, type, g.inputs[target])
        return g.call(to_g) + [v for v, target in zip(first, targets, strict=True) if target is None]

    outputs = joined(g.outputs + rest) if rest else g.outputs
    return Part(g.program << f.program, inputs, outputs, call, f"({g.told}\n<<\n{f.told})")


def changed(p: Part, r: random.Random) -> Part:
    """The part with names of its own, an input less, or read back from its text."""
    way = r.choice(("rename", "bind", "specialize", "parse"))
    name = r.choice(list(p.inputs))
    told = f"({p.told}\n{way} {name})"
    if way == "parse":
        again = sh.Program.from_ir(sh.parse(str(p.program.ir)))
        assert again.ir == p.program.ir
        names = [n for n, _ in p.outputs]
        outputs = p.outputs if None not in names or len(names) > 1 else []
        return Part(again, p.inputs, outputs, p.call, told) if outputs else p
    if way == "rename":
        fresh = free(r.choice(NAMES) + "r", p.inputs)
        inputs = {fresh if n == name else n: t for n, t in p.inputs.items()}

        def call(given: dict[str, Array]) -> list[Array]:
            return p.call({n: given[fresh if n == name else n] for n in p.inputs})

        if any(n == name for n, _ in p.outputs):
            return p
        return Part(p.program.rename(**{name: fresh}), inputs, p.outputs, call, told)
    if len(p.inputs) == 1:
        return p
    value = {"Attrib1f": 0.75, "Attrib3f": (1.5, -2, 0.1), "Attrib1i": -3}[p.inputs[name]]
    dtype = np.int32 if p.inputs[name].endswith("i") else np.float32
    fixed = np.array([value] * COUNT, dtype)
    if way == "bind":
        param = sh.Param(getattr(sh, p.inputs[name]), value, name=f"{name}_{r.randrange(10**9)}")
        program = p.program.bind(**{name: param})
    else:
        program = p.program.specialize(**{name: value})
    left = {n: t for n, t in p.inputs.items() if n != name}
    return Part(program, left, p.outputs, lambda given: p.call({**given, name: fixed}), told)


def composition(r: random.Random) -> Part:
    """Two to four parts, joined in turn; a refusal of the rules must be one of the language."""
    whole = leaf(r, 0)
    for number in range(1, r.randint(2, 4)):
        other = leaf(r, number)
        if r.random() < 0.4:
            whole = changed(whole, r)
        if r.random() < 0.6:
            g, f = (whole, other) if r.random() < 0.5 else (other, whole)
            try:
                whole = after(g, f)
            except Refused:
                with pytest.raises(sh.ShpyTypeError):
                    g.program << f.program
        else:
            whole = beside(whole, other, share=r.random() < 0.5)
    return changed(whole, r)


def check(seed: int) -> None:
    """Check the inputs of one composition, the names of its outputs, and every bit of the outputs."""
    r = random.Random(seed)
    whole = composition(r)
    assert list(whole.program.inputs) == list(whole.inputs), whole.told
    given = arrays(whole.inputs, r)
    with np.errstate(all="ignore"):
        wanted = whole.call(given)
    for backend in ("interpreter", *["numpy"] * (seed % 5 == 0)):
        outputs = run(whole.program, backend, *given.values()).outputs
        names = getattr(outputs, "_fields", None)
        assert names == (tuple(n for n, _ in whole.outputs) if whole.outputs[0][0] else None), whole.told
        found = flat_leaves(outputs)
        assert len(found) == len(wanted), whole.told
        for a, b in zip(found, wanted, strict=True):
            assert not differing(a, b).any(), f"{backend}, seed {seed}: {a} instead of {b}\n{whole.told}"


@pytest.mark.sampled(4)
@pytest.mark.parametrize("group", range(5))
def test_compositions_give_what_their_parts_give(group: int) -> None:
    for seed in range(10 * group, 10 * group + 10):
        check(seed)


@pytest.mark.slow
@pytest.mark.parametrize("group", range(20))
def test_many_compositions_give_what_their_parts_give(group: int) -> None:
    for seed in range(1000 + 25 * group, 1025 + 25 * group):
        check(seed)
