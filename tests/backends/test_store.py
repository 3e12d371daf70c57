"""Compiled kernels on disk: whole or not at all, data only, this user's only, and nothing else is touched."""

import hashlib
import os
import shutil
import stat
import subprocess
import sys
import threading
import time
import warnings

import pytest
from patience import HANGING

import shpy as sh
from shpy.backend.device import store
from shpy.backend.opencl.device.driver import machine_of

PROGRAM = """
import numpy as np, shpy as sh
@sh.program
def f(x: sh.Attrib1f):
    return sh.sqrt(x) * 3
assert f.compile("opencl")(np.float32(4)) == 6
"""


KEY = store.key("text", "device")
OTHER = store.key("another text", "device")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path / "kernels"))
    monkeypatch.setattr(store, "_told", set())
    return tmp_path / "kernels"


def entry_of(folder, key=KEY):
    return folder / f"{key}.shpy-kernel"


def disown(path, monkeypatch):
    """Let a file or folder belong to somebody else: really where this is root, else as `os.fstat` tells it."""
    if os.geteuid() == 0:
        os.chown(path, 12345, -1)
        return
    place, real = path.stat().st_ino, os.fstat

    def told(descriptor):
        state = real(descriptor)
        return os.stat_result((*state[:4], 12345, *state[5:])) if state.st_ino == place else state

    monkeypatch.setattr(os, "fstat", told)


def use(times=1):
    """Load and save, where neither may do anything."""
    for _ in range(times):
        assert store.load(KEY) is None
        store.save(OTHER, b"binary")


def state_of(folder):
    """Return the state of a stranger's folder: its mode, and the content of each file."""
    return stat.S_IMODE(folder.stat().st_mode), {e.name: e.read_bytes() for e in folder.iterdir()}


def test_what_is_saved_is_loaded(folder):
    assert store.load(KEY) is None
    store.save(KEY, b"binary")
    assert store.load(KEY) == b"binary"
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert [e.name for e in folder.iterdir()] == [f"{KEY}.shpy-kernel"]
    assert stat.S_IMODE(entry_of(folder).stat().st_mode) == 0o600
    assert KEY != store.key("textdevice", "")


@pytest.mark.parametrize(
    "damage", [lambda d: d[:-1], lambda d: b"", lambda d: d[:20] + b"x" + d[21:], lambda d: d + b"y", lambda d: d[:9]]
)
def test_a_damaged_entry_counts_as_none_and_is_replaced(folder, damage):
    store.save(KEY, b"binary")
    entry_of(folder).write_bytes(damage(entry_of(folder).read_bytes()))
    assert store.load(KEY) is None
    store.save(KEY, b"binary")
    assert store.load(KEY) == b"binary"


def test_an_entry_counts_for_its_own_key_only(folder):
    store.save(OTHER, b"binary of another kernel")
    os.rename(entry_of(folder, OTHER), entry_of(folder))
    assert store.load(KEY) is None


def test_a_binary_with_a_matching_hash_of_its_own_counts_as_none(folder):
    folder.mkdir(mode=0o700)
    binary = b"half a bina"
    for magic in (b"shpy kernel 1\n", b"shpy kernel 2\n"):
        entry_of(folder).write_bytes(magic + hashlib.sha256(binary).digest() + binary)
        assert store.load(KEY) is None


def test_an_entry_of_another_user_is_not_loaded(folder, monkeypatch):
    store.save(KEY, b"binary")
    disown(entry_of(folder), monkeypatch)
    with pytest.warns(sh.ShpyWarning, match=r"shpy-kernel is no file that only this user can write"):
        assert store.load(KEY) is None


def test_an_entry_that_others_can_write_is_not_loaded(folder):
    store.save(KEY, b"binary")
    entry_of(folder).chmod(0o666)
    with pytest.warns(sh.ShpyWarning, match="no file that only this user can write"):
        assert store.load(KEY) is None


PLANTS = {
    "pipe": os.mkfifo,
    "link to an endless device": lambda path: os.symlink("/dev/zero", path),
    "link to its own entry": lambda p: (store.save(KEY, b"own"), p.rename(f"{p}~"), os.symlink(f"{p}~", p)),
    "link to itself": lambda path: os.symlink(path, path),
    "folder": os.mkdir,
    "endless file": lambda path: (path.touch(0o600), os.truncate(path, 1 << 40)),
}


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
def test_what_is_planted_under_a_key_is_neither_waited_for_nor_followed(folder, plant, monkeypatch):
    monkeypatch.setattr(store, "_LARGEST", 1 << 20)
    store.save(OTHER, b"binary")
    plant(entry_of(folder))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert store.load(KEY) is None
        store.save(KEY, b"binary")
    replaceable = not entry_of(folder).is_dir()
    assert store.load(KEY) == (b"binary" if replaceable else None)
    assert store.load(OTHER) == b"binary"


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o1777])
def test_a_folder_that_others_can_write_is_not_used(folder, mode):
    folder.mkdir(mode=0o700)
    store.save(KEY, b"binary")
    folder.chmod(mode)
    before = state_of(folder)
    with pytest.warns(sh.ShpyWarning, match="kernels can be written by other users; set SHPY_CACHE_DIR") as told:
        use(times=3)
    assert [warning.filename for warning in told] == [__file__]
    assert state_of(folder) == before


def test_a_folder_of_another_user_is_not_used(folder, monkeypatch):
    store.save(KEY, b"binary")
    before = state_of(folder)
    disown(folder, monkeypatch)
    with pytest.warns(sh.ShpyWarning, match="kernels belongs to another user"):
        use()
    assert state_of(folder) == before


def test_nothing_is_used_when_this_process_is_somebody_else(folder, monkeypatch):
    store.save(KEY, b"binary")
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    with pytest.warns(sh.ShpyWarning, match="kernels belongs to another user"):
        assert store.load(KEY) is None


def test_the_folder_may_be_a_link_and_is_judged_by_what_it_links_to(folder, tmp_path):
    (tmp_path / "real").mkdir(mode=0o755)
    folder.symlink_to(tmp_path / "real")
    store.save(KEY, b"binary")
    assert store.load(KEY) == b"binary"
    (tmp_path / "real").chmod(0o1777)  # as the folder for everybody's temporary files has
    before = state_of(tmp_path / "real")
    with pytest.warns(sh.ShpyWarning, match="can be written by other users"):
        use()
    assert state_of(tmp_path / "real") == before


def test_a_link_of_another_user_is_not_followed(folder, tmp_path, monkeypatch):
    (tmp_path / "real").mkdir(mode=0o700)
    folder.symlink_to(tmp_path / "real")
    mine = os.lstat(folder)
    told = os.stat_result((*mine[:4], 12345, *mine[5:]))
    monkeypatch.setattr(type(folder), "lstat", lambda path: told)
    with pytest.warns(sh.ShpyWarning, match="belongs to another user"):
        store.save(KEY, b"binary")
    assert list((tmp_path / "real").iterdir()) == []


def test_the_files_of_the_user_stay_as_they_are(folder, monkeypatch):
    """A folder with 600 pictures, some with names like ours: none goes, and the mode stays."""
    monkeypatch.setattr(store, "_MOST", 3)
    folder.mkdir()
    folder.chmod(0o755)
    names = [*(f"picture-{k}.png" for k in range(600)), ".new-abc", ".new-0123456789abcdef", "0" * 64]
    names += [".new-0123456789abcdef.shpy-kernel", *(f"{k:064x}.shpy-kernel" for k in range(6))]
    for name in names:
        (folder / name).write_bytes(b"the user's own")
        os.utime(folder / name, (1, 1))
    before = state_of(folder)
    for key in (KEY, OTHER):
        store.save(key, b"binary")
    mode, files = state_of(folder)
    assert mode == 0o755
    assert {name: files[name] for name in names} == before[1]
    assert set(files) - set(names) <= {f"{KEY}.shpy-kernel", f"{OTHER}.shpy-kernel"}


def test_entries_used_longest_ago_go_first(folder, monkeypatch):
    monkeypatch.setattr(store, "_MOST", 3)
    keys = [store.key(letter) for letter in "abcde"]
    for age, key in enumerate(keys[:3]):
        store.save(key, b"binary")
        os.utime(entry_of(folder, key), (age, age))
    assert store.load(keys[0]) == b"binary"  # now used last
    for key in keys[3:]:
        store.save(key, b"binary")
    assert [entry_of(folder, key).exists() for key in keys] == [True, False, False, True, True]


def test_entries_dated_in_the_future_go_first(folder, monkeypatch):
    monkeypatch.setattr(store, "_MOST", 3)
    keys = [store.key(letter) for letter in "abcdefg"]
    for key in keys[:3]:
        store.save(key, b"binary")
        os.utime(entry_of(folder, key), (time.time() + 1e6,) * 2)
    assert store.load(keys[1]) == b"binary"  # which dates it anew
    for key in keys[3:5]:
        store.save(key, b"binary")
    assert [entry_of(folder, key).exists() for key in keys[:5]] == [False, True, False, True, True]
    temporary = folder / f".new-{'a' * 16}.shpy-kernel"
    temporary.write_bytes(b"")
    os.utime(temporary, (time.time() + 1e6,) * 2)
    store.save(keys[5], b"binary")
    assert not temporary.exists()


def test_a_full_folder_is_not_read_at_each_compilation(folder, monkeypatch):
    monkeypatch.setattr(store, "_MOST", 20)
    read, real = [], store._read

    def counted(folder, name, most):
        read.append(name)
        return real(folder, name, most)

    keys = [store.key(str(k)) for k in range(25)]
    for age, key in enumerate(keys[:20]):
        store.save(key, b"binary")
        os.utime(entry_of(folder, key), (age, age))
    monkeypatch.setattr(store, "_read", counted)
    for key in keys[20:]:
        store.save(key, b"binary")
    assert read == [f"{key}.shpy-kernel" for key in keys[:5]]
    assert len(list(folder.iterdir())) == 20


@pytest.mark.parametrize("left", [b"", b"shpy ker", b"shpy kernel 2\nand half a binary"])
def test_what_killed_writers_left_goes_after_an_hour(folder, left):
    folder.mkdir(mode=0o700)
    old, young = (folder / f".new-{digit * 16}.shpy-kernel" for digit in "ab")
    for path in (old, young):
        path.write_bytes(left)
    os.utime(old, (time.time() - 4000,) * 2)
    store.save(KEY, b"binary")
    assert not old.exists()
    assert young.exists()


def test_a_full_disk_is_told_and_leaves_nothing(folder, monkeypatch):
    folder.mkdir(mode=0o700)

    def fail(*args, **named):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.warns(sh.ShpyWarning, match=r"not be written to .*kernels \(No space left on device\)"):
        store.save(KEY, b"binary")
    assert list(folder.iterdir()) == []


def test_threads_that_keep_one_kernel_all_succeed(folder):
    faults = []

    def work():
        for _ in range(50):
            store.save(KEY, b"binary" * 1000)
            faults.extend([1] if store.load(KEY) != b"binary" * 1000 else [])

    threads = [threading.Thread(target=work) for _ in range(4)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert faults == []
    assert [e.name for e in folder.iterdir()] == [f"{KEY}.shpy-kernel"]


def test_nothing_is_kept_where_that_is_asked_for(monkeypatch, tmp_path):
    monkeypatch.setenv("SHPY_CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    store.save(KEY, b"binary")
    assert store.load(KEY) is None
    assert list(tmp_path.iterdir()) == []


def test_the_users_cache_folder_is_the_default(monkeypatch, tmp_path):
    monkeypatch.delenv("SHPY_CACHE_DIR")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    for given, place in ((str(tmp_path / "xdg"), "xdg/shpy"), ("relative", ".cache/shpy"), ("", ".cache/shpy")):
        monkeypatch.setenv("XDG_CACHE_HOME", given)
        store.save(KEY, b"binary")
        assert entry_of(tmp_path / place).exists()
    assert not (tmp_path / "relative").exists()


def test_a_tilde_is_the_home_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SHPY_CACHE_DIR", "~/kernels")
    store.save(KEY, b"binary")
    assert entry_of(tmp_path / "kernels").exists()
    assert not (tmp_path / "~").exists()
    monkeypatch.setattr(store, "_told", set())
    monkeypatch.setenv("SHPY_CACHE_DIR", "~no-such-user-of-this-machine/kernels")
    with pytest.warns(sh.ShpyWarning, match="the folder ~no-such-user-of-this-machine/kernels cannot be used"):
        store.save(KEY, b"binary")


def test_a_folder_that_cannot_be_made_is_told_once(folder, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path / "file" / "kernels"))
    with pytest.warns(sh.ShpyWarning, match=r"file/kernels cannot be used \(Not a directory\)") as told:
        use()
    assert len(told) == 1


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """A folder with what a process found out about the driver: others would compile for seconds to ask again."""
    folder = tmp_path_factory.mktemp("answers") / "kernels"
    environment = os.environ | {"SHPY_CACHE_DIR": str(folder)}
    subprocess.run([sys.executable, "-c", PROGRAM], check=True, timeout=HANGING, env=environment)
    return folder


@pytest.mark.parametrize("kept", ["0", "1"])
def test_a_binary_is_kept_where_the_driver_keeps_nothing(answers, folder, monkeypatch, tmp_path, kept):
    shutil.copytree(answers, folder)
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path / "pocl"))
    monkeypatch.setenv("POCL_KERNEL_CACHE", kept)
    command = [sys.executable, "-W", "error", "-c", f"{PROGRAM}print(*sh.backends())"]
    said = subprocess.run(command, check=True, timeout=HANGING, capture_output=True, text=True).stdout
    binaries = [entry for entry in folder.iterdir() if b"poclbin" in entry.read_bytes()]
    assert len(binaries) == (kept == "0" and "Portable Computing Language" in said)


def test_another_process_takes_the_binary_and_tells_of_a_broken_one(answers, folder, monkeypatch):
    shutil.copytree(answers, folder)
    monkeypatch.setenv("POCL_KERNEL_CACHE", "0")  # else that driver keeps its code itself

    def run(warns="error"):
        command = [sys.executable, "-W", warns, "-c", PROGRAM]
        return subprocess.run(command, check=True, timeout=HANGING, capture_output=True, text=True).stderr

    run()
    entries = list(folder.iterdir())
    assert entries
    kept = {e.name: e.read_bytes() for e in entries}
    run()
    assert {e.name: e.read_bytes() for e in folder.iterdir()} == kept
    for entry in entries:
        store.save(entry.name.split(".")[0], b"no program")
    assert "refuses the binary of an earlier process" in run(warns="default")
    assert {e.name for e in folder.iterdir()} == set(kept)
    assert all(store.load(name.split(".")[0]) != b"no program" for name in kept)


@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_a_warning_names_the_line_that_compiles(tmp_path, backend):
    """The work of GLSL is done by a thread of its own, in which no line is the user's."""
    (tmp_path / "file").write_text("")
    (tmp_path / "program.py").write_text(PROGRAM.replace("opencl", backend))
    environment = os.environ | {"SHPY_CACHE_DIR": str(tmp_path / "file"), "PYTHONWARNINGS": "default"}
    run = [sys.executable, str(tmp_path / "program.py")]
    done = subprocess.run(run, env=environment, capture_output=True, text=True, timeout=HANGING)
    assert f"{tmp_path}/program.py:6: ShpyWarning: compiled kernels are not kept" in done.stderr


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


def test_no_driver_is_asked_for_a_binary_that_is_not_kept(monkeypatch):
    """PoCL generates code again to give one."""
    monkeypatch.setenv("SHPY_CACHE_DIR", "")
    machine = machine_of(None)
    assert machine.abilities  # what was asked of the driver before is saved elsewhere
    assert machine.wrong is not None
    assert machine.binary64 is not None
    saved = []
    monkeypatch.setattr(store, "save", lambda *given: saved.append(given))

    @sh.program
    def shifted(x: sh.Attrib1f):
        return x + 123.25

    assert shifted.compile("opencl", lanes=4)(1) == 124.25
    assert saved == []


def test_names_are_asked_for_once_and_again_where_they_make_no_sense(tmp_path, monkeypatch):
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path / "kept"))
    asked = []

    def ask():
        asked.append(1)
        return {"div", "sqrt"}

    name = store.key("a driver")
    for _ in range(2):
        assert store.known_names(name, {"div", "sqrt", "mul"}, ask) == {"div", "sqrt"}
    assert len(asked) == 1
    assert store.known_names(name, {"div"}, lambda: []) == frozenset()  # what is kept is not possible any more
    assert store.known_names(name, {"div"}, ask) == frozenset()
    store.save(name, b"\xff\x00 div")
    assert store.known_names(name, {"div", "sqrt"}, ask) == {"div", "sqrt"}
