import atexit
import gc
import os
import shutil
import signal
import sys
import tempfile
import zlib
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import settings
from stress.mode import stressed

from shpy.backend.device import store
from shpy.backend.glsl.device.context import open_context
from shpy.backend.opencl.device.driver import Machine, machine_of
from shpy.backend.opencl.device.trial import DECLARES

# The same examples in each run, so that no change fails by chance; `--hypothesis-profile random` looks for new ones.
settings.register_profile("fixed", derandomize=True, deadline=None)
settings.register_profile("random", deadline=None, print_blob=True)
settings.load_profile("fixed")

pytest_plugins = ["patience"]

# The settings of the user who runs the tests are not what is tested.
# Tests name the backend that they mean; those of "auto" choose it (test_auto.py).
os.environ["SHPY_BACKEND"] = "numpy"
for setting in ("SHPY_DUMP",):
    os.environ.pop(setting, None)

# Nothing that an earlier run found out about drivers counts. The processes that the tests of one run start tell each
# other in a folder, or each would ask the drivers again; test_store.py has folders of its own.
if "SHPY_TEST_ANSWERS" not in os.environ:  # the workers of a run, and runs that tests start, have it from the first
    os.environ["SHPY_TEST_ANSWERS"] = tempfile.mkdtemp(prefix="shpy-answers-")
    atexit.register(shutil.rmtree, os.environ["SHPY_TEST_ANSWERS"], ignore_errors=True)
ANSWERS = os.environ["SHPY_CACHE_DIR"] = os.environ["SHPY_TEST_ANSWERS"]

# A slow machine is no news here; test_slow.py looks at the line.
os.environ["SHPY_QUIET"] = "1"

# A shell's background jobs ignore SIGINT, and so would every process that a test starts and interrupts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

SNAPSHOTS = Path(__file__).parent / "snapshots"

LONGEST = {
    *("test_conformance", "test_deferred", "test_documentation", "test_examples", "test_fused", "test_generated"),
    *("test_layered", "test_media", "test_queries", "test_reduce", "test_view_page"),
}
"""The files of tests that take a minute or so."""


def pytest_addoption(parser):
    parser.addoption("--update-snapshots", action="store_true", help="write the golden texts anew (never in CI)")


@pytest.hookimpl(tryfirst=True)  # before `-m` chooses
def pytest_collection_modifyitems(items):
    """Mark most cases of sampled tests as slow. The longest files run first: no worker is left alone with one.

    Of n cases one after the other, the one runs by default that has the most values of parameters that no case before
    it has; a checksum of the names decides between equals, so that each backend is that of some tests.
    """
    sampled = defaultdict(list)
    for item in items:
        if item.get_closest_marker("sampled") is not None and item.get_closest_marker("slow") is None:
            sampled[item.nodeid.partition("[")[0]].append(item)
    for cases in sampled.values():
        count, met = cases[0].get_closest_marker("sampled").args[0], set()
        for start in range(0, len(cases), count):
            group = cases[start : start + count]
            chosen = max(group, key=lambda item: (len(_values(item) - met), zlib.crc32(item.nodeid.encode())))
            met |= _values(chosen)
            for item in group:
                if item is not chosen:
                    item.add_marker(pytest.mark.slow)
    items.sort(key=lambda item: item.path.stem not in LONGEST)


def _values(item):
    """Return the parameters of a case, each with the place of its value."""
    return set(item.callspec.indices.items()) if hasattr(item, "callspec") else set()


class Snapshots:
    """Texts that the repository keeps: one that differs fails, unless `--update-snapshots` asks to write it."""

    def __init__(self, update):
        self.update = update

    def check(self, name, text):
        """Compare a text with its file under tests/snapshots."""
        path = SNAPSHOTS / name
        if self.update and not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        assert path.exists(), f"there is no snapshot {name}: run pytest --update-snapshots and read what it wrote"
        self.check_part(path, path.read_text(), text)

    def check_part(self, path, kept, text):
        """Compare a text with a part of a file, which may be all of it."""
        if self.update and text != kept:
            whole = path.read_text()
            assert whole.count(kept) == 1, f"{path.name} has this part {whole.count(kept)} times"
            path.write_text(whole.replace(kept, text))
        else:
            assert text == kept, f"{path.name} is out of date: run pytest --update-snapshots and read what it wrote"


@pytest.fixture
def snapshots(request):
    update = request.config.getoption("--update-snapshots")
    if update and os.environ.get("CI"):
        pytest.fail("snapshots are not updated in CI")
    return Snapshots(update)


@pytest.fixture
def wrong(monkeypatch):
    """Makes every device one that gets these operations wrong, beside the denormals that OpenGL's loses."""

    def pretend(*names, **limits):
        machine, context = machine_of(None), open_context(0)
        monkeypatch.setitem(machine.__dict__, "wrong", frozenset(names))
        lost = context.limits.wrong & {"denormals"}
        monkeypatch.setattr(context, "limits", replace(context.limits, wrong=lost | set(names), **limits))

    return pretend


@pytest.fixture(autouse=True, scope="module")
def _earlier_objects_stay():
    """Freeze what earlier modules left: it grows so large that each collection takes seconds."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True, scope="session")
def _functions_are_declared():
    """Fail where a text compiles with OpenCL's whole header alone: `declarations.py` lacks a function of it."""
    compiled = Machine._compiled_with_header

    def checked(machine, text, options):
        program = compiled(machine, text, options)
        assert DECLARES not in machine._succeeded, f"a function of this text is not declared:\n{text}"
        return program

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Machine, "_compiled_with_header", checked)
        yield


@pytest.fixture(autouse=True, scope="session")
def _answers_are_for_other_processes():
    """Keep nothing in the folder of this run: tests pretend in this process that drivers are wrong."""
    entry = store._entry

    def elsewhere(name):
        return None if os.environ.get("SHPY_CACHE_DIR") == ANSWERS else entry(name)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(store, "_entry", elsewhere)
        yield


@pytest.fixture(autouse="SHPY_STRESS" in os.environ)
def stress(request):
    """Run the test in the stress mode (stress/mode.py), by choices that SHPY_STRESS and the test's name repeat."""
    seed = int(os.environ.get("SHPY_STRESS", "0")) + zlib.crc32(request.node.nodeid.encode())
    if request.node.get_closest_marker("undisturbed"):
        yield None
        return
    with stressed(seed) as mode:
        yield mode


@pytest.fixture
def impatient():
    """Python changes threads as often as it can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@pytest.fixture(scope="module")
def browser():
    """Return the browser that the tests of a file share."""
    from views import chromium  # here: few files have tests of pages

    with chromium() as process:
        yield process
