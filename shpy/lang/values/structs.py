"""The decorator `sh.struct`: which classes are structs, and the rules for their bases.

Stage: record. The methods of all structs are those of `Struct` (structure.py).

    @sh.struct
    class Ray:
        o: sh.Point3f
        d: sh.Vector3f
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Collection
from typing import Any

import numpy as np

from shpy.errors import ShpyTypeError
from shpy.lang.recording.location import here
from shpy.lang.values.structure import is_struct, is_value, layout_of, struct_class

_OWN = frozenset({"__new__", "__init__", "__setattr__", "__setitem__", "__reduce__", "copy"})
"""The methods by which a struct is constructed, stored and copied."""


def struct(cls: type) -> Any:
    """Make a struct of a class with annotated fields: usable as input, output and array element.

    A struct of a struct has the fields of its base first, as dataclasses do. Methods of other bases work on its fields.
    Raises ShpyTypeError where a field is annotated with anything but a type of the language or another struct, or has a
    default, and for a base that has fields, or a constructor, but is no struct.
    """
    frame = sys._getframe(1)
    namespace = {**frame.f_globals, **frame.f_locals}
    fields = {name: hint for base in reversed(cls.__mro__) for name, hint in vars(base).get("_shpy_fields", {}).items()}
    fields |= {
        name: _resolved(hint, namespace, f"{cls.__name__}.{name}") if isinstance(hint, str) else hint
        for name, hint in inspect.get_annotations(cls).items()
        if "ClassVar" not in str(hint)
    }
    if not fields:
        raise ShpyTypeError(f"{cls.__name__} has no fields", loc=here(), cure="o: sh.Point3f, for example")
    of_structs = {part for base in cls.__mro__[1:] if is_struct(base) for part in base.__mro__}
    for base in cls.__mro__[1:]:
        if base not in of_structs and base is not object:
            _check_mixin(base, cls, fields)
    structure = struct_class(cls, fields)
    layout_of(structure, cls.__name__)
    _check_defaults(cls, fields)
    return structure


def _resolved(hint: str, namespace: dict[str, Any], name: str) -> Any:
    """Return what a field's annotation that is a string means; ShpyTypeError if it means nothing."""
    try:
        return eval(hint, namespace)
    except Exception as error:
        cure = getattr(error, "cure", None) or "a type of the language, such as sh.Attrib1f, or another struct"
        text = getattr(error, "message", error)
        raise ShpyTypeError(
            f"{name} is annotated {hint!r}, which cannot be resolved: {text}", loc=here(), cure=cure
        ) from error


def _check_defaults(cls: type, fields: Collection[str]) -> None:
    """Check that no field has a value in the class, which nothing would read."""
    defaults = {n: value for n, value in vars(cls).items() if n in fields and n in inspect.get_annotations(cls)}
    if not defaults:
        return
    parameters = ["self", *(name for name in fields if name not in defaults)]
    for name, value in defaults.items():
        number = np.asarray(value).tolist() if is_value(value) and not is_struct(type(value)) else value
        parameters.append(f"{name}={number!r}")
    raise ShpyTypeError(
        f"{cls.__name__} is a struct, and its field {min(defaults)} has a default, which structs do not take",
        loc=here(),
        cure=f"def __init__({', '.join(parameters)}): super().__init__({', '.join(fields)})",
    )


def _check_mixin(base: type, cls: type, fields: Collection[str]) -> None:
    """Check a base of the class of a struct that is no struct: it may have methods, and declare fields of the class."""
    own = _OWN & vars(base).keys()
    if own:
        raise ShpyTypeError(
            f"{cls.__name__} is a struct, and its base {base.__name__} has {min(own)} of its own, which structs need",
            loc=here(),
            cure="no protocol among the bases: a class with its methods follows it"
            if getattr(base, "_is_protocol", False)
            else f"a base with other methods alone, or @sh.struct above class {base.__name__}",
        )
    for name, hint in inspect.get_annotations(base).items():
        if name not in fields and "ClassVar" not in str(hint):
            raise ShpyTypeError(
                f"{cls.__name__} is a struct, and its base {base.__name__} with the field {name} is not a struct",
                loc=here(),
                cure=f"@sh.struct above class {base.__name__}",
            )
