"""Says what a pass does in text: the body of a function before, and after."""

from __future__ import annotations

import textwrap
from collections.abc import Callable

from shpy.ir.nodes import Module
from shpy.ir.parser import parse
from shpy.ir.text import print_module
from shpy.ir.verifier import verify

HEAD = """\
module m
input a: Attrib1f
input v: Attrib3f
input k: Attrib1i
input c: Attrib1b
output o: Attrib1f
output p: Attrib3f
param sky: Attrib1f f = 0.5
table data: f [8]

{functions}function main(%a.0: f, %v.1: f3, %k.2: i, %c.3: b) -> ($o.0: f, $p.1: f3) {{
{body}
}}
"""


def module(body: str, functions: str = "") -> Module:
    """A module with this body of its entry, verified. Inputs are %a.0 %v.1 %k.2 %c.3, outputs $o.0 $p.1."""
    parsed = parse(HEAD.format(body=textwrap.dedent(body).strip(), functions=textwrap.dedent(functions)))
    verify(parsed)
    return parsed


def text(given: Module, function: str = "main") -> str:
    """The body of one of its functions as text, with names, without locations."""
    lines = print_module(given, locations=False).splitlines()
    start = next(
        n for n, line in enumerate(lines) if line.startswith(("function ", "pure ")) and f" {function}(" in line
    )
    end = lines.index("}", start)
    return textwrap.dedent("\n".join(lines[start + 1 : end])).strip()


def check(change: Callable[[Module], Module], before: str, after: str, functions: str = "") -> None:
    """Assert that `change` makes `after` of `before`."""
    changed = change(module(before, functions))
    verify(changed)
    assert text(changed) == textwrap.dedent(after).strip()
