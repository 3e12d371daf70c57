"""Find the condition under which a program discards an element at its start.

Stage: analyse. A backend first evaluates the condition for every element, and runs the program only for the others.

    %c = gt %x, 1                  |   %c = gt %x, 1
    if %c { discard }              |   store rejected = %c
    ... much more ...              |
"""

from __future__ import annotations

from dataclasses import replace

from shpy.ir.nodes import Discard, If, Let, Module, Port, Stmt, Store, Variable
from shpy.ir.traverse import walk
from shpy.ir.types import Base, vec

_SHARE = 4
"""The least ratio of the statements of the whole program to those of the condition."""


def find_rejection(module: Module) -> Module | None:
    """Return a program with the same inputs and one output: whether the element is discarded at the start.

    Returns None if there is no such discard, or if its condition needs a large part of the program's statements.
    """
    entry = module.entry
    before: list[Stmt] = []
    for statement in entry.body:
        match statement:
            case If(condition=condition, then=(Discard(),), orelse=()):
                break
            case Let() | Store():
                before.append(statement)
            case _:
                return None
    else:
        return None
    if _SHARE * len(before) > sum(1 for f in module.functions for _ in walk(f.body)):
        return None
    slots = (*entry.outputs, *entry.variables, *(port for port in entry.inputs if isinstance(port, Variable)))
    rejected = Variable(max((slot.id for slot in slots), default=-1) + 1, vec(Base.B), None, "rejected", entry.loc)
    shorter = replace(
        entry,
        outputs=(rejected,),
        variables=(*entry.variables, *entry.outputs),
        body=(*before, Store(rejected.id, condition, None, None, entry.loc)),
    )
    name, ports = f"{module.name}_rejected", (Port("rejected", "Attrib1b"),)
    return replace(module, name=name, outputs=ports, functions=(*module.functions[:-1], shorter))
