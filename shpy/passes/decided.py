"""Remove selects whose condition an enclosing branch implies, for a target that runs each element by itself.

Stage: improve, last. On such a target `any_lane` of a condition is the condition itself. So inside a branch on
`any_lane`, a select by the same condition takes its first value:

    %3 = any_lane %2                        ->   %3 = any_lane %2
    if %3 { $y = cond %2, %5, %4 }          ->   if %3 { $y = %5 }
"""

from __future__ import annotations

from shpy.ir.nodes import Function, If, Let, Module
from shpy.passes.rewriter import Functions, Rewriter, each_function


def remove_decided_selects(module: Module) -> Module:
    """Return the module for a target on which no element runs together with another."""
    return each_function(module, lambda f, functions: _Decided(f, functions).run())


class _Decided(Rewriter):
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
