"""The size of a module, and of its code after a compiler has inlined functions.

Stage: improve; it changes nothing. A loop's body counts once.

    inlined_sizes(module)    ->   {"f0": 4, "f1": 10, "f2": 22, ..., "main": 3_221_225_470}
    not_inlined(module)       ->   {"f3", "f5", ...}
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container

from shpy.errors import CompileError
from shpy.ir.nodes import Module
from shpy.ir.traverse import calls_of, walk

MOST_STATEMENTS = 100_000
"""The most statements of a program, each function counted once, that a driver's compiler is given."""
WORTH_KEEPING = 20_000
"""The least number of statements of a program, with all calls inlined, at which functions are not inlined."""
_SMALL = 30
"""The least number of statements of a function that is kept apart; a smaller body costs no more than a call."""


def inlined_sizes(module: Module, apart: Container[str] = ()) -> dict[str, int]:
    """Return the number of statements of each function with its calls inlined, except calls of functions in `apart`.

    The time is linear in the size of the module, even if the result is exponential in it.
    """
    sizes: dict[str, int] = {}
    for function in module.functions:
        own = sum(1 for _ in walk(function.body))
        sizes[function.name] = own + sum(sizes[name] for name in calls_of(function) if name not in apart)
    return sizes


def copies_of(module: Module) -> dict[str, int]:
    """Return how many copies of each function there are with all calls inlined: a loop's body counts once."""
    copies = dict.fromkeys((f.name for f in module.functions), 0)
    copies[module.entry.name] = 1
    for function in reversed(module.functions):
        for name in calls_of(function):
            copies[name] += copies[function.name]
    return copies


def not_inlined(module: Module) -> frozenset[str]:
    """Return the functions that a compiler must not inline, so that its work stays in proportion to the text.

    If the program with all calls inlined has WORTH_KEEPING statements, these are the functions with several calls that
    are not small. Otherwise the set is empty.
    """
    if inlined_sizes(module)[module.entry.name] < WORTH_KEEPING:
        return frozenset()
    calls = Counter(name for function in module.functions for name in calls_of(function))
    sizes: dict[str, int] = {}
    apart: set[str] = set()
    for f in module.functions:
        own = sum(1 for _ in walk(f.body))
        sizes[f.name] = own + sum(sizes[name] for name in calls_of(f) if name not in apart)
        if calls[f.name] > 1 and sizes[f.name] >= _SMALL:
            apart.add(f.name)
    return frozenset(apart)


def check_growth(module: Module, most: int, why: str, apart: Container[str] = ()) -> None:
    """Raise CompileError if a function has more than `most` statements with its calls inlined, but for `apart`.

    `why` names the pass that inlines them. A module that is large without inlining is not refused.
    """
    own = {f.name: sum(1 for _ in walk(f.body)) for f in module.functions}
    total = max(inlined_sizes(module, apart).values())
    if total <= most or 2 * sum(own.values()) > most:
        return
    copies = copies_of(module)
    worst = sorted((n for n in own if n != module.entry.name), key=lambda n: own[n] * copies[n], reverse=True)
    listed = ", ".join(f"{shortened(name)} {spoken(copies[name])} times" for name in worst[:3])
    raise CompileError(
        f"{why}, and this program would become {spoken(total)} statements: it calls {listed}",
        loc=module.entry.loc,
        cure="loops (SH_FOR) around the calls, or fewer calls of calls",
    )


def check_size(module: Module, compiler: str) -> None:
    """Raise CompileError if the module has more statements than a driver's compiler takes in reasonable time.

    Its time and memory grow faster than the text: PoCL takes a minute for 40,000 additions in a row.
    """
    total = sum(1 for f in module.functions for _ in walk(f.body))
    if total > MOST_STATEMENTS:
        raise CompileError(
            f"this program has {spoken(total)} statements, and {compiler} would take very long for so many: "
            f"at most {MOST_STATEMENTS:,} are compiled",
            loc=module.entry.loc,
            cure='loops (SH_FOR) instead of unrolled statements, several programs, or compile("numpy")',
        )


def shortened(name: str, most: int = 60) -> str:
    """Return a name, shortened to `most` characters for a message."""
    return name if len(name) <= most else f"{name[:most]}…"


def spoken(number: int) -> str:
    """Return a count as text: exact up to 10**12, then rounded."""
    return f"{number:,}" if number < 10**12 else f"{number:.1e}" if number < 10**300 else "more than 1e300"
