"""The order of passes from a recorded module to one that a target prints.

Stage: improve. Each pass is a function Module -> Module in its own file. This file applies them in order:

    precision -> half -> lower -> inline -> by value -> shelter -> exits -> optimise -> unused functions

`fuse` comes before all of them, where a kernel is compiled with it (`run/kernel`).

`inline` and `by value` are for targets that run packets of elements; `vectorize`, also theirs, comes after that.
`shelter` is for targets whose drivers nest blocks to a limited depth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

from shpy.ir.exact import FUNCTIONS
from shpy.ir.nodes import Function, If, Let, Loc, Loop, Module
from shpy.ir.ops import OPS, TRANSCENDENTALS
from shpy.ir.traverse import walk
from shpy.passes.by_value import pass_by_value, takes_array
from shpy.passes.components import LONG, has_long, take_apart
from shpy.passes.cse import merge_common
from shpy.passes.dead import remove_dead, remove_unused_functions, remove_unused_inputs
from shpy.passes.exits import make_exits_explicit
from shpy.passes.fold import fold
from shpy.passes.fuse import FUSED
from shpy.passes.half import lower_half
from shpy.passes.inline import inline_calls, inline_independent
from shpy.passes.lower import lower
from shpy.passes.modes import Math, Precision, formulas_of
from shpy.passes.nesting import shelter_loops
from shpy.passes.precision import set_precision
from shpy.passes.promote import promote
from shpy.passes.rewriter import Functions, Rewriter, each_function

_ROUNDS = 3
"""The most rounds of optimisation: folded constants remove branches, and that makes more values constant."""


@dataclass(frozen=True, slots=True)
class Target:
    """The abilities of a target.

    `native`: the composite operations that it computes exactly as the op table defines them, and the transcendentals
    that it computes within the bounds of relaxed mode. `fast`: those that it has at any accuracy. `wrong`: those of
    binary32 that it rounds wrong, and that are to be corrected. `bounded`: those of binary64 that keep the bounds for
    small angles only. `loop_flags`: the device may stop long loops on its own. `nesting`: the depth of blocks that its
    driver takes. `vector`: the prepared module goes to `vectorize`, whose functions take values only.
    `doubles`: it has binary64. `fuses`: it has fma of binary64 in hardware.
    `exact`: the transcendentals of binary32 that it rounds correctly itself. `long`: it has vectors of eight.
    """

    name: str
    native: frozenset[str] = frozenset()
    fast: frozenset[str] = frozenset()
    wrong: frozenset[str] = frozenset()
    bounded: frozenset[str] = frozenset()
    loop_flags: bool = False
    nesting: int | None = None
    vector: bool = False
    doubles: bool = True
    fuses: bool = False
    exact: frozenset[str] = frozenset()
    long: bool = True

    def does(self, math: Math) -> frozenset[str]:
        """Return the operations that the target computes itself in this mode."""
        return {
            "strict": self.native - TRANSCENDENTALS,
            "portable": self.native - TRANSCENDENTALS,
            "relaxed": self.native,
            "fast": self.native | self.fast,
        }[math]


class Options(Protocol):
    """The options of a compilation that preparation uses."""

    @property
    def precision(self) -> Precision:
        """The working precision."""

    @property
    def math(self) -> Math:
        """The exactness of functions."""

    @property
    def fuse(self) -> bool:
        """True if sums of products are contracted: the module is the result of `fuse`."""

    @property
    def loop_limit(self) -> int | None:
        """The largest number of iterations of a loop without a known bound; None sets no limit."""


@dataclass(frozen=True, slots=True)
class PreparedModule:
    """A module to print. With `status`, its entry's last output is an i that says how the element ended.

    `loops[k]` is the line of the loop that status FIRST_LOOP + k names. `flagged`: each loop sets a flag when it
    finishes (`exits.Ending`).
    """

    module: Module
    status: bool
    loops: tuple[Loc | None, ...]
    flagged: bool = False


def prepare(module: Module, options: Options, target: Target) -> PreparedModule:
    """Return a recorded module made ready for a target's printer."""
    corrected = target.wrong if options.math != "fast" else frozenset()
    bounded = target.bounded if options.math == "relaxed" else frozenset()
    formulas = formulas_of(options.math, target.doubles, target.fuses)
    module = without_rules(module)
    plain = lower_half(set_precision(module, options.precision), formulas, target.exact)
    does = target.does(options.math)
    lowered = lower(plain, does, corrected, bounded, formulas, target.exact, fuse=options.fuse, scalars=target.vector)
    if target.vector:
        lowered = pass_by_value(inline_calls(lowered, takes_array))
    if not target.long and has_long(lowered):
        lowered = take_apart(lowered, sizes=LONG)
    if target.nesting is not None:
        lowered = shelter_loops(lowered, target.nesting)
    ending = make_exits_explicit(lowered, options.loop_limit, loop_flags=target.loop_flags, by_value=target.vector)
    optimised = optimise(ending.module)
    result = remove_unused_inputs(optimised) if target.vector else remove_dead(remove_decided_selects(optimised))
    return PreparedModule(remove_unused_functions(result), ending.status, ending.loops, ending.flagged)


def without_rules(module: Module) -> Module:
    """Return the module without the users' rules of tangents, which derivatives alone call."""
    if all(f.tangent is None for f in module.functions):
        return module
    return remove_unused_functions(replace(module, functions=tuple(replace(f, tangent=None) for f in module.functions)))


def with_strict_functions(module: Module, precision: Precision, math: Math = "strict", *, fuse: bool = False) -> Module:
    """Return a module with the results of this mode in the interpreter; the same object if nothing has to change.

    Otherwise its precision is fixed already, and it computes in binary32 or binary64. With `fuse`, composite operations
    are contracted; the sums of the module itself are so already.
    """
    changing = TRANSCENDENTALS | FUSED if fuse else TRANSCENDENTALS
    lets = (s for f in module.functions for s in walk(f.body) if isinstance(s, Let))
    if not any(s.op in changing for s in lets):
        return module
    native, formulas, exact = frozenset(OPS) - TRANSCENDENTALS, formulas_of(math, doubles=True), frozenset(FUNCTIONS)
    plain = lower_half(set_precision(module, precision), formulas, exact)
    return lower(plain, native, formulas=formulas, exact=exact, fuse=fuse)


def optimise(module: Module, *, fixed: bool = True) -> Module:
    """Simplify a module. Without `fixed`, working precision and mode are unknown; see `fold`."""
    for _ in range(_ROUNDS):
        before = _control(module := promote(module))
        module = inline_independent(fold(module, fixed=fixed))
        if _control(module) == before:
            break
    return remove_dead(merge_common(module))


def _control(module: Module) -> int:
    """Count Ifs and Loops. A lower count than before may let `promote` turn more variables into values."""
    return sum(isinstance(s, (If, Loop)) for f in module.functions for s in walk(f.body))


def remove_decided_selects(module: Module) -> Module:
    """Remove selects whose condition an enclosing branch implies, where no element runs together with another.

    There `any_lane` of a condition is the condition itself. So inside a branch on `any_lane`, a select by the same
    condition takes its first value:

        %3 = any_lane %2                        ->   %3 = any_lane %2
        if %3 { $y = cond %2, %5, %4 }          ->   if %3 { $y = %5 }
    """
    return each_function(module, lambda f, functions: _SelectRemover(f, functions).run())


class _SelectRemover(Rewriter):
    """Rewrites one function; `holding` are the conditions that are true at the current statement."""

    def __init__(self, function: Function, functions: Functions) -> None:
        super().__init__(function, functions)
        self.holding: list[int] = []

    def let(self, let: Let) -> None:
        if let.op == "cond" and let.args[0] in self.holding:
            self.replace(let.value, let.args[1])
        else:
            self.emit(let)

    def branch(self, branch: If) -> None:
        let = self.lets.get(branch.condition)
        self.holding.append(let.args[0] if let is not None and let.op == "any_lane" else branch.condition)
        then = self.region(branch.then)
        self.holding.pop()
        self.emit(If(branch.condition, then, self.region(branch.orelse), branch.loc))
