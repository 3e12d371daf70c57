"""The answers of drivers on disk: whole or not at all, and asked again where they are damaged."""

import os
import stat
import subprocess
import sys
import threading
import warnings

import pytest
from patience import HANGING

import shpy as sh
from shpy.backend.device import store

PROGRAM = """
import numpy as np, shpy as sh
@sh.program
def f(x: sh.Attrib1f):
    return sh.sqrt(x) * 3
assert f.compile("opencl")(np.float32(4)) == 6
"""


KEY = store.key("text", "device")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path / "answers"))
    monkeypatch.setattr(store, "_told", set())
    return tmp_path / "answers"


def entry_of(folder, key=KEY):
    return folder / f"{key}.shpy-answers"


def kept(answer="div", key=KEY):
    """Return what is kept under a key, or else the answer, which is kept then."""
    return store.known_names(key, {"div", "sqrt"}, lambda: [answer])


def test_a_driver_is_asked_once_for_each_key(folder):
    assert kept("div") == kept("sqrt") == {"div"}
    assert kept("sqrt", store.key("textdevice", "")) == {"sqrt"}
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert len(list(folder.iterdir())) == 2


def test_names_that_make_no_sense_any_more_are_asked_for_again(folder):
    kept("div")
    assert store.known_names(KEY, {"sqrt"}, lambda: []) == frozenset()
    assert kept("div") == frozenset()


@pytest.mark.parametrize(
    "damage", [lambda d: d[:-1], lambda d: b"", lambda d: d[:20] + b"x" + d[21:], lambda d: d + b"y", lambda d: d[:9]]
)
def test_a_damaged_entry_counts_as_none_and_is_replaced(folder, damage):
    kept("div")
    entry_of(folder).write_bytes(damage(entry_of(folder).read_bytes()))
    assert kept("sqrt") == kept("div") == {"sqrt"}


def test_an_entry_counts_for_its_own_key_only(folder):
    other = store.key("another text", "device")
    kept("div", other)
    entry_of(folder, other).rename(entry_of(folder))
    assert kept("sqrt") == {"sqrt"}


def test_a_full_disk_is_told_and_leaves_nothing(folder, monkeypatch):
    def fail(*args, **named):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store.Path, "write_text", fail)
    with pytest.warns(sh.ShpyWarning, match=r"answers cannot be written \(No space left on device\)"):
        assert kept("div") == {"div"}
    assert list(folder.iterdir()) == []


def test_threads_that_keep_one_answer_all_succeed(folder):
    answers = []

    def work():
        for _ in range(50):
            entry_of(folder).unlink(missing_ok=True)
            answers.append(kept("div"))

    threads = [threading.Thread(target=work) for _ in range(4)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert answers == 200 * [{"div"}]  # an error ends a thread early
    assert set(folder.iterdir()) <= {entry_of(folder)}


def test_nothing_is_kept_where_that_is_asked_for(monkeypatch, tmp_path):
    monkeypatch.setenv("SHPY_CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert kept("div") == {"div"}
    assert kept("sqrt") == {"sqrt"}
    assert list(tmp_path.iterdir()) == []


def test_the_users_cache_folder_is_the_default(monkeypatch, tmp_path):
    monkeypatch.delenv("SHPY_CACHE_DIR")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    for cache, place in ((str(tmp_path / "xdg"), "xdg/shpy"), ("relative", ".cache/shpy"), ("", ".cache/shpy")):
        monkeypatch.setenv("XDG_CACHE_HOME", cache)
        kept("div")
        assert entry_of(tmp_path / place).exists()
    assert not (tmp_path / "relative").exists()


def test_a_tilde_is_the_home_folder(folder, monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SHPY_CACHE_DIR", "~/answers")
    kept("div")
    assert entry_of(tmp_path / "answers").exists()
    assert not (tmp_path / "~").exists()
    monkeypatch.setenv("SHPY_CACHE_DIR", "~no-such-user-of-this-machine/answers")
    with pytest.warns(sh.ShpyWarning, match="the folder ~no-such-user-of-this-machine/answers cannot be used"):
        kept("div")


def test_a_folder_that_cannot_be_made_is_told_once(folder, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path / "file" / "answers"))
    with pytest.warns(sh.ShpyWarning, match=r"file/answers cannot be used \(Not a directory\)") as told:
        assert [kept(name) for name in ("div", "sqrt")] == [{"div"}, {"sqrt"}]
    assert len(told) == 1


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_a_warning_names_the_line_that_compiles(tmp_path, backend):
    """The work of GLSL is done by a thread of its own, in which no line is the user's."""
    (tmp_path / "file").write_text("")
    (tmp_path / "program.py").write_text(PROGRAM.replace("opencl", backend))
    environment = os.environ | {"SHPY_CACHE_DIR": str(tmp_path / "file"), "PYTHONWARNINGS": "default"}
    run = [sys.executable, str(tmp_path / "program.py")]
    done = subprocess.run(run, env=environment, capture_output=True, text=True, timeout=HANGING)
    assert f"{tmp_path}/program.py:6: ShpyWarning: what drivers can do is not kept" in done.stderr


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("variable", "value", "place"),
    [
        ("HOME", "file", "file/.cache/pocl/kcache (Not a directory)"),
        ("XDG_CACHE_HOME", "file", "file/pocl/kcache (Not a directory)"),
        ("POCL_CACHE_DIR", "file/x", "file/x (Not a directory)"),
        ("POCL_CACHE_DIR", "file", "file (File exists)"),  # PoCL offers its device here, and then compiles nothing
    ],
)
def test_pocl_without_a_place_for_its_cache_is_told_from_a_missing_driver(tmp_path, variable, value, place):
    (tmp_path / "file").write_text("")
    environment = {k: v for k, v in os.environ.items() if k not in ("XDG_CACHE_HOME", "POCL_CACHE_DIR")}
    environment[variable] = str(tmp_path / value)
    run = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(run, env=environment, capture_output=True, text=True, timeout=HANGING)
    assert done.returncode == 1
    assert f"PoCL cannot write its cache in {tmp_path}/{place}, and runs nothing without it" in done.stderr
    assert "to mend it: export POCL_CACHE_DIR=FOLDER with a folder that you can write" in done.stderr


def test_pocl_without_room_for_its_cache_is_an_error_that_says_so(tmp_path):
    """PoCL ends the process, by SIGABRT, where it can write only a part of a file."""
    limited = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192)){PROGRAM}"
    folder, run = tmp_path / "pocl", [sys.executable, "-c", limited]
    environment = os.environ | {"POCL_CACHE_DIR": str(folder), "SHPY_CACHE_DIR": ""}
    done = subprocess.run(run, env=environment, capture_output=True, text=True, timeout=HANGING)
    assert done.returncode == 1
    assert f"Unavailable: <string>:6: PoCL cannot write its cache in {folder} (File too large)" in done.stderr


LOST = """
import os, shutil
folder = os.environ["POCL_CACHE_DIR"]
stream = sh.Stream([3, 1, 2], sh.Attrib1i, "opencl")
shutil.rmtree(folder)
open(folder, "w").close()
@sh.program
def add(a: sh.Attrib1i, b: sh.Attrib1i) -> sh.Attrib1i:
    return a + b
for work in (lambda: add.compile("opencl"), lambda: sh.sort(stream), lambda: sh.reduce(add, stream)):
    try:
        work()
    except sh.BackendUnavailable as error:
        print(error.message)
"""


def test_pocl_that_loses_its_cache_is_an_error_that_says_so(tmp_path):
    """Kernels of the user, and those of collectives."""
    run = [sys.executable, "-c", PROGRAM + LOST]
    environment = os.environ | {"POCL_CACHE_DIR": str(tmp_path / "pocl")}
    done = subprocess.run(run, env=environment, capture_output=True, text=True, timeout=HANGING)
    assert done.returncode == 0, done.stderr
    said = f"PoCL cannot write its cache in {tmp_path}/pocl (File exists), and runs nothing without it"
    assert done.stdout.splitlines() == [said] * 3


def test_the_folders_of_pocl_and_shpy_are_enough(tmp_path):
    """As in a container whose user has no home: pyopencl, too, has a cache there, and fails without a folder for it."""
    (tmp_path / "file").write_text("")
    environment = {k: v for k, v in os.environ.items() if k not in ("XDG_CACHE_HOME", "PYOPENCL_NO_CACHE")}
    environment |= {
        "HOME": str(tmp_path / "file"),
        "POCL_CACHE_DIR": str(tmp_path / "pocl"),
        "SHPY_CACHE_DIR": str(tmp_path / "shpy"),
    }
    run = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(run, env=environment, capture_output=True, text=True, timeout=HANGING)
    assert done.returncode == 0, done.stderr


def test_a_list_remembers_its_last_words(monkeypatch, tmp_path):
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(store, "_REMEMBERED", 3)
    assert not store.is_remembered("texts", "a")
    for word in "abcad":
        store.remember("texts", word)
    assert [store.is_remembered("texts", word) for word in "abcd"] == [True, False, True, True]
    assert not store.is_remembered("others", "a")
    monkeypatch.setenv("SHPY_CACHE_DIR", "")
    store.remember("texts", "e")
    assert not store.is_remembered("texts", "a")
