"""The types of the language: one class for each kind, size and base.

Stage: record. `Attrib` is data of any meaning. The other kinds mean something: they differ from it where a matrix or a
difference of points is concerned, mix freely elsewhere, and hold floats. GLSL's vector names are aliases.

    Attrib1i   one int            Point3f   a position: three floats            vec3 is Attrib3f

Vectors of eight are for the arithmetic of programs alone: no input, output, Param, Table or stream has them.
"""

from typing import TYPE_CHECKING, Any

from shpy.ir.types import FLOATS, WIDEST_PORT, Base, vec
from shpy.lang.values.value import CLASSES, Value

MEANINGS = {
    "Attrib": "",
    "Point": "A position",
    "Vector": "A direction with a length",
    "Normal": "A surface normal",
    "Color": "A colour",
    "TexCoord": "Texture coordinates",
}
_COUNTS = {1: "One", 2: "Two", 3: "Three", 4: "Four", 8: "Eight"}
_SPOKEN = {
    Base.F: "float",
    Base.D: "binary64",
    Base.H: "binary16",
    Base.I: "int",
    Base.U: "unsigned int",
    Base.B: "bool",
}
_ALIASES = {"vec": "Attrib{}f", "ivec": "Attrib{}i", "uvec": "Attrib{}u", "bvec": "Attrib{}b"}


def _make_class(kind: str, size: int, base: Base) -> type[Value]:
    """Make the class of a kind, size and base."""
    plural = "s" if size > 1 and base not in (Base.D, Base.H) else ""
    number = f"{_COUNTS[size]} {_SPOKEN[base]}{plural}"
    doc = f"{MEANINGS[kind]}: {number.lower()}." if MEANINGS[kind] else f"{number}."
    facts = {"kind": kind, "size": size, "base": base, "type": vec(base, size)}
    return type(f"{kind}{size}{base.value}", (Value,), {"__slots__": (), "__doc__": doc, **facts})


CLASSES.update(
    ((kind, size, base), _make_class(kind, size, base))
    for kind in MEANINGS
    for size in _COUNTS
    for base in Base
    if kind == "Attrib" or (base in FLOATS and size <= WIDEST_PORT)
)
TYPES = {cls.__name__: cls for cls in CLASSES.values()}
TYPES |= {f"{alias}{n}": TYPES[name.format(n)] for alias, name in _ALIASES.items() for n in (2, 3, 4)}
"""The public names and their classes."""
globals().update(TYPES)

if TYPE_CHECKING:  # shpy/__init__.pyi has the signatures

    def __getattr__(name: str) -> Any: ...
