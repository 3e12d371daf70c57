"""Variants of a program, which must give what it gives.

Stage: test. Takes a program, gives others: with dead code, with statements in a loop of one iteration or under a
condition that always holds, with vectors split and scalars merged.

    for variant in variants(program, 10):
        assert np.array_equal(variant(x), program(x))
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import replace

from property.metamorphic.changes import CHANGES
from property.metamorphic.surgery import Surgeon

from shpy.ir.nodes import Module
from shpy.ir.verifier import verify
from shpy.programs import Program


class Variant(Program):
    """A program that was changed: `changes` names how."""

    changes: tuple[str, ...]


def variants(program: Program, count: int, seed: int = 0, steps: int = 4) -> Iterator[Variant]:
    """Yield `count` variants of a program, each with up to `steps` changes; the same seed gives the same variants.

    The changes keep every operation, so the results have the same bits wherever an operation on a vector has the bits
    of the operation on each component.
    """
    for n in range(count):
        rng = random.Random(f"{seed}.{n}")
        module, changes = program.ir, []
        for _ in range(rng.randint(1, steps)):
            name = rng.choice(list(CHANGES))
            changed = _changed(module, name, rng)
            if changed is not None:
                module = changed
                changes.append(name)
        verify(module)
        made = Variant(replace(program.recorded, module=module))
        made.changes = tuple(changes)
        yield made


def _changed(module: Module, name: str, rng: random.Random) -> Module | None:
    """Return the module with one function changed, as often as not the entry; None where there is no place for it."""
    places = [n for n, f in enumerate(module.functions) if not f.pure]
    at = places[-1] if rng.random() < 0.5 else rng.choice(places)
    function = CHANGES[name](Surgeon(module.functions[at], {f.name: f for f in module.functions}, rng))
    if function is None:
        return None
    return replace(module, functions=(*module.functions[:at], function, *module.functions[at + 1 :]))
