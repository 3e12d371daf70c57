"""Find English that is not ours in docstrings, comments, messages and documents.

CONTRIBUTING.md says how we write. `openings` finds docstrings that start with a question word in place of a verb, and
`words` finds expressions for which a textbook has its own term. Each yields places as (file, line, text). Ruff's D401
finds functions whose docstring does not start with an imperative verb.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
TOPS = ("shpy", "raytracer", "shpy_start", "examples", "benchmarks", "tests", "docs")
Place = tuple[str, int, str]

OPENING = re.compile(r"(What|Whether|Which|Who|That|Those|Of|How|Where|Why)\b")
QUOTED = re.compile(r"[\"']\s*" + OPENING.pattern)

WORDS = {
    r"that (is|are) (?-i:none)": "is not one, does not exist",
    r"(each|every|one|per|first|last|next|previous|many|several|all|more|few|further|same) turns?": "iteration",
    r"part(s|ed|ing)? ways": "diverge",
    r"(put|puts|putting) aside": "save, mask out",
    r"(each|every|many|few|two|between|first|last) looks?(?!-)": "check, visit",
    r"bare (call|number|name|value|vector|scalar|expression)s?": "plain",
    r"of which nothing is said": "by default",
}
"""Expressions that are not ours, and what to write instead."""

NOT_OURS = re.compile("|".join(rf"\b(?:{word})\b" for word in WORDS), re.IGNORECASE)

OWN = ("tests/english.py", "CONTRIBUTING.md")
"""Files that name the expressions."""


def files(*suffixes: str) -> list[str]:
    """Return the files with one of these suffixes, without emitted texts."""
    found = [*ROOT.glob("*.md"), *(p for top in TOPS for p in (ROOT / top).rglob("*"))]
    names = sorted(str(p.relative_to(ROOT)) for p in found if p.suffix in suffixes)
    return [name for name in names if not name.startswith("tests/snapshots/")]


def openings() -> Iterator[Place]:
    """Yield the docstrings, of attributes and constants too, that open with a question word."""
    for file in files(".py"):
        whole = (ROOT / file).read_text()
        if QUOTED.search(whole):  # parsing every file would take most of the time
            for line, text in _docstrings(ast.parse(whole)):
                if OPENING.match(text):
                    yield file, line, text.splitlines()[0]


def _docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield the docstrings of modules, classes, functions and assignments: any statement that is a string alone."""
    for node in ast.walk(tree):
        match node:
            case ast.Expr(value=ast.Constant(value=str(text))):
                yield node.lineno, text.strip()


def words() -> Iterator[Place]:
    """Yield the comments, strings and paragraphs with an expression that is not ours."""
    for file in files(".py", ".md"):
        whole = (ROOT / file).read_text()
        if file not in OWN and NOT_OURS.search(re.sub(r"\s+", " ", whole)):  # tokens of every file would take seconds
            for line, text in _texts(file, whole):
                for found in NOT_OURS.finditer(re.sub(r"\s+", " ", text)):
                    yield file, line, found.string[max(0, found.start() - 30) : found.end() + 30]


def _texts(file: str, whole: str) -> Iterator[tuple[int, str]]:
    if file.endswith(".md"):
        line = 1
        for paragraph in whole.split("\n\n"):
            yield line, paragraph
            line += paragraph.count("\n") + 2
        return
    for token in tokenize.generate_tokens(io.StringIO(whole).readline):
        if token.type in (tokenize.COMMENT, tokenize.STRING):
            yield token.start[0], token.string
