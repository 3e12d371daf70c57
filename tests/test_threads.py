"""Several threads record, compile and run at once: each gets what it would get alone, lines of errors included."""

import ast
import gc
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

import shpy as sh
from shpy import SH_ELSE, SH_FOR, SH_IF, SH_RETURN
from shpy.backend.base import Device, Options
from shpy.parsing import parse
from shpy.run import kernel

THREADS = 6


def at_once(*works):
    """Run each work in a thread of its own, all starting together; gives the errors that they raised."""
    errors, start = [], threading.Barrier(len(works))

    def run(work):
        start.wait()
        try:
            work()
        except Exception as error:
            errors.append(error)

    threads = [threading.Thread(target=run, args=(work,)) for work in works]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return errors


def test_threads_parse_at_once(impatient):
    """With a callback of the garbage collector CPython 3.11 changes threads within `ast.parse`, and loses its count."""
    text = "\n".join(f"def f{i}(x):\n    return x * {i} + (x - 2) ** 3" for i in range(60))
    wanted = ast.dump(ast.parse(text))
    wrong = []

    def run():
        for _ in range(20):
            wrong.extend(["another tree"] * (ast.dump(parse(text)) != wanted))

    look = lambda phase, info: None  # noqa: E731
    gc.callbacks.append(look)
    try:
        assert at_once(*[run] * 8) == []
    finally:
        gc.callbacks.remove(look)
    assert wrong == []


@sh.subroutine
def falloff(x, steps):
    total = sh.Attrib1f(0)
    with SH_FOR(0, steps) as i:
        total += x / (1 + sh.Attrib1f(i))
    return total


def shaded(x: sh.Attrib3f) -> sh.Attrib1f:
    p = sh.normalize(x)
    with SH_IF(p.x > 0):
        SH_RETURN(sh.noise(p))
    with SH_ELSE():
        p *= 2
    return falloff(p.y, 5) + sh.smoothstep(0.0, 1.0, p.z)


def turbulent(x: sh.Attrib2f) -> sh.Attrib1f:
    return sh.noise(x) + falloff(x.x, 3) * sh.noise(sh.Attrib3f(x, 1))


def mirrored(x: sh.Attrib3f, n: sh.Attrib3f) -> sh.Attrib3f:
    r = sh.reflect(x, sh.normalize(n))
    return sh.mix(x, r, falloff(r.z, 7))


def halved(x: sh.Attrib1f) -> sh.Attrib1f:
    with SH_IF(x > 2):
        x *= 0.5
    return falloff(x, 9)


def mistaken(x: sh.Attrib1f) -> sh.Attrib1f:
    y = falloff(x, 4)
    return y + sh.Attrib3f(1, 2, 3).xy


def unset(x: sh.Attrib1f) -> sh.Attrib1f:
    y = sh.Attrib1f()
    z = sh.noise(x)
    return y + z


GOOD, BAD = (shaded, turbulent, mirrored), (mistaken, unset)


def error_of(function):
    with pytest.raises(sh.ShpyError) as raised:
        sh.program(function)
    return str(raised.value)


def test_recordings_at_once_have_their_own_lines_and_names(impatient):
    texts = {function: str(sh.program(function).ir) for function in GOOD}
    messages = {function: error_of(function) for function in BAD}
    assert all("test_threads.py" in text for text in (*texts.values(), *messages.values()))
    wrong = []

    def work(first):
        for k in range(6):
            function = (*GOOD, *BAD)[(first + k) % 5]
            if function in texts:
                wrong.extend([function.__name__] if str(sh.program(function).ir) != texts[function] else [])
            else:
                wrong.extend([function.__name__] if error_of(function) != messages[function] else [])

    assert at_once(*(lambda first=first: work(first) for first in range(THREADS))) == []
    assert wrong == []


def test_texts_are_parsed_at_once(impatient):
    modules = [sh.program(function).ir for function in (mirrored, halved)]
    wrong = []

    def work(module):
        wrong.extend([module.name] if sh.parse(str(module)) != module else [])

    assert at_once(*(lambda module=module: work(module) for module in modules * 2)) == []
    assert wrong == []


class Yielding(str):
    """A text whose hash lets other threads run, as that of a dataclass can."""

    def __hash__(self):
        time.sleep(0)
        return str.__hash__(self)


class Instant:
    """A backend that compiles in no time, so that threads meet where executables are kept."""

    name = Yielding("instant")

    def devices(self):
        return [Device("none", "0")]

    def compile(self, module, options):
        return SimpleNamespace(source=str(options.loop_limit), notes=())


def test_executables_are_evicted_while_others_compile(impatient, monkeypatch):
    monkeypatch.setattr(kernel, "_KEPT", 3)
    monkeypatch.setattr(kernel, "digest", lambda module: b"")
    recorded, wrong = sh.program(turbulent).recorded, []

    def work(first):
        for k in range(first, first + 300):
            made = sh.Kernel(recorded, Instant(), Options("f32", k % 900 + 1, None, "auto", "strict"))
            wrong.extend([k] if made.source != str(k % 900 + 1) else [])

    assert at_once(*(lambda first=first: work(first) for first in range(0, 8 * THREADS, 8))) == []
    assert wrong == []
    assert len(kernel._executables) <= 3


TABLE = sh.Table(np.linspace(-1, 1, 9, dtype=np.float32), sh.Attrib1f)
GAIN = sh.Param(sh.Attrib1f, 1.5, name="gain")
MACHINES = (("numpy", "auto"), ("opencl", 1), ("opencl", 8), ("glsl", "auto"))


def summed(k):
    def summed(x: sh.Attrib3f, n: sh.Attrib1i) -> sh.Attrib1f:
        y = sh.Attrib1f(k)
        with SH_FOR(0, n) as i:
            y += x.y * TABLE[i] * GAIN
            with SH_IF(y > 4):
                SH_RETURN(y - x.z)
        return y + falloff(x.x, 3)

    return summed


def parted(k):
    def parted(x: sh.Attrib3f, n: sh.Attrib1i) -> tuple[sh.Attrib3f, sh.Attrib1i]:
        v = sh.normalize(x + k) * sh.exp(-x.x)
        with SH_IF((n & 1) == 0):
            v.yz = v.zy * GAIN
        return v, n * k + sh.Attrib1i(x.z)

    return parted


def run_everything(threads, rounds, different):
    """Threads that record, compile and run programs, some the same and some different, and kernels that they share."""
    rng = np.random.default_rng(8)
    x, n = rng.uniform(0.25, 3, (600, 3)).astype(np.float32), rng.integers(0, 9, 600).astype(np.int32)
    makers = [(make, k) for make in (summed, parted) for k in range(1, 1 + different)]
    wanted = {key: outputs_of(sh.program(key[0](key[1])).compile("numpy")(x, n)) for key in makers}
    shared = [(makers[0], sh.program(summed(1)).compile(b, lanes=lanes)) for b, lanes in MACHINES]
    wrong = []

    def work(first):
        for k in range(rounds):
            key, (name, lanes) = makers[(first + k) % len(makers)], MACHINES[(first + k // 2) % len(MACHINES)]
            kernel = sh.program(key[0](key[1])).compile(name, lanes=lanes)
            for (make, number), one in ((key, kernel), shared[(first + k) % len(shared)]):
                part = slice(first, 600 - first * k % 7)
                found = outputs_of(one(x[part], n[part]))
                if any((a != b[part]).any() for a, b in zip(found, wanted[make, number], strict=True)):
                    wrong.append((make.__name__, number, one.backend))

    assert at_once(*(lambda first=first: work(first) for first in range(threads))) == []
    assert wrong == []


def outputs_of(found):
    return found if isinstance(found, tuple) else (found,)


def test_eight_threads_record_compile_and_run_on_every_backend(impatient, monkeypatch):
    """Results are those of one thread on numpy, bit for bit, also while kernels are evicted."""
    monkeypatch.setattr(kernel, "_executables", {})
    monkeypatch.setattr(kernel, "_KEPT", 6)
    run_everything(threads=8, rounds=2, different=2)


@pytest.mark.slow
@pytest.mark.parametrize("kept", [6, 512])
def test_eight_threads_run_for_long(impatient, monkeypatch, kept):
    monkeypatch.setattr(kernel, "_executables", {})
    monkeypatch.setattr(kernel, "_KEPT", kept)
    run_everything(threads=8, rounds=60, different=12)
