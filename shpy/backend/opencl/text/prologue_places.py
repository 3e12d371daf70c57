"""The prologue of a scatter that combines: a program of two elements as a kernel that folds the values of each place.

Stage: emit. One work item takes the values in order, which is the order of the definition (`collectives.scattering`).

    print_places(prepared.module).text
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from importlib import resources
from typing import Final

from shpy.backend.opencl.text.kernel import KernelMaker, KernelText
from shpy.backend.opencl.text.operations import hides_zeros
from shpy.backend.opencl.text.prologue import spelled
from shpy.backend.opencl.text.spell_cl import ClSpeller, element_type
from shpy.ir.nodes import Module
from shpy.ir.types import Base, Type
from shpy.passes.hide import hide_derivable

PLACES: Final = "sh_places"
# In this file VALUES and RESULTS are the parameters of streams, COMBINE and STORE statements.
_TEXT: Final = (resources.files(__package__) / "places.cl").read_text()


def print_places(module: Module, *, faults: Collection[str] = ()) -> KernelText | None:
    """Return the kernel of a prepared program of two elements; None with tables, params, bools or binary16.

    Its arguments are the number of values and of places (ulong), the indices, a byte for each place, and the leaves of
    the values and of the results.
    """
    types = [o.type for o in module.entry.outputs]
    if module.tables or module.params or any(t.base in (Base.B, Base.H) for t in types):
        return None
    whole = hide_derivable(module) if hides_zeros("strict", faults) else module
    return KernelMaker(whole, "strict", faults=faults).kernels_around(lambda inner: _kernel(inner, types))


def _kernel(inner: str, types: Sequence[Type]) -> str:
    """Return the kernel that calls the program `inner`."""
    speller = ClSpeller()
    pointers = [f"__global {{}}{speller.type_name(element_type(t))} *{{}}{k}" for k, t in enumerate(types)]
    before, given = (
        [_element(f"{name}{k}", at, t) for k, t in enumerate(types)] for name, at in (("result", "at"), ("value", "i"))
    )
    call = f"{inner}({', '.join([*before, *given])}"
    if len(types) == 1:
        combine = [_stored("result0", f"{call})", types[0])]
    else:
        targets = "".join(f", &sum{k}" for k in range(len(types)))
        combine = [f"{spelled(t)} sum{k};" for k, t in enumerate(types)]
        combine += [f"{call}{targets});", *(_stored(f"result{k}", f"sum{k}", t) for k, t in enumerate(types))]
    words = {
        "VALUES": ", ".join(p.format("const ", "value") for p in pointers),
        "RESULTS": ", ".join(p.format("", "result") for p in pointers),
        "COMBINE": "\n            ".join(combine),
        "STORE": "\n            ".join(_stored(f"result{k}", given[k], t) for k, t in enumerate(types)),
    }
    return re.sub(r"\b[A-Z]{5,}\b", lambda word: words[word[0]], _TEXT)


def _element(array: str, at: str, type: Type) -> str:
    return f"vload3({at}, {array})" if type.size == 3 else f"{array}[{at}]"


def _stored(array: str, value: str, type: Type) -> str:
    return f"vstore3({value}, at, {array});" if type.size == 3 else f"{array}[at] = {value};"
