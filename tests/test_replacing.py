"""Files are written whole or not at all, by any number of threads, and follow no link that somebody planted."""

import importlib
import os
import resource
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from patience import HANGING

from raytracer import Scene, SceneError
from shpy.files import check_writable, import_from, replacing


def write(path, text):
    with replacing(path) as temporary:
        temporary.write_text(text)


def test_threads_that_write_to_one_path_all_succeed(tmp_path):
    path, faults, start = tmp_path / "a.json", [], threading.Barrier(4)

    def work(text):
        start.wait()
        for _ in range(100):
            try:
                write(path, text)
            except OSError as error:
                faults.append(error)

    threads = [threading.Thread(target=work, args=(letter * 5000,)) for letter in "abcd"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert faults == []
    assert len(set(path.read_text())) == 1
    assert os.listdir(tmp_path) == ["a.json"]


def test_a_planted_name_is_neither_followed_nor_written(tmp_path, monkeypatch):
    (tmp_path / "victim").write_text("precious")
    monkeypatch.setattr("os.urandom", bytes)
    (tmp_path / ".unfinished-0000000000000000.json").symlink_to(tmp_path / "victim")
    with pytest.raises(FileExistsError):
        write(tmp_path / "a.json", "{}")
    assert (tmp_path / "victim").read_text() == "precious"


def test_a_link_stays_and_its_target_is_replaced(tmp_path):
    """As `cp` and an editor do it; a chain of links too, and one to a file that is not there yet."""
    (tmp_path / "data").mkdir()
    target = tmp_path / "data" / "real.json"
    (tmp_path / "b.json").symlink_to("data/real.json")
    (tmp_path / "a.json").symlink_to("b.json")
    for text in ("first", "second"):
        check_writable(tmp_path / "a.json")
        write(tmp_path / "a.json", text)
        assert target.read_text() == text
    assert (tmp_path / "a.json").is_symlink()
    assert (tmp_path / "b.json").is_symlink()
    assert os.listdir(tmp_path / "data") == ["real.json"]


def test_links_that_lead_nowhere(tmp_path):
    (tmp_path / "gone.json").symlink_to(tmp_path / "gone" / "a.json")
    with pytest.raises(FileNotFoundError, match=r"gone\.json cannot be written: it is a link into .*gone, which is no"):
        check_writable(tmp_path / "gone.json")
    (tmp_path / "ring.json").symlink_to(tmp_path / "ring.json")
    with pytest.raises(OSError, match=r"ring\.json cannot be written: Too many levels of symbolic links"):
        check_writable(tmp_path / "ring.json")
    with pytest.raises(OSError, match="symbolic links"):
        write(tmp_path / "ring.json", "{}")


def test_a_link_that_the_system_does_not_follow_is_not_followed(tmp_path, monkeypatch):
    """Linux refuses the links of others in a sticky folder: fs.protected_symlinks."""
    (tmp_path / "victim").write_text("precious")
    (tmp_path / "a.json").symlink_to(tmp_path / "victim")
    real = os.stat

    def guarded(path, *args, follow_symlinks=True, **more):
        if follow_symlinks and os.path.basename(path) == "a.json":
            raise PermissionError(13, "Permission denied")
        return real(path, *args, follow_symlinks=follow_symlinks, **more)

    monkeypatch.setattr(os, "stat", guarded)
    with pytest.raises(PermissionError):
        write(tmp_path / "a.json", "{}")
    assert (tmp_path / "victim").read_text() == "precious"


def test_what_is_no_regular_file_is_not_replaced(tmp_path):
    """A device such as /dev/null, by its name or by a link, and a pipe."""
    os.mkfifo(tmp_path / "pipe.json")
    (tmp_path / "null.json").symlink_to("/dev/null")
    for name in ("pipe.json", "null.json"):
        with pytest.raises(OSError, match=rf"{name} cannot be written: it is no regular file"):
            check_writable(tmp_path / name)
        with pytest.raises(OSError, match="it is no regular file"):
            write(tmp_path / name, "{}")
    assert (tmp_path / "pipe.json").is_fifo()


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o666, 0o755])
def test_a_file_that_is_replaced_keeps_its_mode(tmp_path, mode):
    """While it is written too: a private picture is nowhere readable for others."""
    path = tmp_path / "a.json"
    path.write_text("old")
    path.chmod(mode)
    (tmp_path / "link.json").symlink_to(path)
    for name in ("a.json", "link.json"):
        with replacing(tmp_path / name) as temporary:
            assert temporary.stat().st_mode & 0o777 == mode
            temporary.write_text(name)
        assert (path.read_text(), path.stat().st_mode & 0o777) == (name, mode)


def test_a_file_that_may_not_be_written_is_told(tmp_path, monkeypatch):
    path = tmp_path / "a.json"
    path.write_text("old")
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # root may write what nobody else may
    with pytest.raises(PermissionError, match=r"a\.json cannot be written: its mode does not allow it"):
        check_writable(path)
    with pytest.raises(PermissionError):
        write(path, "{}")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.json"]


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_files_get_the_mode_that_the_umask_leaves(tmp_path, umask, mode):
    before = os.umask(umask)
    try:
        write(tmp_path / "a.json", "{}")
    finally:
        os.umask(before)
    assert (tmp_path / "a.json").stat().st_mode & 0o777 == mode


def test_what_killed_processes_left_goes_after_a_day_and_nothing_else_does(tmp_path):
    names = [".unfinished-0123456789abcdef.png", ".unfinished-abcdef0123456789", ".unfinished-holiday.png", ".old.png"]
    for name in names:
        (tmp_path / name).write_text("")
        os.utime(tmp_path / name, (time.time() - 90_000,) * 2)
    young = ".unfinished-ffffffffffffffff.png"
    (tmp_path / young).write_text("")
    write(tmp_path / "a.json", "{}")
    assert sorted(os.listdir(tmp_path)) == sorted(["a.json", young, *names[2:]])


def test_paths_are_checked_before_the_work(tmp_path):
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "file").write_text("")
    with pytest.raises(FileNotFoundError, match=r"there is no folder .*gone"):
        check_writable(tmp_path / "gone" / "a.png")
    with pytest.raises(FileNotFoundError, match=r"there is no folder .*file"):
        check_writable(tmp_path / "file" / "a.png")
    with pytest.raises(IsADirectoryError, match=r"folder\.png is a folder"):
        check_writable(tmp_path / "folder.png")
    check_writable(tmp_path / "a.png")
    assert sorted(os.listdir(tmp_path)) == ["file", "folder.png"]


def test_a_folder_that_cannot_be_written_is_told(tmp_path, monkeypatch):
    def fail(*args):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", fail)
    with pytest.raises(PermissionError, match=r"a\.png cannot be written: Permission denied"):
        check_writable(tmp_path / "a.png")


@pytest.mark.parametrize("name", ["a\0.png", "a\ud800.png"])
def test_names_that_no_file_can_have_are_an_os_error(tmp_path, name):
    with pytest.raises(OSError, match="no file can have the name"):
        check_writable(tmp_path / name)
    with pytest.raises(OSError, match="no file can have the name"), replacing(tmp_path / name):
        pass
    assert os.listdir(tmp_path) == []


def test_a_mesh_file_larger_than_memory_is_a_scene_error(tmp_path, monkeypatch):
    path = tmp_path / "large.obj"
    path.write_text("v 0 0 0")

    def read_bytes(path):
        raise MemoryError

    monkeypatch.setattr(Path, "read_bytes", read_bytes)
    with pytest.raises(SceneError, match=r"large\.obj: 0\.0 GiB are more than the memory holds"):
        Scene.load(path)


SAVING = """
import resource, sys
import numpy as np
from raytracer.image import Image
shape = (400, 400)
noise = np.random.default_rng(0).random((*shape, 3), dtype=np.float32)
layer, number = np.ones(shape, np.float32), np.ones(shape, np.int32)
image = Image(noise, layer, noise, number, number, None)
resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
try:
    image.save(sys.argv[1])
except OSError as error:
    print("told:", error)
"""


@pytest.mark.sampled(3)
@pytest.mark.parametrize("ending", ["png", "exr", "npy"])
def test_a_disk_that_is_full_is_an_os_error_and_leaves_the_old_picture(tmp_path, ending):
    assert resource.RLIMIT_FSIZE  # a limit on the size of files stands for the full disk
    path = tmp_path / f"a.{ending}"
    path.write_text("the old picture")
    done = subprocess.run([sys.executable, "-c", SAVING, path], capture_output=True, text=True, timeout=HANGING)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("told: ")
    assert path.read_text() == "the old picture"
    assert os.listdir(tmp_path) == [path.name]


def test_modules_of_a_folder_are_imported_before_others(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", sys.path[:])
    for folder, number in ((tmp_path / "one", 1), (tmp_path / "other", 2)):
        folder.mkdir()
        (folder / f"beside_{number}.py").write_text(f"NUMBER = {number}")
        import_from(folder)
        import_from(str(folder))
        assert importlib.import_module(f"beside_{number}").NUMBER == number
        assert (sys.path[0], sys.path.count(str(folder))) == (str(folder), 1)
