"""Digests of modules: the same where the texts are, other ones wherever one word or number of a text is another."""

import re
from dataclasses import replace

from test_ir_text import EVERYTHING

from shpy.errors import ParseError
from shpy.ir.digest import digest
from shpy.ir.metadata import NOTHING
from shpy.ir.parser import parse
from shpy.ir.text import print_module
from shpy.testing.conformance.catalogue import all_cases


def changed_texts():
    """Yield the text with one number or word changed, wherever it is one still."""
    for match in re.finditer(r"\d+|[a-z]+", EVERYTHING):
        word = match[0]
        other = str(int(word) + 1) if word.isdigit() else {"then": "else", "f": "d", "i": "u"}.get(word, word + "q")
        try:
            yield parse(EVERYTHING[: match.start()] + other + EVERYTHING[match.end() :])
        except ParseError:
            continue


def test_every_change_of_a_text_is_one_of_the_digest():
    modules = [parse(EVERYTHING), *changed_texts()]
    bare = [replace(module, params=tuple(replace(p, about=NOTHING) for p in module.params)) for module in modules]
    texts = [print_module(module) for module in bare]
    assert len(set(texts)) > 190
    assert len({digest(module) for module in bare}) == len(set(texts))
    assert [digest(module) for module in modules] == [digest(module) for module in bare]  # metadata does not count


def test_programs_of_other_texts_have_other_digests():
    modules = [case.program.ir for case in all_cases()[::5]]
    texts = [print_module(module) for module in modules]
    assert len({digest(module) for module in modules}) == len(set(texts))
    assert [digest(parse(text)) for text in texts[::10]] == [digest(module) for module in modules[::10]]
