"""Large kernels are built without the driver's optimization, and once more, optimized, when that has paid."""

import os
import subprocess
import sys
import threading

import numpy as np
import pytest
from patience import HANGING
from stress.interrupts import hears_nothing
from test_auto import EAGER

import raytracer as rt
import shpy as sh
from shpy.backend.device.pace import Watch
from shpy.backend.opencl.device import building
from shpy.backend.opencl.device.driver import Machine
from shpy.backend.opencl.device.run import HURRIED, OpenCLExecutable
from shpy.run import kernel as kernels, tiers

pytestmark = pytest.mark.undisturbed

X = np.linspace(-3, 3, 5000, dtype=np.float32)


SCALE = sh.Param(sh.Attrib1f, 1.5)


@sh.program
def curve(x: sh.Attrib1f) -> sh.Attrib1f:
    return sh.sin(x * SCALE) / (1 + x * x)


def by_numpy(x, scale=1.5):
    SCALE.value = scale
    return curve.compile("numpy")(x)


@pytest.fixture
def hurried(monkeypatch):
    """Return a kernel that is built in a hurry; `pays(True)` lets the optimized build pay from then on."""
    answer = [False]
    monkeypatch.setenv("SHPY_CACHE_DIR", "")
    monkeypatch.setattr(building, "LARGE", 1)
    monkeypatch.setattr(Watch, "pays", property(lambda self: self.watches and answer[0]))
    monkeypatch.setattr(kernels, "_executables", {})
    monkeypatch.setattr(Machine, "hurries", True)

    def pays(value):
        answer[0] = value

    return sh.Program(curve.recorded).compile("opencl"), pays


def test_a_better_build_pays_once_the_runs_and_the_rest_of_one_take_as_long():
    now = [0.0]
    watch = Watch(0.5, lambda: now[0], bounded=True, worth=1.0)

    def dispatch(first, count):
        assert not watch.pays, "the last dispatch was to be the first that tells"
        now[0] += 0.01 * count

    watch.driver(40, dispatch, lambda _: None, 1, reads=True)()
    assert not watch.pays
    assert not watch.fits(1)
    assert not watch.is_brief(1)
    long = watch.driver(
        1000, lambda first, count: now.__setitem__(0, now[0] + 0.01 * count), lambda _: None, 1, reads=True
    )
    for _ in range(2):
        long()
    assert watch.pays
    watch.end()
    assert not watch.pays


def test_quarters_that_earlier_processes_spent_count():
    now, told = [0.0], []

    def run(watch, seconds):
        watch.driver(1, lambda *_: now.__setitem__(0, now[0] + seconds), lambda _: None, 1, reads=True)()

    first = Watch(0.5, lambda: now[0], bounded=True, worth=1.0, tell=told.append)
    for seconds in (0.2, 0.2, 0.2):
        run(first, seconds)
    assert told == [1, 2]
    second = Watch(0.5, lambda: now[0], bounded=True, worth=1.0, quarters=2, tell=told.append)
    assert not second.pays
    run(second, 0.3)
    assert told == [1, 2, 3]
    run(second, 0.3)
    assert second.pays
    assert told == [1, 2, 3]


def test_both_builds_give_the_same_bits_and_the_second_takes_over(hurried):
    kernel, pays = hurried
    few, many = X[:60], np.tile(X, 4)  # few are copied, and many are used where they lie
    for scale, second in ((1.5, False), (2.5, False), (2.5, True), (0.5, True)):
        expected = [by_numpy(x, scale) for x in (few, many)]
        pays(second)
        for x, y in zip((few, many), expected, strict=True):
            np.testing.assert_array_equal(kernel(x), y)
        assert (HURRIED in kernel.notes) is not second


def test_a_run_that_begins_with_the_first_build_ends_with_the_second(hurried, monkeypatch):
    kernel, pays = hurried
    expected = by_numpy(X)

    def parts(self, rows, width=1, least=1):
        yield 0, 1
        pays(True)
        yield 1, rows - 1

    monkeypatch.setattr(Watch, "parts", parts)
    np.testing.assert_array_equal(kernel(X), expected)
    assert HURRIED not in kernel.notes


def test_runs_that_are_bound_before_take_the_second_build_too(hurried):
    kernel, pays = hurried
    expected = X
    for _ in range(6):
        expected = by_numpy(expected)
    step, repeated = sh.repeat(kernel, 1), sh.repeat(kernel, 6)
    for second in (False, True, True):
        pays(second)
        np.testing.assert_array_equal(repeated.run(x=X).streams["x"].numpy(), expected)
    np.testing.assert_array_equal(step.run(x=X).streams["x"].numpy(), by_numpy(X))
    np.testing.assert_array_equal(kernel(sh.Stream(X, sh.Attrib1f, "opencl")).numpy(), by_numpy(X))


@sh.program
def smooth(u: sh.Table[sh.Attrib1f, 2]) -> sh.Attrib1f:
    i = sh.grid_index(2)
    return SCALE * (u[i + (0, 1)] + u[i - (0, 1)] + u[i + (1, 0)] + u[i - (1, 0)])


def test_a_stencil_begins_a_run_with_the_first_build_and_ends_it_with_the_second(hurried, monkeypatch):
    """Its work items compute the packets of a line each, of which the last ones may be few."""
    _, pays = hurried
    SCALE.value = 0.3
    for shape in ((33, 700), (200, 1030), (70, 1100)):
        kernel = sh.Program(smooth.recorded).compile("opencl")
        assert kernel._executable.kernel.packets > 1
        u = np.random.default_rng(0).random(shape, np.float32)
        expected = smooth.compile("numpy")(u, shape=shape)

        def parts(self, rows, width=1, least=1):
            for first in range(0, rows, 2):
                yield first, min(2, rows - first)
                pays(first > rows // 3)

        pays(False)
        with monkeypatch.context() as patched:
            patched.setattr(Watch, "parts", parts)
            np.testing.assert_array_equal(kernel(u, shape=shape), expected)
        assert HURRIED not in kernel.notes
        np.testing.assert_array_equal(kernel(sh.Stream(u, sh.Attrib1f, "opencl"), shape=shape).numpy(), expected)


def test_streams_that_share_the_kernel_object_take_the_second_build_too(hurried):
    kernel, pays = hurried
    many = np.tile(X, 4)
    for scale, second in ((1.5, False), (2.5, True), (0.5, True)):
        expected = [by_numpy(x, scale) for x in (X, many)]
        pays(second)
        for x, y in zip((X, many, X), (*expected, expected[0]), strict=True):
            np.testing.assert_array_equal(kernel(sh.Stream(x, sh.Attrib1f, "opencl")).numpy(), y)
        assert (HURRIED in kernel.notes) is not second


@pytest.mark.parametrize(
    "error", [lambda machine: machine.cl.Error("out of memory"), lambda machine: sh.BackendUnavailable("disk is full")]
)
def test_a_refused_second_build_leaves_the_first(hurried, monkeypatch, error):
    kernel, pays = hurried
    expected = by_numpy(X)

    def refuse(self, *args, **options):
        raise error(self)

    monkeypatch.setattr(Machine, "build", refuse)
    pays(True)
    with pytest.warns(
        sh.ShpyWarning, match="curve stays slower than it could be on OpenCL: the driver does not optimize"
    ):
        np.testing.assert_array_equal(kernel(X), expected)
    np.testing.assert_array_equal(kernel(X), expected)


def test_a_text_that_was_optimized_before_is_optimized_at_once(hurried, monkeypatch, tmp_path):
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path))
    kernel, pays = hurried
    pays(True)
    kernel(X)
    monkeypatch.setattr(kernels, "_executables", {})
    assert HURRIED not in sh.Program(curve.recorded).compile("opencl").notes


def test_other_modes_are_optimized_at_once(hurried):
    assert HURRIED in sh.Program(curve.recorded).compile("opencl", math="portable").notes
    assert HURRIED not in sh.Program(curve.recorded).compile("opencl", math="relaxed").notes


@pytest.mark.usefixtures("hurried")
def test_a_script_that_is_run_again_comes_to_the_second_build(monkeypatch, tmp_path):
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path))
    for quarters in (1, 2, 3):
        watch = sh.Program(curve.recorded).compile("opencl")._executable.pace
        assert watch._quarters == quarters - 1
        watch._tell(quarters)
        monkeypatch.setattr(kernels, "_executables", {})


def test_threads_share_a_kernel_that_is_replaced(hurried):
    kernel, pays = hurried
    expected, answers = by_numpy(X), []

    def call():
        for _ in range(6):
            answers.append(kernel(X))

    threads = [threading.Thread(target=call) for _ in range(8)]
    for at, thread in enumerate(threads):
        thread.start()
        pays(at > 2)
    for thread in threads:
        thread.join()
    assert len(answers) == 48
    for answer in answers:
        np.testing.assert_array_equal(answer, expected)
    assert HURRIED not in kernel.notes


class Interrupts:
    """A trace function that raises KeyboardInterrupt at a line of the second build's own, the `at`-th."""

    WATCHED = (OpenCLExecutable._renew, OpenCLExecutable._launched, Watch.end, building._optimized, Machine.build)

    def __init__(self, at):
        self.left, self.codes = at, {function.__code__ for function in self.WATCHED}

    def __call__(self, frame, event, _):
        if frame.f_code not in self.codes:
            return None
        entered = set()

        def follow(frame, event, _):
            if event == "line" and not hears_nothing(frame, entered):
                self.left -= 1
                if self.left == 0:
                    raise KeyboardInterrupt
            return follow

        return follow


def test_ctrl_c_at_any_line_of_the_second_build(hurried, monkeypatch):
    """The next call, of another thread, makes the build again; then the kernel is one like others."""
    kernel, pays = hurried
    expected, few = by_numpy(X), by_numpy(X[:60])
    pays(True)
    kernel(X)
    optimized = kernel._executable.program  # the driver need not build it again
    for at in range(1, 1000):
        monkeypatch.setattr(kernels, "_executables", {})
        kernel, interrupts = sh.Program(curve.recorded).compile("opencl"), Interrupts(at)
        assert HURRIED in kernel.notes
        sys.settrace(interrupts)
        try:
            kernel(X if at % 2 else X[:60])
        except KeyboardInterrupt:
            pass
        finally:
            sys.settrace(None)
        if interrupts.left > 0:
            break
        answers = []
        thread = threading.Thread(target=lambda: answers.extend((kernel(X), kernel(X[:60]))))  # noqa: B023
        thread.start()
        thread.join()
        np.testing.assert_array_equal(answers[0], expected)
        np.testing.assert_array_equal(answers[1], few)
        assert HURRIED not in kernel.notes, at
        assert kernel._executable.program is optimized
        assert not kernel._executable.pace.watches
    assert at > 25


def test_a_run_that_is_bound_while_another_thread_replaces_the_program_is_of_the_second(hurried, monkeypatch):
    kernel, pays = hurried
    executable, make, programs = kernel._executable, OpenCLExecutable._spare_kernel, []

    def renewed_meanwhile(self, *args):
        compiled = make(self, *args)
        if HURRIED in kernel.notes:
            pays(True)
            kernel(X[:60])
        return compiled

    cl = executable.machine.cl
    enqueue = cl.enqueue_nd_range_kernel

    def program_of(compiled):
        return compiled.get_info(cl.kernel_info.PROGRAM).int_ptr

    def noted(queue, compiled, *args):
        programs.append(program_of(compiled))
        return enqueue(queue, compiled, *args)

    monkeypatch.setattr(OpenCLExecutable, "_spare_kernel", renewed_meanwhile)
    monkeypatch.setattr(cl, "enqueue_nd_range_kernel", noted)
    chain = sh.repeat(kernel, 3)
    chain.run(x=X)
    np.testing.assert_array_equal(chain.run(x=X).streams["x"].numpy(), by_numpy(by_numpy(by_numpy(X))))
    assert programs[-1] == program_of(executable.compiled)


@pytest.fixture
def eager(monkeypatch):
    monkeypatch.setenv("SHPY_BACKEND", "auto")
    for name, value in EAGER.items():
        monkeypatch.setattr(tiers, name, value)


@pytest.mark.usefixtures("eager")
def test_auto_goes_on_with_a_hurried_build_and_then_with_the_second(hurried):
    _, pays = hurried
    many = np.tile(X, 14)
    expected, kernel = by_numpy(many), sh.Program(curve.recorded).compile("auto")
    for second in (False, False, True, True):
        pays(second)
        np.testing.assert_array_equal(kernel(many), expected)
        assert kernel.runs_on == "opencl"
        assert (HURRIED in kernel.notes) is not second


@pytest.mark.usefixtures("eager")
def test_auto_compares_numpy_with_the_optimized_build(hurried, monkeypatch):
    _, pays = hurried
    monkeypatch.setattr(tiers, "_TRIED", 2)
    kernel, many = sh.Program(curve.recorded).compile("auto"), np.tile(X, 14)
    kernel(many)
    kernel._executable._seconds = 1e-9  # of numpy: any build takes longer
    for _ in range(4):
        kernel(many)
    assert kernel.runs_on == "opencl"
    pays(True)
    for _ in range(3):
        kernel(many)
    assert (kernel.runs_on, kernel.notes[-1]) == ("numpy", "runs on numpy: opencl is slower here")


DISTURBED = """
import os, signal, sys, threading, numpy as np, shpy as sh
from shpy.backend.device.pace import Watch
from shpy.backend.opencl.device import building
from shpy.backend.opencl.device.driver import Machine
from shpy.backend.opencl.device.run import HURRIED
pays, inside, goes_on, build = [False], threading.Event(), threading.Event(), Machine.build
building.LARGE, Machine.hurries = 1, True
Watch.pays = property(lambda watch: watch.watches and pays[0])

@sh.program
def f(x: sh.Attrib1f):
    return sh.sin(x) * 3

x = np.linspace(0, 1, 100_000, dtype=np.float32)
numpy, kernel = f.compile("numpy"), f.compile("opencl")
expected = numpy(x)
same = lambda kernel: np.array_equal(kernel(x), expected)
assert same(kernel) and HURRIED in kernel.notes

def interrupted(machine, *args, **options):
    os.kill(os.getpid(), signal.SIGINT)
    return build(machine, *args, **options)

Machine.build, pays[0] = interrupted, True
try:
    kernel(x)
    print("not interrupted")
except KeyboardInterrupt:
    print("interrupted", HURRIED in kernel.notes)

def lasting(machine, *args, **options):
    inside.set()
    goes_on.wait()
    return build(machine, *args, **options)

Machine.build = lasting
thread = threading.Thread(target=kernel, args=[x])
thread.start()
inside.wait()
child = os.fork()
if not child:
    signal.alarm(30)
    try:
        kernel(x)
    except sh.BackendUnavailable as error:
        sys.exit(7 if same(numpy) and "forked" in str(error) else 1)
    sys.exit(2)
print("child", os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
goes_on.set()
thread.join()
print("at last", same(kernel), HURRIED in kernel.notes)
"""


def test_ctrl_c_and_forks_during_the_second_build():
    ran = subprocess.run(
        [sys.executable, "-c", DISTURBED],
        env={**os.environ, "SHPY_CACHE_DIR": ""},
        capture_output=True,
        text=True,
        timeout=HANGING,
        check=False,
    )
    assert (ran.stdout, ran.stderr) == ("interrupted True\nchild 7\nat last True False\n", "")


def test_a_scene_has_the_same_picture_with_both_builds(monkeypatch):
    monkeypatch.setenv("SHPY_CACHE_DIR", "")
    monkeypatch.setattr(Machine, "hurries", True)
    scene = rt.Scene.builtin("boxes")
    renderer = rt.Renderer(scene, backend="opencl")
    first = renderer.render((32, 24))
    assert HURRIED in renderer.kernel.notes
    monkeypatch.setattr(Watch, "pays", property(lambda self: self.watches))
    second = renderer.render((32, 24))
    assert HURRIED not in renderer.kernel.notes
    np.testing.assert_array_equal(first.pixels, second.pixels)
