"""The tests of a command: slow ones are among them where it names no others, and with `-m slow`."""

from types import SimpleNamespace

import conftest
import pytest


def markexpr_after(request, tests, keyword="", arguments=("tests",)):
    """Return the `-m` that is left once these functions are collected for a command."""
    option = SimpleNamespace(markexpr="not slow", keyword=keyword)
    hook = SimpleNamespace(pytest_deselected=lambda items: None)
    config = SimpleNamespace(option=option, args=arguments, hook=hook)
    items = [pytest.Function.from_parent(request.node.parent, name=t.__name__, callobj=t) for t in tests]
    conftest.pytest_collection_modifyitems(config, items)
    return config.option.markexpr


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ({}, "not slow"),
        ({"keyword": "long_one"}, ""),
        ({"keyword": "one"}, "not slow"),
        ({"keyword": "short"}, "not slow"),
        ({"arguments": ["tests/test_it.py::TestIt"]}, "not slow"),
    ],
)
def test_a_slow_test_runs_where_no_other_is_named(request, command, expected):
    def short_one():
        pass

    @pytest.mark.slow
    def long_one():
        pass

    assert markexpr_after(request, [short_one, long_one], **command) == expected
    assert markexpr_after(request, [long_one], arguments=["tests/test_it.py::long_one"]) == ""
    assert markexpr_after(request, [long_one]) == "not slow"
