"""Rows of the table: their traits hold on numbers, and every list of operations that is kept by hand names rows."""

from __future__ import annotations

import ast
import inspect
import itertools
from pathlib import Path

import numpy as np
import pytest

import shpy as sh
from shpy.backend.device.probe import FAULTS
from shpy.ir.constants import DTYPES
from shpy.ir.ops import COMMUTATIVE, OPS, STRUCTURAL
from shpy.ir.types import Base, vec
from shpy.lang.mistakes.foreign import OTHER_NAMES
from shpy.passes.formulas.edges import DEFINITIONS
from shpy.passes.library import CORRECTABLE, PARTS, definition
from shpy.testing.conformance.cases import SPECIAL

ROOT = Path(__file__).parents[2]


def operands(name, base, size, count=2000):
    """Arrays for a row, a third of them special numbers; vectors as (size, count)."""
    rng = np.random.default_rng(size)
    made = []
    for t in OPS[name].arguments(vec(base, size)):
        special = rng.choice(SPECIAL[t.base], (t.size, count))
        with np.errstate(all="ignore"):
            ordinary = (rng.normal(0, 4, (t.size, count))).astype(DTYPES[t.base])
        made.append(np.where(rng.random((t.size, count)) < 0.3, special, ordinary).astype(DTYPES[t.base]))
    return made


def evaluated(name, arrays):
    with np.errstate(all="ignore"):
        return np.asarray(OPS[name].meaning(*arrays))


def same(a, b):
    """Tell whether the bits are the same, but for those of a NaN."""
    equal = (a == b) & (np.signbit(a) == np.signbit(b)) if a.dtype.kind == "f" else a == b
    return bool(np.all(equal | (a != a) & (b != b)))


TYPED = [(name, base) for name, row in OPS.items() for base in sorted(b.value for b in row.bases)]


@pytest.mark.parametrize(("name", "base"), TYPED)
def test_a_row_goes_component_by_component_or_says_that_it_does_not(name, base):
    size = 3
    arrays = operands(name, base, size)
    whole = evaluated(name, arrays)
    alone = OPS[name].arguments(vec(base)) is not None
    apart = [evaluated(name, [a[k if len(a) > 1 else 0][None] for a in arrays]) for k in range(size if alone else 0)]
    each = np.concatenate([a.reshape(1, -1) for a in apart]) if alone else whole[:0]
    by_component = whole.shape == each.shape and same(whole, each)
    assert by_component == OPS[name].componentwise, f"the row of {name} wants componentwise={by_component}"


@pytest.mark.parametrize(("name", "base"), [t for t in TYPED if t[0] in COMMUTATIVE])
def test_operands_of_a_commutative_row_change_places(name, base):
    for size in (1, 3):
        a, b = operands(name, base, size)
        assert same(evaluated(name, (a, b)), evaluated(name, (b, a)))


HALF = [name for name, row in OPS.items() if Base.H in row.bases and row.gives in ("T", "S", "V3")]


@pytest.mark.parametrize("name", HALF)
def test_an_exact_row_gives_a_binary16_of_binary16(name):
    size = 1 if OPS[name].componentwise else 3
    arrays = [a.astype(np.float32) if a.dtype == np.float16 else a for a in operands(name, "h", size)]
    found = evaluated(name, arrays)
    with np.errstate(all="ignore"):
        rounded = found.astype(np.float16).astype(np.float32)
    exact = same(found, rounded)
    assert exact == OPS[name].exact, f"the row of {name} wants exact={exact}"


@pytest.mark.parametrize("name", [n for n, row in OPS.items() if row.definition])
def test_a_definition_is_a_function_of_the_ir_with_the_same_parameters(name):
    bases = [base for base in ("f", "i") if Base(base) in OPS[name].bases]
    types = next(t for size in (3, 1) if (t := OPS[name].arguments(vec(bases[0], size))) is not None)
    function = definition(name, types)
    assert [i.name for i in function.inputs] == list(OPS[name].parameters)
    assert function.pure


def test_users_call_rows_by_their_parameters():
    for row in OPS.values():
        if row.says and row.name != "atan":
            assert str(inspect.signature(getattr(sh, row.name)).replace(return_annotation=inspect.Signature.empty)) == (
                f"({', '.join(f'{p}: {chr(39)}Any{chr(39)}' for p in row.parameters)})"
            )
            assert getattr(sh, row.name).__doc__ == row.says


def words(node):
    """The strings that a literal holds: elements, keys, or the words of one that is split."""
    match node:
        case ast.Call(func=ast.Attribute(value=ast.Constant(value=str(text)), attr="split")):
            return text.split()
        case ast.Dict(keys=keys):
            return list(itertools.chain.from_iterable(words(k) for k in keys if k is not None))
        case ast.Set(elts=parts) | ast.Tuple(elts=parts) | ast.List(elts=parts):
            return list(itertools.chain.from_iterable(map(words, parts)))
        case ast.Constant(value=str(text)):
            return [text]
    return []


PRIMITIVES = {"quot", "rem", "bitcast"}  # of the formulas of edges, which the passes make
KNOWN = {*OPS, *STRUCTURAL, *PARTS, *CORRECTABLE, *DEFINITIONS, *FAULTS, *PRIMITIVES}
OPENCL = "prologue_wide.py"
"""Its lists name functions of OpenCL C: `tests/backends/test_packets_wide.py` checks them."""


ROOMS = ("ir", "passes", "backend", "testing", "accuracy")


def lists():
    """Literals of modules of which most strings are operations: (place, strings that are not)."""
    for path in sorted(p for room in ROOMS for p in (ROOT / "shpy" / room).rglob("*.py")):
        for statement in ast.parse(path.read_text()).body:
            if isinstance(statement, ast.Assign | ast.AnnAssign) and statement.value is not None:
                for node in ast.walk(statement.value):
                    found = words(node)
                    if path.name != OPENCL and len(found) > 2 and len(KNOWN.intersection(found)) > len(found) / 2:
                        yield f"{path.relative_to(ROOT)}:{node.lineno}", sorted({*found} - KNOWN)


def test_lists_that_are_kept_by_hand_name_operations():
    found = list(lists())
    assert len(found) > 20
    assert [(place, others) for place, others in found if others] == []


def test_cures_name_functions_with_their_parameters():
    assert [name for name in OTHER_NAMES.values() if not hasattr(sh, name)] == []
