"""Do the arithmetic of binary16 in binary32, rounded after every operation.

Stage: improve, after the precision is fixed. Targets need no base h: each h becomes an f that holds a binary16.

    %y = mul %a, %b : h       ->   %p = mul %a, %b : f
                                   %y = half %p : f
    %z = convert %x : h       ->   %z = half %x : f          (%x : f)
    %m = max %a, %b : h       ->   %m = max %a, %b : f       (one of its operands: nothing to round)

The op table defines binary16 so. + - * / and sqrt are correctly rounded this way, since 24 >= 2 * 11 + 2 (Figueroa
1995). Composites but `mad` are computed in binary32 and rounded once at their end. In strict mode transcendentals are
the exact value rounded once:

    %y = sin %x : h           ->   %s = call sin_portable(%x) : f    (or sin, where the target does it exactly)
                                   %y = call sin_half(%x, %s) : f    (rounds, but for a few inputs: `strict/halves.py`)

Inputs, outputs, params and tables of base h become f as well: a backend
converts where its arrays are float16, and nothing is lost, as what an output holds was rounded.
"""

from __future__ import annotations

from collections.abc import Mapping

from shpy.ir.nodes import Function, Let, Module, Value
from shpy.ir.ops import LANE_OPS, OPS, TRANSCENDENTALS
from shpy.ir.traverse import bases_of
from shpy.ir.types import Base, Type
from shpy.passes.library import Library
from shpy.passes.modes import Formulas
from shpy.passes.precision import Rebase, retype_ports, rounded
from shpy.passes.rewriter import each_function

_EXACT = frozenset("const load swizzle construct splat component param table call half".split()) | {
    *(name for name, op in OPS.items() if op.exact),
    *LANE_OPS,
}
"""Operations whose result needs no rounding if their operands are binary16."""


def lower_half(module: Module, formulas: Formulas = "portable", exact: frozenset[str] = frozenset()) -> Module:
    """Return the module without base h; the same object if it does not use base h.

    `formulas` are those of the mode at f32. `exact` are the functions that the target rounds correctly itself.
    """
    if Base.H not in bases_of(module):
        return module
    library = Library(module, "portable")
    once = formulas not in ("portable", "fast")
    changed = each_function(module, lambda f, functions: _Half(f, functions, library, once, exact).run())
    return library.added(retype_ports(changed, Base.H, Base.F))


class _Half(Rebase):
    def __init__(
        self,
        function: Function,
        functions: Mapping[str, Function],
        library: Library,
        once: bool,
        exact: frozenset[str],
    ) -> None:
        super().__init__(function, functions, Base.H, Base.F)
        self.library = library
        self.once = once
        self.exact = exact

    def let(self, let: Let) -> None:
        op, args = let.op, let.args
        old = let.value.type
        value = self.retyped(let.value)
        if op == "convert":
            self._convert(let)
        elif old.base is not Base.H or op in _EXACT:
            attr = rounded(old, let.attr) if op == "const" and isinstance(let.attr, tuple) else let.attr
            self.emit(Let(value, op, args, attr))
        elif op == "mad":
            product, rounded_product = self.value(value.type), self.value(value.type)
            self.emit(Let(product, "mul", args[:2]))
            self.emit(Let(rounded_product, "half", (product.id,)))
            whole = self.make_unrounded("add", (rounded_product.id, args[2]), Let(value, "add", ()), value.type)
            self.emit(Let(value, "half", (whole,)))
        elif op == "fma":
            callee = self.library.use("half_fma", (value.type,) * 3)
            self.emit(Let(value, "call", args, callee.name))
        elif op in TRANSCENDENTALS and self.once:
            self._transcendental(let, value)
        else:
            whole = self.make_unrounded(op, args, let, value.type)
            self.emit(Let(value, "half", (whole,)))

    def _transcendental(self, let: Let, value: Value) -> None:
        """Emit a function whose exact value is rounded once: by formulas that need no binary64, or by the target."""
        from shpy.passes.formulas.strict.halves import CORRECTED

        types = (value.type,) * len(let.args)
        if let.op in self.exact:
            whole = self.make_unrounded(let.op, let.args, let, value.type)
        else:
            formula = self.library.use(let.op, types)
            whole = self.make_unrounded("call", let.args, Let(value, "call", let.args, formula.name), value.type)
        if let.op in CORRECTED:
            callee = self.library.use(f"{let.op}_half", (*types, value.type))
            self.emit(Let(value, "call", (*let.args, whole), callee.name))
        else:
            self.emit(Let(value, "half", (whole,)))

    def make_unrounded(self, op: str, args: tuple[int, ...], let: Let, type: Type) -> int:
        """Return the operation itself, in f; its id."""
        whole = self.value(type)
        self.emit(Let(whole, op, args, let.attr))
        return whole.id

    def _convert(self, let: Let) -> None:
        (arg,) = let.args
        source, target = self.old_types[arg], let.value.type
        value = self.retyped(let.value)
        if target.base is Base.H and source.base is Base.D:
            callee = self.library.use("half_from_double", (source,))
            self.emit(Let(value, "call", (arg,), callee.name))
        elif target.base is Base.H and source.base is Base.F:
            self.emit(Let(value, "half", (arg,)))
        elif target.base is Base.H:
            self.emit(Let(value, "half", (self.make_unrounded("convert", (arg,), let, value.type),)))
        elif source.base is Base.H and target.base is Base.F:
            self.replace(value, arg)
        else:
            self.emit(Let(value, "convert", (arg,)))
