"""Defaults of inputs that a call may leave out.

Stage: record. A default is one value of the input's type: numbers, a constant of the language, or a Param, whose value
at the time of the run counts. The default of a table or texture is an `sh.Table` or `sh.Texture2D`.

    @sh.program
    def scale(x: sh.Attrib1f, by: sh.Attrib1f = 2.0) -> sh.Attrib1f: ...
"""

from __future__ import annotations

from typing import Any

from shpy.errors import RecordError, ShpyTypeError
from shpy.lang.data.hostdata import as_base
from shpy.lang.data.tables import Table, TableType
from shpy.lang.data.textures import Texture2D, TextureType
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Layout, flatten, leaves


def check_default(type_: Layout | TableType | TextureType, default: Any, name: str) -> Any:
    """Return the default; ShpyTypeError where it is not one value of the input's type."""
    if isinstance(type_, TableType | TextureType):
        host_type, cure = (
            (Table, "sh.Table(array, type)") if isinstance(type_, TableType) else (Texture2D, "sh.Texture2D(array)")
        )
        if not isinstance(default, host_type):
            raise ShpyTypeError(f"the default of {name} is a {type(default).__name__}", loc=here(), cure=cure)
        return default
    what = f"the default of {name}"
    if default is None:
        raise ShpyTypeError(
            f"{what} is None, and {name} is annotated as an input, which is a value in every run",
            loc=here(),
            cure=f"a number as the default; {name}=None without an annotation is known while recording",
        )
    try:
        entries = flatten(type_, default, what)
        for entry, (leaf, _, cls) in zip(entries, leaves(type_, what), strict=True):
            shape = as_base(entry, cls.base, leaf).shape
            if shape != ((cls.size,) if cls.size > 1 else ()):
                raise ShpyTypeError(
                    f"{leaf} is one {cls.__name__}, and has the shape {shape}",
                    loc=here(),
                    cure=f"{cls.size} numbers" if cls.size > 1 else "one number",
                )
    except RecordError as error:
        raise ShpyTypeError(
            f"{what} is a value of a program that is recorded", loc=here(), cure="a number, or a sh.Param"
        ) from error
    return default
