"""Forward mode: a function that also gives the tangents of its outputs, in one direction or several.

Stage: improve. Beside each value that moves stands its tangent in each direction, and beside each variable that moves
another one for the tangent. Control flow stays as it is, so the tangent is that of the path that ran:

    function f(%x) -> ($y)             |    function f_forward(%x, %d_x) -> ($y, $d_y)
      %1 = sin %x                      |      %1 = sin %x
      store $y = %1            ->      |      %2 = cos %x
                                       |      %3 = mul %d_x, %2
                                       |      store $y = %1
                                       |      store $d_y = %3

The tangents of inputs and outputs that move follow all inputs and outputs. An input may have a `Seed` in place of
tangents: constants, of which the zeros vanish; and the tangents of variables around that function stay inside. The
rules are those of the op table. A call becomes a call of the callee's own forward function, one for each set of
arguments that move.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from shpy.ir.nodes import Call, Function, If, Let, Loop, Region, Stmt, Store, Value, Variable
from shpy.ir.ops import OPS
from shpy.ir.traverse import is_straight
from shpy.ir.types import Type
from shpy.passes.derivatives.activity import Activities, Activity, Moving
from shpy.passes.derivatives.linear import Live, Tangent, TangentBuilder, Zero, dense, joined, tangent_of
from shpy.passes.derivatives.own_rules import forward_by_rule

Seed = Sequence[int | None]
"""For each direction, the component of an input that has the tangent 1 in it; None for an input that stays."""


@dataclass
class ForwardFunctions:
    """The forward functions of a module.

    `labels` name the directions: the tangent of `q` is `q_dx` for the label `dx`, and `d_q` for an empty one.
    `functions` returns a function by name; `fresh` makes names of functions. `callees` are those that the results
    call, innermost first. `rules` are the users' rules of tangents, by the functions that have one.
    """

    labels: Sequence[str]
    functions: Callable[[str], Function]
    fresh: Callable[[str], str]
    rules: Mapping[str, Function]

    def __post_init__(self) -> None:
        self.activities = Activities(self.functions, self.rules)
        self._kept: dict[tuple[str, Moving], Function] = {}

    @property
    def callees(self) -> list[Function]:
        """The forward functions of callees."""
        return list(self._kept.values())

    def of(self, name: str, moving: Moving) -> Function:
        """Return the forward function of a function by name whose inputs `moving` move."""
        key = name, moving
        if key not in self._kept:
            function, activity = self.functions(name), self.activities.of(name, moving)
            if name in self.rules:
                forward = forward_by_rule(function, self.rules[name], moving, self.names)
            else:
                forward = _ForwardRewriter(function, activity, self, None).run()
            self._kept[key] = replace(forward, name=self.fresh(f"{name}_forward"))
        return self._kept[key]

    def names(self, name: str | None) -> list[str | None]:
        """Return the names of the tangents of a value or variable."""
        if name is None:
            return [None] * len(self.labels)
        return [f"{name}_{label}" if label else f"d_{name}" for label in self.labels]

    def seeded(self, function: Function, moving: Moving, seeds: Mapping[int, Seed]) -> Function:
        """Return the forward function whose inputs `moving` move: by the `seeds` of their ids, or by new inputs."""
        return _ForwardRewriter(function, self.activities.in_function(function, moving), self, seeds).run()


class _ForwardRewriter:
    """Rewrites one function."""

    def __init__(
        self, function: Function, activity: Activity, world: ForwardFunctions, seeds: Mapping[int, Seed] | None
    ) -> None:
        self.function = function
        self.activity = activity
        self.world = world
        self.seeds = seeds or {}
        self.called = seeds is None
        self.b = TangentBuilder(function)
        self.tangents: dict[int, tuple[Tangent, ...]] = {}
        self.shadows: dict[int, tuple[Variable, ...]] = {}

    def run(self) -> Function:
        """Return the forward function."""
        b, f = self.b, self.function
        for port in f.inputs:
            if isinstance(port, Variable):
                if port.id in self.activity.variables and self.called:
                    self._shadow(port, lambda v, name: b.reference(v.type, name, v.length))
                elif port.id in self.activity.variables:
                    self._shadow(port, lambda v, name: b.variable(v.type, v.length, name))
            elif port.id in self.seeds:
                self.tangents[port.id] = tuple(self._seed(port.type, picked) for picked in self.seeds[port.id])
            elif port.id in self.activity.values:
                self.tangents[port.id] = tuple(Live(b, b.input(port.type, n)) for n in self.world.names(port.name))
        for v in f.outputs:
            if v.id in self.activity.variables:
                self._shadow(v, lambda v, name: b.output(v.type, name))
        for v in f.variables:
            if v.id in self.activity.variables:
                self._shadow(v, lambda v, name: b.variable(v.type, v.length, name))
        b.extend(self._region(f.body))
        forward = b.finish()
        pure = is_straight(forward.body) and len(forward.outputs) == 1 and f.pure
        return replace(forward, pure=pure)

    def _shadow(self, variable: Variable, make: Callable[[Variable, str | None], Variable]) -> None:
        self.b.loc = variable.loc
        self.shadows[variable.id] = tuple(make(variable, name) for name in self.world.names(variable.name))

    def _seed(self, type: Type, picked: int | None) -> Tangent:
        """Return the tangent that is 1 in one component."""
        b = self.b
        if picked is None:
            return Zero(b, type)
        one = Live(b, b.const(type.scalar, [1]))
        b.ones.add(one.value.id)
        return joined([one if k == picked else Zero(b, type.scalar) for k in range(type.size)])

    def _of(self, value: int) -> tuple[Tangent, ...]:
        """Return the tangents of a value."""
        return self.tangents.get(value) or (Zero(self.b, self.b.type_of(value)),) * len(self.world.labels)

    # Statements

    def _region(self, region: Region) -> Region:
        self.b.push()
        for s in region:
            self._statement(s)
        return self.b.pop()

    def _statement(self, s: Stmt) -> None:
        """Append a statement, and the tangents that belong to it."""
        b = self.b
        b.loc = s.value.loc if isinstance(s, Let) else s.loc
        match s:
            case Let():
                self._let(s)
            case Store(variable, value, components, index):
                b.append(s)
                for shadow, tangent in zip(self.shadows.get(variable, ()), self._of(value), strict=False):
                    b.store(shadow, dense(tangent).value, components, index)
            case Call():
                self._call(s)
            case If(condition, then, orelse, loc):
                b.append(If(condition, self._region(then), self._region(orelse), loc))
            case Loop(body, continuing, until, turns, loc):
                b.append(Loop(self._region(body), self._region(continuing), until, turns, loc))
            case _:
                b.append(s)

    def _let(self, let: Let) -> None:
        value = let.value
        if value.id not in self.activity.values:
            self.b.append(let)
            return
        if let.op == "call":
            callee = self.world.of(str(let.attr), tuple(a in self.activity.values for a in let.args))
            tangents: list[Tangent] = [Live(self.b, r) for r in self._called(callee, let.args, (value,))]
        else:
            self.b.append(let)
            tangents = [self._tangent(let, k) for k in range(len(self.world.labels))]
        self.tangents[value.id] = tuple(tangents)
        for name, t in zip(self.world.names(value.name), tangents, strict=True):
            if name is not None and isinstance(t, Live):
                self.b.names.setdefault(t.value.id, name)

    def _tangent(self, let: Let, direction: int) -> Tangent:
        """Return the tangent of an operation in one direction."""
        b, type = self.b, let.value.type
        args = [self._of(a)[direction] for a in let.args]
        if let.op in OPS:
            return tangent_of(let.op, b.live(let.value.id), [b.live(a) for a in let.args], args)
        match let.op:
            case "load":
                assert isinstance(let.attr, int)
                index = let.args[0] if let.args else None
                return Live(b, b.load(self.shadows[let.attr][direction], index))
            case "construct":
                return joined([a[i] for a in args for i in range(a.size)])
            case "splat":
                return args[0].wide(type.size)
            case "swizzle":
                assert isinstance(let.attr, tuple)
                return args[0][let.attr[0] if type.size == 1 else list(let.attr)]
            case "component":
                return Live(b, b.let("component", dense(args[0]).value, let.args[1], type=type))
            case "convert":
                tangent: Tangent = args[0].based(type.base)  # type: ignore[assignment]
                return tangent
        raise AssertionError(f"no tangent of {let.op}")

    # Calls

    def _call(self, call: Call) -> None:
        moving = self.world.activities.arguments(call, self.activity.values, self.activity.variables)
        activity = self.world.activities.of(call.function, moving)
        if not any(activity.outputs) and not any(activity.inputs):
            self.b.append(call)
            return
        rest = iter(self._called(self.world.of(call.function, moving), call.args, call.results))
        for result, moves in zip(call.results, activity.outputs, strict=True):
            if moves:
                self.tangents[result.id] = tuple(Live(self.b, next(rest)) for _ in self.world.labels)

    def _called(self, callee: Function, args: tuple[int, ...], results: tuple[Value, ...]) -> list[Value]:
        """Append the call of a forward function; return the tangents of its results."""
        b = self.b
        more: list[int] = []
        for port, arg in zip(callee.inputs, args, strict=False):
            if isinstance(port, Variable):
                more += [v.id for v in self.shadows.get(arg, ())]
            elif arg in self.activity.values:
                more += [dense(t).value.id for t in self._of(arg)]
        tangents = [b.value(v.type, v.name) for v in callee.outputs[len(results) :]]
        b.append(Call(callee.name, (*args, *more), (*results, *tangents), b.loc))
        return tangents
