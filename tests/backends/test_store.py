"""Compiled kernels on disk: whole or not at all, and data only."""

import os
import stat
import subprocess
import sys

import pytest

from shpy.backends import store

PROGRAM = """
import numpy as np, shpy as sh
@sh.program
def f(x: sh.Attrib1f):
    return sh.sqrt(x) * 3
assert f.compile("opencl")(np.float32(4)) == 6
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path / "kernels"))
    return tmp_path / "kernels"


def test_what_is_saved_is_loaded(folder):
    name = store.key("text", "device")
    assert store.load(name) is None
    store.save(name, b"binary")
    assert store.load(name) == b"binary"
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert [e.name for e in folder.iterdir()] == [name]
    assert name != store.key("textdevice", "")


@pytest.mark.parametrize(
    "damage", [lambda d: d[:-1], lambda d: b"", lambda d: d[:20] + b"x" + d[21:], lambda d: d + b"y"]
)
def test_a_broken_entry_counts_as_none_and_goes(folder, damage):
    store.save("entry", b"binary")
    entry = folder / "entry"
    entry.write_bytes(damage(entry.read_bytes()))
    assert store.load("entry") is None
    assert not entry.exists()


def test_old_entries_go_first(folder, monkeypatch):
    monkeypatch.setattr(store, "_MOST", 3)
    for age, name in enumerate("abcde"):
        store.save(name, b"binary")
        os.utime(folder / name, (age, age)) if (folder / name).exists() else None
    assert not (folder / "a").exists()
    assert len(list(folder.iterdir())) == 3


def test_nothing_is_kept_where_that_is_asked_for(monkeypatch, tmp_path):
    monkeypatch.setenv("SHPY_CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    store.save("entry", b"binary")
    assert store.load("entry") is None
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_no_error(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path / "file" / "kernels"))
    store.save("entry", b"binary")
    assert store.load("entry") is None


def test_another_process_takes_the_binary_and_survives_a_broken_one(folder):
    def run():
        subprocess.run([sys.executable, "-c", PROGRAM], check=True, timeout=120)

    run()
    entries = list(folder.iterdir())
    assert entries
    kept = {e.name: e.read_bytes() for e in entries}
    run()
    assert {e.name: e.read_bytes() for e in folder.iterdir()} == kept
    for entry in entries:
        store.save(entry.name, b"no program")
    run()
    assert {e.name for e in folder.iterdir()} == set(kept)
    assert all(store.load(name) != b"no program" for name in kept)
