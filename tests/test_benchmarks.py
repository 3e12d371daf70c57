"""The benchmark measures what it says it does; its limits hold by a wide margin on a small program."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks import record


def test_recording_and_every_text_is_measured():
    count, seconds = record.measured(lambda: record.straight(40), repeats=1)
    assert count > 300
    assert list(seconds) == ["record", "numpy", "opencl", "glsl"]
    assert all(value > 0 for value in seconds.values())


def test_the_texts_are_those_that_kernels_have():
    program = record.straight(20)
    for backend, text in record.TEXTS.items():
        assert text(program.ir) == program.compile(backend, lanes=1).source


def test_a_slow_run_is_a_failure(monkeypatch, capsys):
    monkeypatch.setattr(record, "LINES", (10, 20))
    monkeypatch.setattr(record, "ALLOWED_FOR_10_000", 1e-9)
    assert record.main() == 1
    rows = capsys.readouterr().out.splitlines()
    assert [row.split("  ")[0] for row in rows[1:4]] == ["10 lines", "20 lines", "the ray tracer"]
