"""The commands at their ends: closed pipes, full disks, Ctrl-C, bad numbers, paths that cannot be written."""

import gc
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import pytest
from patience import HANGING

import shpy as sh
import shpy_start
from raytracer import cli as rays
from raytracer.studies import tradeoff as trade
from shpy import cli
from shpy.command import run, whole
from shpy.packages import install

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}


def command(*words, **named):
    return subprocess.run(
        [sys.executable, "-m", *words], env=ENVIRONMENT, stderr=subprocess.PIPE, text=True, timeout=HANGING, **named
    )


def closed_pipe():
    reader, writer = os.pipe()
    os.close(reader)
    return writer


@pytest.mark.sampled(2)
@pytest.mark.parametrize("words", [["raytracer", "scenes"], ["shpy", "--help"]])
def test_a_reader_that_has_gone_is_no_news(words):
    writer = closed_pipe()
    done = command(*words, stdout=writer)
    os.close(writer)
    assert (done.returncode, done.stderr) == (1, "")


@pytest.mark.sampled(2)
@pytest.mark.parametrize("words", [["raytracer", "scenes"], ["shpy", "--help"]])
def test_a_full_disk_is_one_line(words):
    with open("/dev/full", "w") as full:
        done = command(*words, stdout=full)
    assert (done.returncode, done.stderr) == (1, f"{words[0]}: [Errno 28] No space left on device\n")


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "words", ["raytracer render boxes --size 4x4 --backend numpy", pytest.param("shpy doctor", marks=pytest.mark.slow)]
)
def test_an_output_that_is_closed_is_no_error(words, tmp_path):
    shell = f'"{sys.executable}" -m {words} >&-'
    environment = ENVIRONMENT | {"PYTHONPATH": os.getcwd()}
    done = subprocess.run(
        shell, shell=True, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=HANGING
    )
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


def test_a_name_that_the_terminal_cannot_show_is_escaped(tmp_path):
    path, encoding = tmp_path / "é.png", {"PYTHONIOENCODING": "ascii", "PYTHONUTF8": "1"}
    words = ["raytracer", "render", "boxes", "--size", "4x4", "--backend", "numpy", "-o", str(path)]
    done = subprocess.run(
        [sys.executable, "-m", *words], env=ENVIRONMENT | encoding, capture_output=True, text=True, timeout=HANGING
    )
    assert done.returncode == 0, done.stderr
    assert r"\xe9.png: 4 x 4" in done.stdout
    assert path.exists()


def fail(error):
    def work():
        raise error

    return work


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (KeyboardInterrupt(), 130, "name: stopped\n"),
        (KeyboardInterrupt("half of it is there"), 130, "name: half of it is there\n"),
        (MemoryError("Unable to allocate 8 TiB"), 1, "name: there is not enough memory: Unable to allocate 8 TiB\n"),
        (MemoryError(), 1, "name: there is not enough memory\n"),
        (OSError(28, "No space left on device"), 1, "name: [Errno 28] No space left on device\n"),
    ],
)
def test_what_ends_a_command_is_one_line(error, status, said, capsys):
    assert run("name", fail(error)) == status
    assert capsys.readouterr().err == said


@pytest.mark.parametrize("words", [["accuracy", "a.py:f"], ["tradeoff", "a.py:f", "--error", "1ulp"], ["doctor"]])
def test_ctrl_c_is_one_line_and_130_in_every_command(words, monkeypatch, capsys):
    stop = fail(KeyboardInterrupt())
    monkeypatch.setattr("shpy.accuracy.commands.load", lambda words: stop())
    monkeypatch.setattr(sh, "backends", stop)
    assert cli.main(words) == 130
    assert capsys.readouterr().err == "shpy: stopped\n"


def test_sigterm_ends_a_command_as_ctrl_c_does(capsys):
    """By an exception, so that files are closed and taken away; then the signal is again what it was."""
    ended = []

    def work():
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(60)
        finally:
            ended.append(True)

    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    assert run("name", work, stopped="it ends") == 143
    assert ended
    assert capsys.readouterr().err == "name: it ends\n"
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_a_process_that_takes_sigterm_itself_keeps_its_way():
    before, taken = signal.getsignal(signal.SIGTERM), []
    signal.signal(signal.SIGTERM, lambda *_: taken.append(True))
    try:
        assert run("name", lambda: os.kill(os.getpid(), signal.SIGTERM) or 7) == 7
        assert taken
        with ThreadPoolExecutor(1) as pool:
            assert pool.submit(run, "name", lambda: 3).result() == 3
    finally:
        signal.signal(signal.SIGTERM, before)


INTERRUPTED = """
import os, signal, sys

class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == sys.argv[1]:
            os.kill(os.getpid(), signal.SIGINT)

signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Interrupt())
import shpy_start
shpy_start.{command}()
"""


@pytest.mark.parametrize(
    ("name", "imported"), [("shpy", "shpy"), ("shpy", "numpy"), ("raytracer", "raytracer.studies.tradeoff")]
)
def test_ctrl_c_while_a_command_is_imported_is_one_line_and_130(name, imported):
    words = [sys.executable, "-c", INTERRUPTED.format(command=name), imported]
    done = subprocess.run(words, capture_output=True, text=True, timeout=HANGING)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", f"{name}: stopped\n")


@pytest.mark.sampled(4)
@pytest.mark.parametrize("options", [["-m", "{}"], ["-m{}"], ["-W", "ignore", "-Bm", "{}"]])
@pytest.mark.parametrize(
    ("name", "imported"),
    [("shpy", "shpy.errors"), ("shpy", "numpy"), ("raytracer", "numpy"), ("raytracer", "raytracer.studies.tradeoff")],
)
def test_ctrl_c_while_python_m_imports_is_one_line_and_130(name, imported, options, tmp_path):
    site = INTERRUPTED.partition("import shpy_start")[0].replace("sys.argv[1]", repr(imported))
    (tmp_path / "sitecustomize.py").write_text(site)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    words = [sys.executable, *(word.format(name) for word in options), "--help"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=HANGING, env=environment)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", f"{name}: stopped\n")


def test_cycles_are_collected_while_a_command_runs(monkeypatch):
    module = SimpleNamespace(main=lambda: int(gc.isenabled()))
    monkeypatch.setitem(sys.modules, "started", module)
    assert shpy_start.start("shpy", "started") == 1  # it froze what is loaded, as the fixture of modules does


def test_programs_of_others_that_python_m_runs_keep_their_handler(tmp_path):
    (tmp_path / "mine.py").write_text(
        "import shpy, signal\nassert signal.getsignal(signal.SIGINT) is signal.default_int_handler\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    words = [sys.executable, "-m", "mine", "shpy"]
    start = "import signal, subprocess, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    start += "sys.exit(subprocess.run(sys.argv[1:]).returncode)"
    assert subprocess.run([sys.executable, "-c", start, *words], env=environment, timeout=HANGING).returncode == 0


def test_ctrl_c_that_is_ignored_stays_ignored(monkeypatch):
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        monkeypatch.setattr(cli, "main", lambda: int(signal.getsignal(signal.SIGINT) is signal.SIG_IGN))
        assert shpy_start.shpy() == 1
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_command_that_runs_gets_python_s_own_handler(monkeypatch):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        monkeypatch.setattr(cli, "main", lambda: int(signal.getsignal(signal.SIGINT) is signal.default_int_handler))
        assert shpy_start.shpy() == 1
    finally:
        signal.signal(signal.SIGINT, before)


NUMBERS = [
    (["shpy", "diff", "a.ir", "--count", "-5"], "--count: a whole number from 1 to 100000000, not '-5'"),
    (["shpy", "diff", "a.ir", "--count", str(10**12)], "--count: a whole number from 1 to 100000000, not"),
    (["shpy", "diff", "a.ir", "--count", "9" * 5000], "--count: a whole number from 1 to 100000000, not"),
    (["shpy", "diff", "a.ir", "--seed", "-1"], "--seed: a whole number from 0 on, not '-1'"),
    (["shpy", "diff", "a.ir", "--ulp", "nan"], "--ulp: a finite number from 0 on, not 'nan'"),
    (["shpy", "diff", "a.ir", "--ulp", "-1"], "--ulp: a finite number from 0 on, not '-1'"),
    (["shpy", "diff", "a.ir", "--ulp", "inf"], "--ulp: a finite number from 0 on, not 'inf'"),
    (["shpy", "accuracy", "a.py:f", "--samples", "0"], "--samples: a whole number from 1 to 100000000, not '0'"),
    (["shpy", "tradeoff", "a:f", "--error", "nan"], "--error: "),
    (["shpy", "tradeoff", "a:f", "--error", "1ulp", "--elements", "٣"], "--elements: a whole number from 1"),
    (["raytracer", "render", "boxes", "--size", "٣x٣"], "a size is WIDTHxHEIGHT, such as 1024x768, not '٣x٣'"),
    (["raytracer", "render", "boxes", "--size", "9" * 5000 + "x1"], "a size is WIDTHxHEIGHT"),
    (["raytracer", "render", "boxes", "--bounces", "-1"], "--bounces: a whole number from 0 on, not '-1'"),
    (["raytracer", "render", "boxes", "--samples", "1.5"], "--samples: a whole number from 1 on, not '1.5'"),
    (["raytracer", "tradeoff", "boxes", "--error", "nan"], "--error: a finite number from 0 on, not 'nan'"),
    (["raytracer", "tradeoff", "boxes", "--error", "1_0"], "--error: a finite number from 0 on, not '1_0'"),
]


@pytest.mark.parametrize(("words", "said"), NUMBERS, ids=lambda x: " ".join(x)[:50] if isinstance(x, list) else "")
def test_numbers_out_of_range_are_refused_by_name(words, said, capsys):
    with pytest.raises(SystemExit) as end:
        (cli if words[0] == "shpy" else rays).main(words[1:])
    assert end.value.code == 2
    assert said in capsys.readouterr().err


WORDS = [
    (["--precision", "f33"], "precision='f33'"),
    (["--domain", "x=nan:1"], "'x=nan:1' is no range"),
    (["--domain", "x=0:1e999"], "'x=0:1e999' is no range"),
    (["--domain", "x=-1.7e308:1.7e308"], "is no range"),
]


@pytest.mark.parametrize(("words", "said"), WORDS)
def test_accuracy_refuses_words_that_mean_nothing(words, said, tmp_path, capsys):
    (tmp_path / "p.py").write_text("import shpy as sh\n@sh.program\ndef f(x: sh.Attrib1f):\n    return sh.sqrt(x)\n")
    assert cli.main(["accuracy", f"{tmp_path / 'p.py'}:f", "--backends", "numpy", *words]) == 2
    assert said in capsys.readouterr().err


def test_an_endless_text_is_refused(monkeypatch, capsys):
    monkeypatch.setattr(cli, "_LONGEST", 1000)
    assert cli.main(["diff", "/dev/zero"]) == 2
    assert "/dev/zero is longer than 1000 characters" in capsys.readouterr().err


def test_whole_numbers_are_read():
    assert [whole(0, 9)(text) for text in ("0", "+7", "09")] == [0, 7, 9]


def test_doctor_says_that_the_default_backend_is_none(monkeypatch, capsys):
    monkeypatch.setenv("SHPY_BACKEND", "foo")
    assert cli.main(["doctor"]) == 1
    assert "3 of 3 backends work; SHPY_BACKEND names no backend: 'foo'" in capsys.readouterr().out


MODULES = [
    ("def f(:\n", "a.py:1: SyntaxError: "),
    ("x = 1\n1 / 0\n", "a.py:2: ZeroDivisionError: division by zero"),
    ("\n\nraise SystemExit(7)\n", "a.py:3: SystemExit: 7"),
    ("import shpy as sh\n@sh.program\ndef f(x):\n    return x\n", "a.py:2: the input x is not annotated"),
    ("import nowhere\n", "a.py:1: ModuleNotFoundError: No module named 'nowhere'"),
    (None, "there is no file "),
]


@pytest.mark.parametrize(("text", "said"), MODULES, ids=["syntax", "error", "exit", "record", "import", "missing"])
def test_a_module_that_fails_is_one_line(text, said, tmp_path, capsys):
    if text is not None:
        (tmp_path / "a.py").write_text(text)
    assert cli.main(["accuracy", f"{tmp_path / 'a.py'}:f"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("shpy accuracy: ")
    assert said in error
    assert "Traceback" not in error


@pytest.fixture
def no_work(monkeypatch):
    """Whatever takes long fails."""
    stop = fail(AssertionError("it worked"))
    monkeypatch.setattr(rays, "render", stop)
    monkeypatch.setattr(trade, "_measured", stop)
    monkeypatch.setattr("shpy.accuracy.commands.load", stop)


def use_folder(monkeypatch, path):
    path.mkdir(parents=True)


def use_no_folder(monkeypatch, path):
    pass


def use_without(name):
    def prepare(monkeypatch, path):
        path.parent.mkdir()
        monkeypatch.setitem(sys.modules, name, None)

    return prepare


RENDER, TRADE = ["raytracer", "render", "boxes"], ["raytracer", "tradeoff", "boxes"]
ACCURACY = ["shpy", "accuracy", "a.py:f"]
OUTPUTS = [
    (RENDER, "a.png", use_folder, "a.png is a folder"),
    (RENDER, "a.png", use_no_folder, "there is no folder"),
    (RENDER, "a.png", use_without("PIL"), f"writing PNG, JPEG and WebP needs Pillow: {install('pillow')}"),
    (RENDER, "a.exr", use_without("OpenEXR"), f"writing EXR needs OpenEXR: {install('OpenEXR')}"),
    (TRADE, "a.png", use_folder, "a.png is a folder"),
    (
        TRADE,
        "a.png",
        use_without("matplotlib.figure"),
        f"plots need matplotlib\n  write instead: {install('matplotlib')}",
    ),
    (ACCURACY, "a.png", use_folder, "a.png is a folder"),
    (ACCURACY, "a.png", use_without("matplotlib.figure"), "plots need matplotlib"),
    (ACCURACY, "a.json", use_folder, "a.json is a folder"),
]


@pytest.mark.parametrize(("words", "name", "prepare", "said"), OUTPUTS)
def test_outputs_are_checked_before_the_work(words, name, prepare, said, tmp_path, monkeypatch, capsys, no_work):
    path = tmp_path / "folder" / name
    prepare(monkeypatch, path)
    status = (cli if words[0] == "shpy" else rays).main([*words[1:], "-o", str(path)])
    assert status in (1, 2)
    error = capsys.readouterr().err
    assert said in error
    assert "Traceback" not in error


@pytest.mark.parametrize("name", ["a.png", "a.json"])
def test_both_files_of_a_plot_are_checked(name, tmp_path, capsys, no_work):
    (tmp_path / name).mkdir()
    for words in (TRADE, ACCURACY):
        main = (cli if words[0] == "shpy" else rays).main
        assert main([*words[1:], "-o", str(tmp_path / "a.png")]) in (1, 2)
        assert f"{name} is a folder" in capsys.readouterr().err
