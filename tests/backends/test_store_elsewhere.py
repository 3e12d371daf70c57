"""Systems without the functions of POSIX that the store takes, such as Windows: nothing is kept, and all else runs."""

import os
import subprocess
import sys
import warnings

import pytest
from patience import HANGING

import shpy as sh
from shpy.backend.device import store

HIDING = """
import os, sys, warnings
names = sys.argv[1:]
for name in names:
    if name == "dir_fd":
        os.supports_dir_fd.discard(os.open)
    elif name == "fd":
        os.supports_fd.discard(os.listdir)
    else:
        delattr(os, name)
warnings.simplefilter("always")
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    import shpy as sh
    for backend in ("opencl", "glsl"):
        for k in (2, 3):
            assert sh.program(lambda: sh.Attrib1f(k) * 5).compile(backend)() == 5 * k
told = [str(w.message) for w in said if "kept" in str(w.message)]
assert len(told) == 1, told
print(told[0])
"""


POSIX = ("O_DIRECTORY", "O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "geteuid", "dir_fd")


@pytest.mark.parametrize("names", [POSIX, ("fd",)])
def test_a_system_without_these_functions_goes_on_without_the_store(names, tmp_path):
    """As on Windows: every backend runs, and one warning says that nothing is kept."""
    root = os.path.dirname(os.path.dirname(sh.__file__))
    environment = os.environ | {"SHPY_CACHE_DIR": str(tmp_path / "kernels"), "PYTHONPATH": root}
    done = subprocess.run(
        [sys.executable, "-c", HIDING, *names], env=environment, text=True, capture_output=True, timeout=HANGING
    )
    assert done.returncode == 0, done.stderr
    assert "which Python lacks on this system; set SHPY_CACHE_DIR to nothing if none are to be kept" in done.stdout
    assert not (tmp_path / "kernels").exists()


@pytest.mark.parametrize("name", [*store._NEEDED, "open", "stat", "unlink", "rename", "utime", "listdir"])
def test_each_function_that_is_missing_is_named_once(name, tmp_path, monkeypatch):
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path / "kernels"))
    monkeypatch.setattr(store, "_told", set())
    if name in store._NEEDED:
        monkeypatch.delattr(os, name)
    elif name == "listdir":
        monkeypatch.setattr(os, "supports_fd", os.supports_fd - {os.listdir})
    else:
        monkeypatch.setattr(os, "supports_dir_fd", os.supports_dir_fd - {getattr(os, name)})
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        for _ in range(2):
            store.save(store.key("text"), b"binary")
            assert store.load(store.key("text")) is None
            assert not store.is_open()
    assert [name in str(warning.message) for warning in told] == [True]
