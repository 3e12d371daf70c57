"""Check the text of the user's function before it is run, for mistakes that running it could not show.

Stage: record, first of all. Takes the function that `sh.program` decorates, and raises `RecordError` with the line and
the cure if there is a mistake. Recording runs Python once: a name that a block rebinds keeps the block's value, whether
or not the block will run, and `y = x` gives one value two names. Both are visible only in the text.

    def wrong(x: sh.Attrib1f):
        with SH_IF(x > 1):
            x = x - 1           # RecordError: … write instead: x[:] = x - 1
        return x

Without a text that belongs to the code (a REPL, `exec`, a file edited since) this check is skipped: `bytecode` then
compares names while the function runs. Only certain mistakes are reported, nothing that is legitimate in some program;
the recorder finds the rest by scope.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from types import CodeType, FunctionType

from shpy.errors import RecordError, warn
from shpy.ir.nodes import Loc
from shpy.lang.mistakes.bytecode import called_by
from shpy.lang.mistakes.flow import Flow
from shpy.lang.recording.location import enter_text, loc_in
from shpy.lang.recording.scope import scope_of, unwrapped, uses_shpy
from shpy.lang.recording.text import has_changed
from shpy.lang.recording.tree import definition_of


def check_source(function: object, *, is_value: Callable[[object], bool]) -> None:
    """Raise `RecordError` for the first classic mistake in the function's text, or in that of one it calls.

    `function` may be a function, method, lambda, partial or callable object; `is_value` tells the language's values
    from other objects.
    """
    waiting: list[object] = [function]
    seen: set[CodeType] = set()
    while waiting:
        pair = unwrapped(waiting.pop(0))
        if pair is None:
            continue
        plain, arguments = pair
        is_program = not seen
        if plain.__code__ in seen or not (is_program or uses_shpy(plain)):
            continue
        seen.add(plain.__code__)
        enter_text(plain.__code__.co_filename, plain.__globals__)
        definition = definition_of(plain.__code__)
        if definition is not None:
            scope = scope_of(plain, *definition, arguments, is_value)
            waiting.extend(_called(Flow(definition[0], scope, is_program=is_program, function=plain), plain))
        else:
            waiting.extend(called_by(plain))
            if has_changed(plain.__code__):
                _tell_of_change(plain.__code__)
        if is_program:
            _check_kind(plain.__code__)


def _called(flow: Flow, function: FunctionType) -> list[object]:
    """Check a function's text; return the functions that it calls."""
    try:
        flow.check()
    except RecursionError:
        loc = _first_line(function.__code__)
        warn(
            f"{loc}: {function.__name__} holds an expression that is nested too deep for shpy's check of names that "
            "Python binds anew in a block; write it in several lines"
        )
        return []
    return flow.called


def _first_line(code: CodeType) -> Loc:
    return loc_in(code, code.co_firstlineno)


def _tell_of_change(code: CodeType) -> None:
    """Give a notice for a function whose file has another text now, and say what is not checked."""
    warn(
        f"{_first_line(code)}: Python runs another {code.co_name} than the file's text has there: the text was changed "
        "after it was loaded, or as it was loaded. Names that a block binds anew are found in the bytecode; mistakes "
        "that only a text shows, such as two names of one value, are not looked for. Load the file again"
    )


def _check_kind(code: CodeType) -> None:
    """Raise RecordError for a coroutine or a generator: a call of it returns before its body runs."""
    if code.co_flags & (inspect.CO_COROUTINE | inspect.CO_ASYNC_GENERATOR):
        kind, cure = "coroutine", f"def {code.co_name}"
    elif code.co_flags & inspect.CO_GENERATOR:
        kind, cure = "generator", "return a, b"
    else:
        return
    raise RecordError(
        f"{code.co_name} is a {kind}, and its body does not run when it is called", loc=_first_line(code), cure=cure
    )
