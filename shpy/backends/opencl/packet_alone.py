"""The loop over the lanes of a packet that each run a function alone.

Stage: emit. What varies is stored to arrays, one number a lane; the function of one element is called for each active
lane; its results are loaded again. Lanes that are not active give 0.

    lines = each_lane("find_alone", "active", [("x", "float")], [("l", "float")], ["table"], 16)
"""

from __future__ import annotations

from collections.abc import Sequence

from shpy.backends.opencl.packet_halves import LONGEST

__all__ = ["each_lane", "packet_of"]

BOOL = "bool"
"""The scalar type whose packets are masks: ints, -1 for true."""

Typed = tuple[str, str]
"""The name of an argument or result, and its scalar type."""


def packet_of(scalar: str, lanes: int) -> str:
    """The type of a packet of numbers."""
    return f"{_held(scalar)}{lanes}"


def each_lane(
    one: str, active: str, inputs: Sequence[Typed], outputs: Sequence[Typed], context: Sequence[str], lanes: int
) -> list[str]:
    """The statements of a function that runs `one` for each lane of the mask `active`, which is one of its arguments.

    A single result is returned; several are stored through pointers of their names.
    """
    lines = []
    for name, scalar in (*inputs, (active, BOOL)):
        lines += [f"{_held(scalar)} {name}_of[{lanes}];", f"vstore{lanes}({name}, 0, {name}_of);"]
    lines += [f"{_held(scalar)} {name}_of[{lanes}] = {{0}};" for name, scalar in outputs]
    lines += [f"for (int k = 0; k < {lanes}; k += 1) {{", f"    if ({active}_of[k]) {{"]
    lines += [f"        {line}" for line in _one_lane(one, inputs, outputs, context)]
    lines += ["    }", "}"]
    for name, scalar in outputs:
        loaded = _loaded(f"{name}_of", packet_of(scalar, lanes), lanes)
        lines.append(f"return {loaded};" if len(outputs) == 1 else f"*{name} = {loaded};")
    return lines


def _one_lane(one: str, inputs: Sequence[Typed], outputs: Sequence[Typed], context: Sequence[str]) -> list[str]:
    """The call for lane `k`."""
    given = [f"{name}_of[k]" + (" != 0" if scalar == BOOL else "") for name, scalar in inputs]
    declared = [f"{scalar} {name}_one;" for name, scalar in outputs]
    results = [f"{name}_one" for name, _ in outputs]
    if len(outputs) == 1:
        called = [f"{results[0]} = {one}({', '.join([*given, *context])});"]
    else:
        called = [f"{one}({', '.join([*given, *(f'&{r}' for r in results), *context])});"]
    kept = [f"{name}_of[k] = {'-(int)' if scalar == BOOL else ''}{name}_one;" for name, scalar in outputs]
    return [*declared, *called, *kept]


def _held(scalar: str) -> str:
    return "int" if scalar == BOOL else scalar


def _loaded(array: str, packet: str, lanes: int) -> str:
    if lanes <= LONGEST:
        return f"vload{lanes}(0, {array})"
    return f"({packet})({', '.join(f'vload{LONGEST}({k}, {array})' for k in range(lanes // LONGEST))})"
