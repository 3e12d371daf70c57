"""Contract products and sums to fused multiply-adds, by one rule for every target.

Stage: improve, before every other pass, on the module as it was recorded. A sum or difference of floats, one operand
of which is a product, becomes an `fma`, which rounds once. Where both are products, the left one is contracted:

    %2 = mul %a, %b : f                    %2 = mul %a, %b : f
    %3 = add %2, %c : f              ->    %3 = fma %a, %b, %c : f
    %4 = sub %c, %2 : f              ->    %n = neg %a : f
                                           %4 = fma %n, %b, %c : f
    %5 = sub %2, %c : f              ->    %n = neg %c : f
                                           %5 = fma %a, %b, %n : f
    %6 = mad %a, %b, %c : f          ->    %6 = fma %a, %b, %c : f

A product that is used elsewhere too is computed there as before. A scalar product that is repeated for a vector counts
as a product, and so does a variable to which a product was last assigned, on every path. The rule reads no counts of
uses and no results of other passes, so the other passes do not change its bits. The definitions of the composite
operations in FUSED follow the same rule (`library`). Formulas of elementary functions are added later, as they are.
"""

from __future__ import annotations

from typing import Final

from shpy.ir.nodes import Call, Function, If, Let, Loop, Module, Store
from shpy.ir.traverse import changed_variables, continues, regions_of, walk
from shpy.passes.rewriter import Functions, Rewriter, each_function, falls_through

FUSED: Final = frozenset(
    "mix smoothstep smootherstep dot cross length distance normalize reflect refract faceforward".split()
)
"""The composite operations whose definitions are contracted. `mod` and `fract` stay in the range of their results."""


def fuse(module: Module) -> Module:
    """Return the module with sums of products contracted to `fma`."""
    return each_function(module, fuse_function)


def fuse_function(function: Function, functions: Functions) -> Function:
    """Return a function with sums of products contracted; `functions` are those that it calls."""
    return _Fuse(function, functions).run()


class _Fuse(Rewriter):
    """Contracts one function; `contents` has the product that a variable holds, for each that holds one."""

    def __init__(self, function: Function, functions: Functions) -> None:
        super().__init__(function, functions)
        self.contents: dict[int, int] = {}
        self._loaded: dict[int, int] = {}
        """By value that is loaded from a variable, the product."""
        self._births: dict[int, int] = {}
        """The number of each product, in the order in which they are made."""

    def let(self, let: Let) -> None:
        if let.op == "load" and let.attr in self.contents and not let.args:
            self._loaded[let.value.id] = self.contents[let.attr]
        elif let.value.type.is_float and let.op == "mad":
            let = Let(let.value, "fma", let.args)
        elif let.value.type.is_float and let.op in ("add", "sub"):
            let = self._contracted(let)
        if let.op in ("mul", "splat"):
            self._births[let.value.id] = len(self._births)
        self.emit(let)

    def _contracted(self, let: Let) -> Let:
        left, right = let.args
        minus = let.op == "sub"
        if factors := self._factors(left, let):
            return Let(let.value, "fma", (*factors, self._negated(right, let) if minus else right))
        if factors := self._factors(right, let):
            first, second = factors
            return Let(let.value, "fma", (self._negated(first, let) if minus else first, second, left))
        return let

    def _factors(self, operand: int, of: Let) -> tuple[int, ...] | None:
        """Return the factors of an operand that is a product, repeated where the product is; None for another one."""
        let = self.lets.get(self._loaded.get(operand, operand))
        if let is not None and let.op == "splat":
            factors = self._factors(let.args[0], of)
            return None if factors is None else tuple(self.make("splat", f, type=of.value.type) for f in factors)
        return let.args if let is not None and let.op == "mul" else None

    def _negated(self, operand: int, of: Let) -> int:
        return self.make("neg", operand, type=of.value.type)

    # Contents of variables

    def store(self, store: Store) -> None:
        self.emit(store)
        self.contents.pop(store.variable, None)
        product = self._loaded.get(store.value, store.value)
        if store.components is None and store.index is None and product in self._births:
            self.contents[store.variable] = product

    def call(self, call: Call) -> None:
        self.emit(call)
        for variable in changed_variables(call, self.functions):
            self.contents.pop(variable, None)

    def branch(self, branch: If) -> None:
        before, since = self.contents, len(self._births)
        self.contents = dict(before)
        then = self.region(branch.then)
        after_then, self.contents = self.contents, dict(before)
        orelse = self.region(branch.orelse)
        after_orelse = self.contents
        if not falls_through(then):
            after_then = after_orelse
        elif not falls_through(orelse):
            after_orelse = after_then
        self.contents = {
            variable: product
            for variable, product in after_then.items()
            if after_orelse.get(variable) == product and self._births[product] < since
        }
        self.emit(If(branch.condition, then, orelse, branch.loc))

    def loop(self, loop: Loop) -> None:
        changed = {v for region in regions_of(loop) for s in walk(region) for v in changed_variables(s, self.functions)}
        outside = {v: product for v, product in self.contents.items() if v not in changed}
        self.contents = dict(outside)
        body = self.region(loop.body)
        if continues(loop):
            self.contents = dict(outside)
        continuing = self.region(loop.continuing)
        self.contents = outside
        self.emit(Loop(body, continuing, loop.until, loop.turns, loop.loc))
