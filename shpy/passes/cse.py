"""Compute what is computed twice only once.

Stage: improve. A value that an enclosing region already has is used again:

    %2 = mul %0, %1              %2 = mul %0, %1
    if %c {                ->    if %c {
      %3 = mul %1, %0
      store $y = %3                store $y = %2
    }                            }

Loads are left to `promote`. `any_lane` and `all_lanes` depend on where they stand, and stay. A value computed inside
a region is not seen outside it; nothing moves.
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
        """Return the region; what it computes is forgotten after it."""
        self._scopes.append([])
        made = super().region(region)
        for key in self._scopes.pop():
            del self._seen[key]
        return made

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
