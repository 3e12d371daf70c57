import atexit
import fcntl
import gc
import os
import shutil
import signal
import sys
import tempfile
import zlib
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from _pytest.mark import deselect_by_keyword
from hypothesis import settings
from stress.mode import stressed

from shpy.backend.device import store
from shpy.backend.glsl.device.context import _opened, open_context
from shpy.backend.opencl.device.building import backend as opencl
from shpy.backend.opencl.device.driver import Machine, _listed, machine_of
from shpy.backend.opencl.device.trial import DECLARES
from shpy.errors import BackendUnavailable

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
    *("test_conformance", "test_documentation", "test_view_page", "test_generated", "test_examples", "test_path"),
    *("test_queries", "test_instances", "test_metallic_roughness", "test_layered", "test_reduce", "test_benchmarks"),
    *("test_goldens", "test_packet_walk", "test_media", "test_moving", "test_surfaces", "test_render"),
    *("test_continued", "test_processes", "test_view_server", "test_scene_page", "test_checkers", "test_equivalence"),
    *("test_chain_pages", "test_divergence", "test_golden"),
}
"""The files of tests that take a quarter of a minute or more, and those of ten seconds that would be the last."""


def pytest_addoption(parser):
    parser.addoption("--update-snapshots", action="store_true", help="write the golden texts anew (never in CI)")


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect tests without looking for garbage, which took a tenth of the time.

    Modules of tests open no driver: where there is none, their tests fail, and all others run.
    """
    gc.disable()
    try:
        result = yield
    finally:
        gc.enable()
    if len(_listed) or len(_opened):
        raise pytest.UsageError("a module of tests opens a driver as it is imported: open it in a test or a fixture")
    return result


@pytest.hookimpl(wrapper=True)
def pytest_generate_tests(metafunc):
    """Mark most cases of sampled tests as slow, and make none that `-m "not slow"` would leave out.

    Of n cases one after the other, the one runs by default that has the most values of parameters that no case before
    it has; a checksum of the names decides between equals, so that each backend is that of some tests.

    Of 18,470 cases, each process of a run made 8,333 and dropped them.
    """
    result = yield
    cases, test = metafunc._calls, metafunc.definition
    sample, slow = test.get_closest_marker("sampled"), test.get_closest_marker("slow")
    if sample is not None and slow is None:
        chosen = _sample([case for case in cases if not _is_slow(case)], sample.args[0], test.nodeid)
        for case in cases:
            if id(case) not in chosen and not _is_slow(case):
                case.marks.append(pytest.mark.slow.mark)
    if metafunc.config.option.markexpr == "not slow" and not _names_tests(metafunc.config):
        # The first case stays, slow or not: without any, pytest would make an item without parameters.
        cases[1:] = [case for case in cases[1:] if slow is None and not _is_slow(case)]
    return result


def _names_tests(config):
    """Return whether the command line names tests, and not files alone."""
    return bool(config.option.keyword) or any("::" in name for name in config.args)


def _is_slow(case):
    return any(mark.name == "slow" for mark in case.marks)


def _sample(cases, count, test):
    """Return the ids of one of each `count` cases of a test."""
    chosen, met = set(), set()
    for start in range(0, len(cases), count):
        group = {id(case): case for case in cases[start : start + count]}
        values = {key: {(name, id(value)) for name, value in case.params.items()} for key, case in group.items()}
        names = {key: f"{test}[{case.id}]" for key, case in group.items()}
        best = max(group, key=lambda key: (len(values[key] - met), zlib.crc32(names[key].encode())))
        chosen.add(best)
        met |= values[best]
    return chosen


def pytest_sessionfinish():
    """Spare each process two searches through all tests for garbage, which took 1.4 seconds."""
    gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Run the longest files first: no worker is left alone with one. Slow tests run where no others are named."""
    items.sort(key=lambda item: item.path.stem not in LONGEST)
    if config.option.markexpr == "not slow" and _names_tests(config):
        deselect_by_keyword(items, config)
        if all(item.get_closest_marker("slow") for item in items):
            config.option.markexpr = ""


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
    """Keep nothing in the folder of this run: tests pretend in this process that drivers are wrong.

    Of the processes of a whole run, the first one asks drivers before its first test, and the others read its answers.
    """
    if "PYTEST_XDIST_WORKER" in os.environ:
        with open(Path(ANSWERS) / "asking", "w") as file, suppress(BackendUnavailable):
            fcntl.flock(file, fcntl.LOCK_EX)
            machine, _ = machine_of(None), open_context(0)
            _ = machine.abilities, machine.binary64, machine.most_private
    entry = store._entry

    def elsewhere(name):
        return None if os.environ.get("SHPY_CACHE_DIR") == ANSWERS else entry(name)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(store, "_entry", elsewhere)
        yield


ONE_LANE = {
    *("accuracy", "chains", "cluster", "gradients", "library", "raytracer", "record", "streams", "stress", "testing"),
    *("test_conformance_runs", "test_documentation", "test_examples", "test_auto", "test_auto_tiles", "test_zeros"),
}
"""Folders and files of tests of what programs mean, whatever their packets: OpenCL's widths have tests of their own."""

PACKETS = {"test_render", "test_path", "test_instances", "test_packet_walk"}
"""Files of these folders whose pictures, paths, instances and walks run in packets all the same."""


@pytest.fixture(autouse=True, scope="module")
def _one_lane(request):
    """Compile for OpenCL as for a GPU, one element a work item, unless a test names a width or runs with slow ones.

    A driver compiles that in a third of the time: the tests of tables' gradients and of chains took 26.9 CPU seconds,
    and take 18.1.
    """
    file = request.path.stem
    among = bool({file, request.path.parent.name} & ONE_LANE) and file not in PACKETS
    if not among or request.config.option.markexpr != "not slow":
        yield
        return
    compile_for, kind = opencl.compile, type(opencl)

    def compile_one(_, module, options, *rest):
        return compile_for(module, replace(options, lanes=1) if options.lanes == "auto" else options, *rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kind, "compile", compile_one)
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
