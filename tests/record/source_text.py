"""Functions made from text for the tests of mistakes, and what recording says of them."""

from __future__ import annotations

import functools
import itertools
import linecache
import math
import textwrap
import types
from typing import Any

import numpy as np
import pytest

import shpy as sh
from shpy.errors import RecordError
from shpy.lang.programs import control

BLOCKS = {k: v for k, v in vars(control).items() if k.startswith("SH_")}
_count = itertools.count()


def made(text: str, **names: Any) -> Any:
    """The last function that the text defines; the text can be read back as a file's can."""
    file = f"<program {next(_count)}>"
    text = textwrap.dedent(text).lstrip("\n")
    linecache.cache[file] = (len(text), None, text.splitlines(keepends=True), file)
    namespace: dict[str, Any] = {
        "sh": sh,
        "np": np,
        "math": math,
        "functools": functools,
        "types": types,
        **BLOCKS,
        **names,
    }
    namespace["__name__"] = "user"
    exec(compile(text, file, "exec", dont_inherit=True), namespace)
    return [v for v in namespace.values() if isinstance(v, types.FunctionType) and v.__code__.co_filename == file][-1]


def check(text: str, **names: Any) -> None:
    """Record the last function; an input without a type is an Attrib1f."""
    record(made(text, **names))


def record(function: Any) -> sh.Program:
    for name in function.__code__.co_varnames[: function.__code__.co_argcount]:
        function.__annotations__.setdefault(name, sh.Attrib1f)
    return sh.program(function)


def blame(text: str, **names: Any) -> str:
    """Return the error's text without the file's name."""
    with pytest.raises(RecordError) as caught:
        check(text, **names)
    assert caught.value.loc is not None
    return str(caught.value).removeprefix(f"{caught.value.loc.file}:")
