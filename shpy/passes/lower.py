"""Replace composite operations and transcendentals by their definitions in plain operations.

Stage: improve, after the precision is fixed. An operation that the target does not compute exactly as the op table
defines it, or closely enough for the mode, becomes a call of a pure function of the library; a short one is inlined:

    %d = dot %a, %b : f         ->   %d = call dot3 %a, %b : f       (and the function dot3 before all others)
    %s = sin %a : f             ->   %s = call sin_strict %a : f     (the same bits on every target)
    %q = div %a, %b : f         ->   %q = call div_corrected %a, %b : f      (on a device that rounds it wrong)
    %i = convert %a : i         ->   %n = eq %a, %a : b                      (on a device that makes a number of NaN)
                                     %t = convert %a : i
                                     %i = cond %n, %t, 0 : i
    %m = mad %a, %b, %c : f     ->   %p = mul %a, %b : f
                                     %m = add %p, %c : f

The text of a target then reads `dot3(a, b)`, and the meaning is written once, in `library.py`.
"""

from __future__ import annotations

from collections.abc import Mapping

from shpy.errors import CompileError
from shpy.ir.nodes import Function, Let, Module, Store, Value
from shpy.ir.ops import COMPOSITES, OPS, TRANSCENDENTALS
from shpy.ir.types import WIDEST_PORT, Base
from shpy.passes.components import GEOMETRY
from shpy.passes.fuse import FUSED
from shpy.passes.library import BOUNDED, PARTS, Library, definition, is_exact
from shpy.passes.modes import Formulas
from shpy.passes.rewriter import Rewriter, each_function


def lower(
    module: Module,
    native: frozenset[str] = frozenset(),
    corrected: frozenset[str] = frozenset(),
    bounded: frozenset[str] = frozenset(),
    formulas: Formulas = "doubles",
    exact: frozenset[str] = frozenset(),
    *,
    fuse: bool = False,
    scalars: bool = False,
) -> Module:
    """Return the module without composite operations and transcendentals, but for those in `native`.

    Calls also replace the binary32 operations in `corrected`, a subset of CORRECTABLE, and the binary64 operations in
    `bounded`, a subset of BOUNDED: native ones that are accurate for small angles only. `formulas` are those of
    the transcendentals. The target rounds those in `exact` correctly, so they stay where the formulas do so too. With
    `fuse`, the definitions of the operations in `fuse.FUSED` are contracted, so none of these stays. With `scalars` the
    products of dot are operations of their own, which later passes find where a program computes the same ones.
    """
    library = Library(module, formulas, fuse=fuse)
    native = native - FUSED if fuse else native

    def lowered(function: Function, functions: Mapping[str, Function]) -> Function:
        return _Lower(function, functions, native, corrected, bounded, exact, library, scalars).run()

    lowered_module = each_function(module, lowered)
    return library.added(lowered_module)


class _Lower(Rewriter):
    def __init__(
        self,
        function: Function,
        functions: Mapping[str, Function],
        native: frozenset[str],
        corrected: frozenset[str],
        bounded: frozenset[str],
        exact: frozenset[str],
        library: Library,
        scalars: bool = False,
    ) -> None:
        super().__init__(function, functions)
        self.native = native
        self.corrected = corrected
        self.bounded = bounded
        self.exact = exact
        self.library = library
        self.longest_dot = WIDEST_PORT if scalars and not library.fuse else 1
        """The components of the operands up to which a dot is written as its products."""

    def let(self, let: Let) -> None:
        op = let.op
        if op in self.corrected and let.value.type.base is Base.F:
            callee = self.library.use(op, tuple(self.types[a] for a in let.args))
            self.emit(Let(let.value, "call", let.args, callee.name))
            return
        if op == "convert" and "convert_nan" in self.corrected:
            self._convert(let)
            return
        if op in self.bounded and let.value.type.base is Base.D:
            callee = self.library.use(BOUNDED[op], tuple(self.types[a] for a in let.args), self._unbounded)
            self.emit(Let(let.value, "call", let.args, callee.name))
            return
        if op in self.native and (op not in GEOMETRY or self.types[let.args[0]].size <= WIDEST_PORT):
            self.emit(let)
            return
        if is_exact(op, let.value.type, self.library.formulas):
            if op in self.exact:
                self.emit(let)
                return
            if self.library.formulas == "none":
                raise CompileError(
                    f"{op} needs binary64 in strict mode, which promises the exact value rounded, and this device has "
                    "none",
                    loc=let.value.loc,
                    cure='math="portable", whose bits are the same on every device (docs/numerics.md)',
                    lacks="f64",
                )
            callee = self.library.use(op, tuple(self.types[a] for a in let.args), self._lowered)
            self.emit(Let(let.value, "call", let.args, callee.name))
            return
        if not (op in COMPOSITES or op in TRANSCENDENTALS or op in PARTS):
            self.emit(let)
            return
        types = tuple(self.types[a] for a in let.args)
        if (op in COMPOSITES and OPS[op].inline) or (op == "dot" and types[0].size <= self.longest_dot):
            self._inline(let, definition(op, types))
        else:
            callee = self.library.use(op, types, self._lowered)
            self.emit(Let(let.value, "call", let.args, callee.name))

    def _lowered(self, function: Function) -> Function:
        return self._with(function, self.bounded)

    def _convert(self, let: Let) -> None:
        """Emit the conversion of a float to an int as `x == x ? int(x) : 0`."""
        (x,) = let.args
        if not self.types[x].is_float or not let.value.type.is_int:
            self.emit(let)
            return
        number = self.make("eq", x, x, type=self.types[x].based(Base.B))
        integer = self.value(let.value.type)
        self.emit(Let(integer, "convert", let.args))
        self.emit(Let(let.value, "cond", (number, integer.id, self.const(let.value.type, 0))))

    def _unbounded(self, function: Function) -> Function:
        return self._with(function, frozenset())

    def _with(self, function: Function, bounded: frozenset[str]) -> Function:
        lowering = _Lower(function, self.functions, self.native, self.corrected, bounded, self.exact, self.library)
        return lowering.run()

    def _inline(self, let: Let, definition: Function) -> None:
        """Emit the definition's operations; the last one gives the value."""
        renamed = {i.id: a for i, a in zip(definition.inputs, let.args, strict=True)}
        *operations, store = definition.body
        assert isinstance(store, Store)
        for s in operations:
            assert isinstance(s, Let)
            last = s.value.id == store.value
            value: Value = let.value if last else self.value(s.value.type)
            renamed[s.value.id] = value.id
            self.let(Let(value, s.op, tuple(renamed[a] for a in s.args), s.attr))
