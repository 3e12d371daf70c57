"""Leave out what only elements that run together need, for a target that runs each element by itself.

Stage: improve, last. What holds for any element that runs together holds for this one, so a value that is chosen by
the same condition inside the branch is known:

    %3 = any_lane %2                        ->   %3 = any_lane %2
    if %3 { $y = cond %2, %5, %4 }          ->   if %3 { $y = %5 }
"""

from __future__ import annotations

from shpy.ir.nodes import Function, If, Let, Module
from shpy.passes.rewriter import Functions, Rewriter, each_function


def run_alone(module: Module) -> Module:
    """Return the module for a target on which no element runs together with another."""
    return each_function(module, lambda f, functions: _Alone(f, functions).run())


class _Alone(Rewriter):
    """`holding` are the conditions of the branches around a statement."""

    def __init__(self, function: Function, functions: Functions) -> None:
        super().__init__(function, functions)
        self.holding: list[int] = []

    def let(self, let: Let) -> None:
        if let.op == "cond" and let.args[0] in self.holding:
            self.replace(let.value, let.args[1])
        else:
            self.emit(let)

    def branch(self, branch: If) -> None:
        made = self.made.get(branch.condition)
        self.holding.append(made.args[0] if made is not None and made.op == "any_lane" else branch.condition)
        then = self.region(branch.then)
        self.holding.pop()
        self.emit(If(branch.condition, then, self.region(branch.orelse), branch.loc))
