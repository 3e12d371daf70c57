"""Fold constants, and remove operations that leave an operand unchanged.

Stage: improve, once the working precision is fixed. The op table computes the constants, so that a folded value has
the bits that the running program would compute:

    %2 = add %0, %1            ->   %2 = const 3.0        (%0 = 1.0, %1 = 2.0)
    %4 = mul %3, %one          ->   %3
    if %true { A } else { B }  ->   A
    loop { ...; until %true }  ->   ...                   (when nothing in it breaks or continues)
    store $array[%9] = %x      ->                         (nothing: %9 is beyond the array; a load takes the nearest)

A loop of no iterations is removed, and so are the statements behind a branch that always leaves. The rules for
operations are in `identities` and `vectors`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shpy.ir.constants import DTYPES, from_array, to_array
from shpy.ir.meaning import convert
from shpy.ir.nodes import EXITS, Break, Continue, Function, If, Let, Loop, Module, Region, Store
from shpy.ir.ops import LANE_OPS, OPS, TRANSCENDENTALS
from shpy.ir.traverse import has_exit, variables_of
from shpy.ir.types import Base
from shpy.passes.identities import simplify
from shpy.passes.rewriter import Functions, Rewriter, each_function
from shpy.passes.vectors import rearrange


def fold(module: Module, *, fixed: bool = True) -> Module:
    """Return the module with its constants computed.

    `fixed`: working precision and mode are fixed. Without it, arithmetic on base f and transcendentals are not folded.
    """
    sizes = {t.name: t.size for t in module.tables if t.size is not None}
    return each_function(module, lambda f, functions: _Fold(f, functions, sizes, fixed).run())


class _Fold(Rewriter):
    """Folds one function; every emitted value has been simplified already, so one walk is enough."""

    def __init__(
        self, function: Function, functions: Functions, sizes: dict[str, tuple[int, ...]], fixed: bool
    ) -> None:
        super().__init__(function, functions)
        self.sizes = sizes
        self.fixed = fixed

    # Constants

    def constant(self, value: int) -> tuple[int, ...] | None:
        """Return the components of a constant, or of the splat of one."""
        let = self.lets.get(value)
        if let is None:
            return None
        if let.op == "const":
            assert isinstance(let.attr, tuple)
            return let.attr
        if let.op == "splat":
            scalar = self.constant(let.args[0])
            return None if scalar is None else scalar * let.value.type.size
        return None

    def _computed(self, let: Let) -> tuple[int, ...] | None:
        """Return the components of the result if it is constant, else None."""
        if let.op == "table_size":
            return self.sizes.get(str(let.attr))
        if not let.args or (let.op not in OPS and let.op not in _STRUCTURAL):
            return None
        constants: list[tuple[int, ...]] = []
        for a in let.args:
            constant = self.constant(a)
            if constant is None:
                return None
            constants.append(constant)
        types = [self.types[a] for a in let.args]
        bases = {t.base for t in (*types, let.value.type)}
        if not self.fixed and (let.op in TRANSCENDENTALS or (Base.F in bases and let.op != "cond")):
            return None
        arrays = [to_array(t, c) for t, c in zip(types, constants, strict=True)]
        with np.errstate(all="ignore"):
            if let.op in LANE_OPS:
                result = arrays[0]
            elif let.op == "half":
                result = arrays[0].astype(np.float16)
            elif let.op == "convert":
                result = convert(arrays[0], DTYPES[let.value.type.base])
            else:
                result = OPS[let.op].meaning(*arrays)
        return from_array(let.value.type, np.asarray(result))

    # Statements

    def let(self, let: Let) -> None:
        if let.op == "load" and let.args:
            self.emit(self._in_range(let))
            return
        components = None if let.op == "const" else self._computed(let)
        if components is not None:
            self.emit(Let(let.value, "const", (), components))
            return
        replacement = (
            rearrange(self, let) if let.op in ("swizzle", "construct", "component", "splat") else simplify(self, let)
        )
        if isinstance(replacement, int):
            self.replace(let.value, replacement)
        elif replacement is not None and replacement is not let:
            self.let(replacement)
        else:
            self.emit(let)

    def _in_range(self, load: Let) -> Let:
        """Return the load of an array with a constant index clamped to the array's length."""
        index = self.constant(load.args[0])
        nearest = None if index is None else min(max(index[0], 0), self._length(load.attr) - 1)
        if index is None or nearest is None or nearest == index[0]:
            return load
        return replace(load, args=(self.const(self.types[load.args[0]], nearest),))

    def _length(self, variable: object) -> int:
        return next(v.length or 0 for v in variables_of(self.function) if v.id == variable)

    def store(self, store: Store) -> None:
        index = None if store.index is None else self.constant(store.index)
        if index is None or 0 <= index[0] < self._length(store.variable):
            self.emit(store)

    def branch(self, branch: If) -> None:
        condition = self.constant(branch.condition)
        if condition is not None:
            self.statements(branch.then if condition[0] else branch.orelse)
            return
        then, orelse = self.region(branch.then), self.region(branch.orelse)
        let = self.lets.get(branch.condition)
        if orelse and let is not None and let.op == "not":
            self.emit(If(let.args[0], orelse, then, branch.loc))
        elif then or orelse:
            self.emit(If(branch.condition, then, orelse, branch.loc))

    def loop(self, loop: Loop) -> None:
        if loop.turns == 0:
            return
        body = self.region(loop.body)
        if _leaves(body) and not has_exit(body, Continue):
            self._leaving(loop, body)
            return
        continuing = self.region(loop.continuing)
        until = None if loop.until is None else self.alias.get(loop.until, loop.until)
        constant = None if until is None else self.constant(until)
        once = loop.turns == 1 or (constant is not None and constant[0])
        if once and not has_exit(body, Break | Continue):
            self._splice((*body, *continuing))
        else:
            never = constant is not None and not constant[0]
            self.emit(Loop(body, continuing, None if never else until, loop.turns, loop.loc))

    def _leaving(self, loop: Loop, body: Region) -> None:
        """Emit a loop whose body always leaves it at its end: there is one iteration, and no `continuing`."""
        inside = body[:-1] if isinstance(body[-1], Break) else body
        if has_exit(inside, Break):
            self.emit(Loop(body, (), None, loop.turns, loop.loc))
        else:
            self._splice(inside)

    def _splice(self, region: Region) -> None:
        for statement in region:
            self.emit(statement)

    def statements(self, region: Region) -> None:
        for statement in region:
            self.statement(statement)
            if self._open[-1] and isinstance(self._open[-1][-1], EXITS):
                return


_STRUCTURAL = frozenset({"convert", "half"}) | LANE_OPS


def _leaves(region: Region) -> bool:
    return bool(region) and isinstance(region[-1], EXITS)
