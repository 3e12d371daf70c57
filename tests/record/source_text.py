"""Functions made from text for the tests of the source check, and what the check says of them."""

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
from shpy.lang.mistakes.check import check_source
from shpy.lang.programs import control
from shpy.lang.programs.record import is_value

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
    check_source(made(text, **names), is_value=is_value)


def blame(text: str, **names: Any) -> str:
    """Return the error's text without the file's name."""
    with pytest.raises(RecordError) as caught:
        check(text, **names)
    assert caught.value.loc is not None
    return str(caught.value).removeprefix(f"{caught.value.loc.file}:")
