"""Activity: the values and variables that change with the moving inputs of a function, and so need a tangent.

Stage: improve; for `forward` and `reverse`. A value moves if it is of floats and depends on an input that moves by
operations that are not flat. A variable that moves anywhere in a function moves everywhere in it. The activity of a
callee is computed once for each set of its inputs that move. For roundings, a value that is rounded moves, too.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace

from shpy.errors import RecordError
from shpy.ir.nodes import Call, Function, Let, Store, Value, Variable
from shpy.ir.ops import LANE_OPS, OPS
from shpy.ir.tangents import flat
from shpy.ir.traverse import variables_of, walk
from shpy.passes.derivatives.rounding import is_rounded

Moving = tuple[bool, ...]
"""For each input or output of a function, whether it moves: a value, or the contents of a variable."""


@dataclass(frozen=True, slots=True)
class Activity:
    """The ids of the values and variables of a function that move, and the inputs and outputs that do."""

    values: frozenset[int]
    variables: frozenset[int]
    inputs: Moving
    outputs: Moving


class Activities:
    """The activities of a module's functions; `functions` returns a function by name.

    Elements of `tables` move. With `rounding`, a value that is rounded moves. `rules` are the users' rules of tangents,
    by the functions that have one.
    """

    def __init__(
        self,
        functions: Callable[[str], Function],
        rules: Mapping[str, Function],
        tables: Collection[str] = (),
        *,
        rounding: bool = False,
    ) -> None:
        self.functions = functions
        self.rules = rules
        self.tables = tables
        self.rounding = rounding
        self._kept: dict[tuple[str, Moving], Activity] = {}

    def of(self, name: str, moving: Iterable[bool]) -> Activity:
        """Return the activity of a function by name."""
        key = name, tuple(moving)
        if key not in self._kept:
            function = self.functions(name)
            activity = self.in_function(function, key[1])
            self._kept[key] = self._by_rule(function, activity) if name in self.rules else activity
        return self._kept[key]

    def in_function(self, function: Function, moving: Moving) -> Activity:
        """Return the activity of a function whose inputs move as `moving` says."""
        values: set[int] = set()
        variables: set[int] = set()
        for port, moves in zip(function.inputs, moving, strict=True):
            if moves:
                (values if isinstance(port, Value) else variables).add(port.id)
        count = -1
        while count != len(variables):  # a loop may store what its next iteration loads
            count = len(variables)
            for s in walk(function.body):
                if isinstance(s, Let) and self._moves(s, values, variables):
                    values.add(s.value.id)
                elif isinstance(s, Store) and s.value in values:
                    variables.add(s.variable)
                elif isinstance(s, Call):
                    self._call(s, values, variables)
        variables &= {v.id for v in variables_of(function) if v.type.is_float}
        inputs = tuple(p.id in (values if isinstance(p, Value) else variables) for p in function.inputs)
        outputs = tuple(v.id in variables for v in function.outputs)
        return Activity(frozenset(values), frozenset(variables), inputs, outputs)

    def _by_rule(self, function: Function, activity: Activity) -> Activity:
        """Return the activity of a function with a rule; RecordError where it moves by more than its arguments."""
        rule = self.rules[function.name]
        floats = sum(port.type.is_float for port in function.inputs)
        own = len(rule.inputs) == len(function.outputs) + len(function.inputs) + floats
        if not own or any(any(self.in_function(f, (False,) * len(f.inputs)).outputs) for f in (function, rule)):
            raise RecordError(
                "this subroutine has a rule of its tangent by its arguments, and one of the two reads a Param or a "
                "Table that the derivative is taken by",
                loc=function.loc,
                cure="an argument of the subroutine for it",
            )
        return replace(activity, outputs=(any(activity.inputs),) * len(function.outputs))

    def arguments(self, call: Call, values: Collection[int], variables: Collection[int]) -> Moving:
        """Return which arguments of a call move."""
        ports = self.functions(call.function).inputs
        return tuple(
            a in (values if isinstance(port, Value) else variables) for a, port in zip(call.args, ports, strict=True)
        )

    def _moves(self, let: Let, values: set[int], variables: set[int]) -> bool:
        if not let.value.type.is_float or let.op in LANE_OPS:
            return False
        if let.op == "load":
            return let.attr in variables
        if let.op == "table":
            return let.attr in self.tables
        if let.op == "call":
            return self.of(str(let.attr), (a in values for a in let.args)).outputs[0]
        if self.rounding and is_rounded(let):
            return True
        row = OPS.get(let.op)
        return (row is None or row.tangent is not flat) and any(a in values for a in let.args)

    def _call(self, call: Call, values: set[int], variables: set[int]) -> None:
        activity = self.of(call.function, self.arguments(call, values, variables))
        ports = self.functions(call.function).inputs
        for arg, port, moves in zip(call.args, ports, activity.inputs, strict=True):
            if moves and isinstance(port, Variable):
                variables.add(arg)
        values.update(r.id for r, moves in zip(call.results, activity.outputs, strict=True) if moves)
