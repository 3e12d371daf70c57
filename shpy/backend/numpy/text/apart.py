"""Decides whether a module computes with the components of its vectors, each an array of its own.

Stage: improve. Part of the numpy backend. A vector is an array (size, lanes): one call of numpy does all components,
but to put one together is a copy, and what depends on the column alone is still computed for every row. Taken apart,

- a kernel that knows its place in a grid runs on blocks (rows, columns), where numpy broadcasts a row (1, columns) and
  a column (rows, 1) only when they meet;
- a loop that makes vectors from numbers does not copy them;
- several iterations of a loop can be the rows of one array (module `iterations`).

    z = vector(z[0] * z[0] - z[1] * z[1], 2.0 * z[0] * z[1]) + c      ->      t = z_x * z_x - z_y * z_y + c[0]
                                                                              z_y = 2.0 * z_x * z_y + c[1]
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from shpy.backend.numpy.text.iterations import counted, lanes_alone, with_counters
from shpy.ir.nodes import Let, Loop, Module, Region, Variable
from shpy.ir.ops import OPS
from shpy.ir.traverse import regions_of, walk
from shpy.passes.components import GEOMETRY, take_apart
from shpy.passes.dead import remove_unused_inputs
from shpy.passes.lower import lower
from shpy.passes.pipeline import optimise
from shpy.passes.vectorize import VectorModule, vectorize

_WORTH_MAKING = 4
"""Operations on whole vectors for each that is made of numbers, from which on it is better to make them."""
_FREE = frozenset({"const", "load", "swizzle", "param", "grid_index", "grid_shape", "table_size"})


@dataclass(frozen=True, slots=True)
class ApartLayout:
    """A vectorised module, whether its vectors are taken apart, and whether its lanes may be a block of a grid."""

    vector: VectorModule
    apart: bool
    grid: bool


def lay_out(module: Module) -> ApartLayout:
    """Return the prepared module, vectorised as it is or taken apart, whichever is quicker."""
    whole = cache(lambda: vectorize(module))  # most kernels that are split into components do not need it
    placed = _knows_its_place(module) and not _holds(module, lambda slot: slot.length is not None)

    def grid(vector: VectorModule) -> bool:
        return placed and not any(facts.live for facts in vector.facts.values())

    constructs, used = _vectors([f.body for f in module.functions])
    if not constructs + used:
        return ApartLayout(
            whole(), apart=False, grid=grid(whole()) and not _holds(module, lambda slot: slot.type.size > 1)
        )
    in_loops, used_in_loops = _vectors(_iterated(module))
    pays = used_in_loops < _WORTH_MAKING * in_loops
    pays = pays or (placed and (constructs > 0 or _only_places(module)) and grid(whole()))
    if not pays and not any(with_counters(f) for f in whole().module.functions if not f.pure):
        return ApartLayout(whole(), apart=False, grid=False)
    split = take_apart(lower(module, frozenset(OPS) - GEOMETRY), throughout=True)
    scalars = vectorize(remove_unused_inputs(optimise(split)))
    alone = lanes_alone(scalars.module.functions)
    if pays or any(counted(f, scalars.facts[f.name], alone) for f in scalars.module.functions if not f.pure):
        return ApartLayout(scalars, apart=True, grid=grid(scalars))
    return ApartLayout(whole(), apart=False, grid=False)


def _knows_its_place(module: Module) -> bool:
    return any(isinstance(s, Let) and s.op == "grid_index" for f in module.functions for s in walk(f.body))


def _only_places(module: Module) -> bool:
    """Return whether all vectors hold ints, as places in a grid do."""
    lets = (s for f in module.functions for s in walk(f.body) if isinstance(s, Let))
    return all(s.value.type.size == 1 or s.value.type.is_int for s in lets) and not _holds(
        module, lambda slot: slot.type.size > 1 and not slot.type.is_int
    )


def _holds(module: Module, kind: Callable[[Variable], bool]) -> bool:
    """Return whether `kind` holds for a variable or an output of a function."""
    return any(kind(slot) for f in module.functions for slot in (*f.variables, *f.outputs))


def _iterated(module: Module) -> list[Region]:
    """Return the regions that run once in each iteration of some loop."""
    return [r for f in module.functions for s in walk(f.body) if isinstance(s, Loop) for r in regions_of(s)]


def _vectors(regions: list[Region]) -> tuple[int, int]:
    """Return the number of vectors made of numbers there, and the number of other operations on vectors."""
    flags = [s.op == "construct" for r in regions for s in walk(r) if isinstance(s, Let) and _on_vectors(s)]
    return flags.count(True), flags.count(False)


def _on_vectors(s: Let) -> bool:
    return s.value.type.size > 1 and s.op not in _FREE
