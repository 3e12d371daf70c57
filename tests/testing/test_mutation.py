import ast
import json
import os
import time

import pytest

from tests.mutation import judge, map, small_faults as faults

EVERY_KIND = """\
é = "é" if a < b and not c else (d)  # <
while x is not None:
    x[i + 1] = True
    f(x)
def g(x: int = 3) -> "int":
    if a in b:
        raise ValueError(1 + 2)
    return x if not y else -1
Alias: TypeAlias = Literal[1, 2] | None
Both = Some | None
raised = f"{a + 1}"
"""
FAULTS = [
    "not (a < b and not c)", "a < b or not c", "a <= b", "not (x is not None)", "x is None", "x[i - 1]", "x[i + 2]",
    "= False", "    pass", "= 4", "not (a in b)", "a not in b", "x if not (not y)", "else -2",
]  # fmt: skip


def test_each_kind_of_fault_changes_one_place(monkeypatch, tmp_path):
    monkeypatch.setattr(faults, "ROOT", tmp_path)
    (tmp_path / "every.py").write_text(EVERY_KIND)
    found = list(faults.faults_in("part", "every.py"))
    texts = [fault.applied(EVERY_KIND) for fault in found]
    assert len(texts) == len(set(texts)) == len(FAULTS)
    assert [expected for expected in FAULTS if sum(expected in text for text in texts) != 1] == []
    for text in texts:
        ast.parse(text)


def test_a_fault_knows_the_function_around_it(monkeypatch, tmp_path):
    monkeypatch.setattr(faults, "ROOT", tmp_path)
    source = "a = 1\n@cache\n@other\ndef f():\n    g = (lambda:\n        2)\n    def h(): return 3\n"
    (tmp_path / "nested.py").write_text(source)
    code = compile(source, "nested.py", "exec")
    outer = next(c for c in code.co_consts if hasattr(c, "co_name"))
    inner = [c.co_firstlineno for c in outer.co_consts if hasattr(c, "co_name")]
    functions = [fault.function for fault in faults.faults_in("part", "nested.py")]
    assert functions == [0, *inner]
    assert outer.co_firstlineno == faults.first_line(ast.parse(source).body[1])


@pytest.mark.slow
def test_a_seed_draws_the_same_faults_and_as_many_in_each_part():
    count = 3 * len(faults.DRAWN)
    drawn = faults.chosen(5, count)
    assert drawn == faults.chosen(5, count)
    assert drawn != faults.chosen(6, count)
    assert [fault.part for fault in drawn] == [part for part in faults.DRAWN for _ in range(3)]


def test_the_folders_of_each_part_are_there():
    assert [name for part in faults.PARTS.values() for name in part if not (faults.ROOT / name).is_dir()] == []


CHILD = """
import os, subprocess, sys, time
def test_ends():
    import part
    if part.FAULTY == 1:
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        open("child", "w").write(str(child.pid))
        time.sleep(600)
"""
ENDS = {
    "a test that fails": (
        "def test_a(): pass\ndef test_b():\n    import part\n    assert part.FAULTY == 0",
        "behaviour",
    ),
    "a test that fails without it": ("def test_a(): assert False", "fails without the fault"),
    "no test": ("", "pytest ended with 5"),
    "none that fails": ("def test_a(): pass", None),
    "an interrupt": ("def test_a(): raise KeyboardInterrupt", "pytest ended with 2"),
    "the end of the process": ("import os, part\ndef test_a(): part.FAULTY and os.abort()", "crash"),
    "a test without end": (CHILD, "time limit"),
    "an error of collection": ("import part\nassert part.FAULTY == 0\ndef test_a(): pass", "behaviour"),
}


@pytest.mark.sampled(8)
@pytest.mark.parametrize("case", ENDS)
def test_only_a_test_with_a_name_finds_a_fault(case, monkeypatch, tmp_path):
    test, expected = ENDS[case]
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests/test_part.py").write_text(test)
    (tmp_path / "part.py").write_text("FAULTY = 0\n")
    for name in judge.COPIED:
        (tmp_path / name).mkdir(exist_ok=True)
    for module in (faults, judge):
        monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(judge, "COPIED", ("tests",))
    monkeypatch.setattr(judge, "IMPORTED", ())
    monkeypatch.setattr(judge, "LEAST_SECONDS", 8.0)
    monkeypatch.setattr(judge, "SLOWER", 1)
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.setenv("PYTEST_PLUGINS", "xdist.plugin")
    fault = next(faults.faults_in("part", "part.py"))
    with judge.Copy() as copy:
        (copy.folder / "part.py").write_text("FAULTY = 0\n")
        try:
            found = judge.Judge(copy, map.Reach(), 0).finding(fault, ["tests/test_part.py"], False)
            said = found and found.kind
        except judge.Unjudged as reason:
            said = expected if expected in str(reason) else str(reason)
        assert said == expected
        assert (copy.folder / "part.py").read_text() == "FAULTY = 0\n"
        if expected == "time limit":
            child = int((copy.folder / "child").read_text())
            time.sleep(0.1)
            assert not os.path.exists(f"/proc/{child}") or "Z" in open(f"/proc/{child}/stat").read().split()[2]


def test_tests_of_a_fault_begin_with_fitting_files_and_end_where_time_does(tmp_path):
    function = {"function": "shpy/passes/known.py:7", "number": 1}
    other = {"function": "shpy/passes/known.py:9", "number": 2}
    tests = [("tests/ir/test_a.py::x", 1, [1]), ("tests/passes/test_known.py::y", 2, [1]),
             ("tests/passes/test_known.py::z", 9, [1]), ("tests/ir/test_b.py::w", 1, [2])]  # fmt: skip
    lines = [function, other] + [
        {"test": name, "outcomes": ["passed"] * 3, "seconds": seconds, "reached": reached}
        for name, seconds, reached in tests
    ]
    broken = {"test": "tests/ir/test_c.py::v", "outcomes": ["passed", "failed", "passed"], "seconds": 1, "reached": [1]}
    (tmp_path / "1.jsonl").write_text("\n".join(json.dumps(line) for line in [*lines, broken]) + '\n{"te')
    reach = map.Reach(tmp_path)
    ordered = reach.tests(faults.Fault("passes", "shpy/passes/known.py", 7, 0, 1, ""))
    assert [test[-1] for test in ordered] == ["y", "z", "x", "w"]
    assert [[test[-1] for test in run] for run in reach.split(ordered, (3, 3))] == [["y"], ["z"]]
    assert (reach.longest(ordered[:1]), reach.longest([])) == (2, 9)  # no tests: the whole run
    assert reach.failed == ["tests/ir/test_c.py::v"]
