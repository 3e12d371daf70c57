"""Eliminate common subexpressions: compute equal values only once.

Stage: improve. A value equal to an earlier one in the same or an enclosing region is replaced by it:

    %2 = mul %0, %1              %2 = mul %0, %1
    if %c {                ->    if %c {
      %3 = mul %1, %0
      store $y = %3                store $y = %2
    }                            }

Loads are left to `promote`. `any_lane` and `all_lanes` stay, since they depend on the active lanes at their place. A
value computed inside a region is not visible outside it, and no statement moves.
"""

from __future__ import annotations

from shpy.ir.nodes import Function, Let, Module, Region
from shpy.ir.ops import COMMUTATIVE, LANE_OPS
from shpy.passes.rewriter import Functions, Rewriter, each_function

_Key = tuple[object, ...]


def merge_common(module: Module) -> Module:
    """Return the module without values that equal an earlier, visible one."""
    return each_function(module, lambda f, functions: _Merge(f, functions).run())


class _Merge(Rewriter):
    def __init__(self, function: Function, functions: Functions) -> None:
        super().__init__(function, functions)
        self._seen: dict[_Key, int] = {}
        self._scopes: list[list[_Key]] = []

    def region(self, region: Region) -> Region:
        """Return the rewritten region; values computed in it are no longer visible after it."""
        self._scopes.append([])
        result = super().region(region)
        for key in self._scopes.pop():
            del self._seen[key]
        return result

    def let(self, let: Let) -> None:
        if let.op == "load" or let.op in LANE_OPS:
            self.emit(let)
            return
        args = tuple(sorted(let.args)) if let.op in COMMUTATIVE else let.args
        key = (let.op, args, let.attr, let.value.type)
        earlier = self._seen.get(key)
        if earlier is not None:
            self.replace(let.value, earlier)
            return
        self._seen[key] = let.value.id
        self._scopes[-1].append(key)
        self.emit(let)
