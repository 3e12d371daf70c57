"""Attacks that take minutes: killed writers, threads beyond what is kept, odd words."""

import os
import random
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from test_threads import at_once

import shpy as sh
from raytracer import cli as rays
from shpy import cli
from shpy.run import kernel

pytestmark = pytest.mark.slow


def kill_again_and_again(script, *words, times):
    """Run a script that works for ever and kill it after a while, `times` times, three at once."""
    rng = random.Random(0)
    command = [sys.executable, "-c", script, *map(str, words)]
    for _ in range(times):
        processes = [subprocess.Popen(command, stdout=subprocess.PIPE) for _ in range(3)]
        for process in processes:
            assert process.stdout.readline() == b"works\n"
        time.sleep(rng.random() / 5)
        for process in processes:
            assert process.poll() is None
            process.send_signal(signal.SIGKILL)
            process.communicate()
            time.sleep(rng.random() / 20)


SAVING = """
import sys
import numpy as np
from shpy.files import replacing
from pathlib import Path
path = Path(sys.argv[1])
print("works", flush=True)
while True:
    for letter in "abc":
        with replacing(path) as temporary:
            temporary.write_text(letter * 3_000_000)
"""


def test_killed_writers_tear_no_file(tmp_path):
    path = tmp_path / "a.json"
    kill_again_and_again(SAVING, path, times=10)
    assert len(set(path.read_text())) == 1
    assert path.stat().st_size == 3_000_000
    left = [p for p in tmp_path.iterdir() if p != path]
    assert all(p.name.startswith(".unfinished-") for p in left)
    for p in left:
        os.utime(p, (1, 1))
    with sh.files.replacing(path) as temporary:
        temporary.write_text("done")
    assert os.listdir(tmp_path) == ["a.json"]


@pytest.mark.parametrize("backend", ["numpy", "opencl"])
def test_threads_beyond_the_kernels_that_are_kept(backend, monkeypatch):
    monkeypatch.setattr(kernel, "_KEPT", 32)
    wrong = []

    def work(first):
        for k in range(first, first + 20):

            @sh.program
            def scaled(x: sh.Attrib1f, k=k) -> sh.Attrib1f:
                return x * k + 1

            found = scaled.compile(backend)(np.arange(4))
            wrong.extend([k] if not np.array_equal(found, np.arange(4) * k + 1) else [])

    assert at_once(*(lambda first=first: work(first) for first in range(0, 160, 20))) == []
    assert wrong == []
    assert len(kernel._executables) <= kernel._KEPT


IR = """module scaled
input x: Attrib1f
output y: Attrib1f

function scaled(%x.0: f) -> ($y.0: f) {
  %1: f = mul %x.0, %x.0
  store $y.0 = %1
}
"""
ODD = """- -- -1 0 1e999 nan inf ٣ x é numpy,numpy f64, , / . /dev/full gone/a.png a:b : x=: x=2:1 x=nan:nan x=0:1:log
-1ulp nanulp 0x0 1X1 -1x3""".split()
ODD += ["", " ", "\udce9", "9" * 5000, "1" + "0" * 12]
MEASURE = "shpy accuracy p.py:f --samples 3 --backends numpy --math strict"
OPTIONS = {
    "shpy diff a.ir": "--backends --ulp --count --seed --precision --math",
    MEASURE: "--domain --backends --math --reference --seed --precision -o",
    "raytracer render boxes --size 2x2 --backend numpy -o a.npy": "--size --backend --bounces --samples --accel -o",
    "shpy": "diff accuracy surgeon",
    "raytracer": "render x",
}
LINES = [[*w.split(), option, odd] for w, given in OPTIONS.items() for option in given.split() for odd in ODD]


def test_odd_words_on_a_command_line_never_end_in_a_traceback(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.ir").write_text(IR)
    (tmp_path / "p.py").write_text("import shpy as sh\n@sh.program\ndef f(x: sh.Attrib1f):\n    return sh.sqrt(x)\n")
    wrong = []
    for words in random.Random(0).sample(LINES, 100):
        try:
            status = (cli if words[0] == "shpy" else rays).main(words[1:])
        except SystemExit as end:
            status = end.code
        except Exception as error:
            status = error
        wrong.extend([(words, status)] if status not in (0, 1, 2) else [])
    capsys.readouterr()
    assert wrong == []
