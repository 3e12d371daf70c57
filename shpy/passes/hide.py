"""Hide expressions that a driver's compiler gets wrong: derivable floats, and arrays of bools.

Stage: improve, last. `hide_derivable` keeps a compiler from replacing `0 * x` by 0 or `x + 0` by x, which is wrong
where x is infinite, NaN or -0.0. The printer of such a target writes a float zero as a value that the compiler does not
know. The pass adds that zero to each float whose value the driver could find by unrolling loops and merging branches:

    %f = convert %i : f                  ->  %t = convert %i : f;  %f = add %t, 0.0       (each int that becomes one)
    store $x = 1.0                       ->  %t = add 1.0, 0.0;    store $x = %t          (if $x is read)
    %m = call mix1 %a, %b, 1.0           ->  %t = add 1.0, 0.0;    %m = call mix1 %a, %b, %t
    %d = sub (cond %c, 1.0, 2.0), 1.0    ->  %t = add 1.0, 0.0;    %d = sub (cond %c, 1.0, 2.0), %t

A value is *derivable* if it depends on constants, counters and conditions alone. After the pass no operation on floats
has operands that are all derivable.
"""

from __future__ import annotations

from dataclasses import replace

from shpy.ir.nodes import Call, Function, Let, Module, Store, Value, Variable
from shpy.ir.traverse import variables_of, walk
from shpy.ir.types import Base
from shpy.passes.rewriter import Functions, Rewriter, each_function

_CHOOSING = frozenset({"cond", "construct", "splat", "swizzle", "component", "neg", "abs", "min", "max"})
"""Operations that return an operand, its negation or its absolute value: the result is zero only if an operand is."""
_FETCHED = frozenset({"load", "param", "table", "half"})
_UNKNOWN = frozenset({"table", "call", "grid_index"})
_MINUS_ZERO = 1 << 63


def hide_derivable(module: Module) -> Module:
    """Return the module without operations on floats that a compiler could compute."""
    entry = module.entry.name

    def hidden(function: Function, functions: Functions) -> Function:
        return _Hide(function, functions, function.name == entry).run()

    return each_function(module, hidden)


class _Hide(Rewriter):
    def __init__(self, function: Function, functions: Functions, entry: bool) -> None:
        super().__init__(function, functions)
        self.derivable: set[int] = set()
        read = {s.attr for s in walk(function.body) if isinstance(s, Let) and s.op == "load"}
        passed = {a for s in walk(function.body) if isinstance(s, Call) for a in s.args}
        handed = set() if entry else {o.id for o in function.outputs}
        handed |= {i.id for i in function.inputs if not isinstance(i, Value)}
        self.read = read | passed | handed
        """The variables that are loaded here, or whose values callers or callees may read."""

    def let(self, let: Let) -> None:
        op, args = let.op, let.args
        if not let.value.type.is_float:
            if op not in _UNKNOWN and all(a in self.derivable for a in args):
                self.derivable.add(let.value.id)
        elif op == "const":
            assert isinstance(let.attr, tuple)
            if any(bits & ~_MINUS_ZERO for bits in let.attr):  # printers write zeros as unknown values
                self.derivable.add(let.value.id)
        elif op == "convert" and not self.types[args[0]].is_float:
            result = self.value(let.value.type)
            self.emit(Let(result, op, args))
            self._emit_sum("add", let.value, result.id)
            return
        elif op == "float_from_bits" and args[0] in self.derivable:
            bits = self.types[args[0]]
            nothing = self.make("bits_from_float", self.const(let.value.type, 0.0), type=bits)
            let = Let(let.value, op, (self.make("or", args[0], nothing, type=bits),))
        elif op in _CHOOSING:
            if any(a in self.derivable for a in (args[1:] if op == "cond" else args)):
                self.derivable.add(let.value.id)
        elif op == "call":
            let = Let(let.value, op, tuple(self._hide(a) if self._is_known(a) else a for a in args), let.attr)
        elif op not in _FETCHED:
            let = self._with_one_hidden(let)
        self.emit(let)

    def _is_known(self, value: int) -> bool:
        return self.types[value].is_float and value in self.derivable

    def _with_one_hidden(self, let: Let) -> Let:
        floats = [a for a in let.args if self.types[a].is_float]
        if not floats or any(a not in self.derivable for a in floats):
            return let
        constant = next((a for a in floats if a in self.lets and self.lets[a].op == "const"), floats[0])
        at = let.args.index(constant)
        return Let(let.value, let.op, (*let.args[:at], self._hide(constant), *let.args[at + 1 :]), let.attr)

    def _hide(self, value: int) -> int:
        """Emit a value with the same bits that the driver cannot derive; return its id."""
        result = self.value(self.types[value])
        constant = self.lets.get(value)
        plus = constant is not None and isinstance(constant.attr, tuple) and _MINUS_ZERO not in constant.attr
        self._emit_sum("add" if plus else "sub", result, value)
        return result.id

    def _emit_sum(self, op: str, value: Value, number: int) -> None:
        """Emit `number + 0.0`, or `number - 0.0`, which keeps -0.0, as `op` says."""
        zero = self.const(value.type, 0.0)
        self.emit(Let(value, op, (number, zero)))

    def store(self, store: Store) -> None:
        if self._is_known(store.value) and store.variable in self.read:
            store = Store(store.variable, self._hide(store.value), store.components, store.index, store.loc)
        self.emit(store)

    def call(self, call: Call) -> None:
        inputs = self.functions[call.function].inputs
        args = tuple(
            self._hide(a) if isinstance(i, Value) and self._is_known(a) else a
            for a, i in zip(call.args, inputs, strict=True)
        )
        self.emit(Call(call.function, args, call.results, call.loc))


def hold_bools_as_ints(module: Module) -> Module:
    """Return the module without local arrays of bools, after `prepare`; the same object if it has none.

    Mesa's zink aborts the process if a varying index reads a local array of bools.

        $seen: b[4]                   ->  $seen: i[4]
        %x = load $seen[%i] : b       ->  %t = load $seen[%i] : i;  %x = convert %t : b
        store $seen[%i] = %c          ->  %t = convert %c : i;      store $seen[%i] = %t
    """
    if not any(_is_concerned(v) for function in module.functions for v in variables_of(function)):
        return module
    return each_function(module, lambda function, functions: _Ints(function, functions).run())


def _is_concerned(variable: Variable) -> bool:
    return variable.length is not None and variable.type.is_bool


def _slot(variable: Variable) -> Variable:
    return replace(variable, type=variable.type.based(Base.I)) if _is_concerned(variable) else variable


class _Ints(Rewriter):
    def __init__(self, function: Function, functions: Functions) -> None:
        super().__init__(function, functions)
        self.arrays = {v.id for v in variables_of(function) if _is_concerned(v)}

    def run(self) -> Function:
        f = super().run()
        inputs = tuple(i if isinstance(i, Value) else _slot(i) for i in f.inputs)
        return replace(f, inputs=inputs, variables=tuple(map(_slot, f.variables)))

    def let(self, let: Let) -> None:
        if let.op != "load" or let.attr not in self.arrays:
            self.emit(let)
            return
        integer = self.value(let.value.type.based(Base.I))
        self.emit(Let(integer, "load", let.args, let.attr))
        self.emit(Let(let.value, "convert", (integer.id,)))

    def store(self, store: Store) -> None:
        if store.variable in self.arrays:
            number = self.make("convert", store.value, type=self.types[store.value].based(Base.I))
            store = replace(store, value=number)
        self.emit(store)
