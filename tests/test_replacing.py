"""Files are written whole or not at all, by any number of threads, and follow no link that somebody planted."""

import os
import resource
import subprocess
import sys
import threading
import time

import pytest

from shpy.files import check_writable, replacing


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
    monkeypatch.setattr("secrets.token_hex", lambda n: "0" * 16)
    (tmp_path / ".unfinished-0000000000000000.json").symlink_to(tmp_path / "victim")
    with pytest.raises(FileExistsError):
        write(tmp_path / "a.json", "{}")
    assert (tmp_path / "victim").read_text() == "precious"


def test_a_link_is_replaced_and_its_target_stays(tmp_path):
    (tmp_path / "victim").write_text("precious")
    (tmp_path / "a.json").symlink_to(tmp_path / "victim")
    write(tmp_path / "a.json", "{}")
    assert (tmp_path / "victim").read_text() == "precious"
    assert (tmp_path / "a.json").read_text() == "{}"


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


@pytest.mark.parametrize("ending", ["png", "exr", "npy"])
def test_a_disk_that_is_full_is_an_os_error_and_leaves_the_old_picture(tmp_path, ending):
    assert resource.RLIMIT_FSIZE  # a limit on the size of files stands for the full disk
    path = tmp_path / f"a.{ending}"
    path.write_text("the old picture")
    done = subprocess.run([sys.executable, "-c", SAVING, path], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("told: ")
    assert path.read_text() == "the old picture"
    assert os.listdir(tmp_path) == [path.name]
