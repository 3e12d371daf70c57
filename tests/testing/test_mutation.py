import ast
from pathlib import Path

import mutation
import pytest

EVERY_KIND = """\
é = "é" if a < b and not c else (d)  # <
while x is not None:
    x[i + 1] = True
    f(x)
def g(x: int = 3) -> "int":
    if a in b:
        raise ValueError(1 + 2)
    return x if not y else -1
"""
FAULTS = [
    "not (a < b and not c)", "a < b or not c", "a <= b", "not (x is not None)", "x is None", "x[i - 1]", "x[i + 2]",
    "= False", "    pass", "= 4", "not (a in b)", "a not in b", "x if not (not y)", "else -2",
]  # fmt: skip


def test_each_kind_of_fault_changes_one_place(monkeypatch, tmp_path):
    monkeypatch.setattr(mutation, "ROOT", tmp_path)
    (tmp_path / "every.py").write_text(EVERY_KIND)
    faults = list(mutation.faults_in("part", "every.py"))
    texts = [fault.applied(EVERY_KIND) for fault in faults]
    assert len(texts) == len(set(texts)) == len(FAULTS)
    assert [expected for expected in FAULTS if sum(expected in text for text in texts) != 1] == []
    for text in texts:
        ast.parse(text)


def test_a_seed_draws_the_same_faults_and_as_many_in_each_part():
    count = 3 * len(mutation.PARTS)
    faults = mutation.chosen(5, count)
    assert faults == mutation.chosen(5, count)
    assert faults != mutation.chosen(6, count)
    assert [fault.part for fault in faults] == [part for part in mutation.PARTS for _ in range(3)]


@pytest.mark.parametrize("part", mutation.PARTS)
def test_the_fast_tests_of_a_part_are_there(part):
    assert [name for name in mutation.PARTS[part].tests if not (Path(mutation.ROOT) / name).exists()] == []
    assert [name for name in mutation.PARTS[part].folders if not (Path(mutation.ROOT) / name).is_dir()] == []
