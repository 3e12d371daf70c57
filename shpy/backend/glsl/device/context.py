"""The GL context: one a device and process, headless, owned by one thread that does all of its work.

Stage: run. A GL context belongs to a thread, so each is given a thread of its own: `Context.call` runs a function
there and waits, from whatever thread it was called. Every function here and in `textures.py` that touches GL runs
there.

    context = open_context(None)
    context.call(lambda: context.gl.info["GL_RENDERER"])
"""

from __future__ import annotations

import importlib
import sys
import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, TypeVar, cast

import numpy as np

from shpy.backend.base import Array
from shpy.backend.device import store
from shpy.backend.device.once import once
from shpy.backend.device.probe import COUNT, FAULTS, hard_inputs, is_exact_in_binary64, wrong_operations
from shpy.backend.device.processes import Answer, Driver, at_exit
from shpy.backend.glsl.device.probes import DOUBLES, PROBE, QUESTIONS, ROOTS, decimal_doubles
from shpy.backend.glsl.text.interface import Limits
from shpy.backend.glsl.text.prologue import ROOT
from shpy.errors import BackendUnavailable, ShpyError
from shpy.ieee import set_ieee_arithmetic
from shpy.packages import install

T = TypeVar("T")

VERTEX = """\
#version 330 core
// One triangle that covers the viewport.
void main() {
    gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}
"""

_OF_GLSL = QUESTIONS.keys() - FAULTS.keys()
"""Faults that the texts of this backend correct."""
_IN_DOUBLES = (("mul", "div"), ("add", "sub"), ("sqrt", "floor"))
_EXACT, _ROOTED, _READ = "exact", "rooted", "read"
"""The words kept on disk: a device computes exactly in binary64; its own square roots and decimal numbers, too."""


def check(gl: Any, what: str) -> None:
    """Raise ShpyError if GL has an error pending: moderngl itself stays silent."""
    error = gl.error
    if error != "GL_NO_ERROR":
        raise ShpyError(f"GL could not {what}: {error}")


class _Job(Answer[Any]):
    """Work for the context's thread, `is_awaited` until its caller is interrupted."""

    __slots__ = ("is_awaited", "work")

    def __init__(self, work: Callable[[], Any]) -> None:
        super().__init__()
        self.work, self.is_awaited = work, True


class Context:
    """A GL context with its thread. `gl` is moderngl's, to be touched inside `call` only."""

    def __init__(self, index: int | None) -> None:
        try:
            self.moderngl: Any = importlib.import_module("moderngl")
        except ImportError as e:
            raise BackendUnavailable(f"glsl needs moderngl: {e}", cure=install("moderngl")) from e
        self._jobs: SimpleQueue[_Job | None] = SimpleQueue()
        """Jobs for the thread; None ends it."""
        self._ending = False
        self.doomed: list[Any] = []
        """GL objects whose owner is gone; released before the next job."""
        self._job: _Job | None = None
        """The job that the thread runs."""
        self.gl: Any = None
        self.resting: Any = None
        """Always bound when nothing else is: moderngl binds the last framebuffer again when it makes a new one."""
        try:
            self._thread = threading.Thread(target=self._serve, name="shpy-gl", daemon=True)
            self._thread.start()
            self._do(lambda: self._create(index))
        except Exception as e:
            self._jobs.put(None)
            raise BackendUnavailable(
                f"glsl needs OpenGL 3.3 without a window: {e}",
                cure="apt install libegl1 libgl1-mesa-dri (or the EGL library of the GPU's driver)",
            ) from e
        self.limits = self._probe()
        at_exit(self._end)

    def call(self, job: Callable[[], T]) -> T:
        """Run `job` on the context's thread and return its result.

        Raises BackendUnavailable in a forked process, and ShpyError while the interpreter shuts down, when its threads
        no longer run. Ctrl-C ends the wait, and ends the job where it next calls `go_on`.
        """
        if self.is_here():
            return job()
        _DRIVER.use()
        if sys.is_finalizing():
            raise ShpyError(
                "glsl cannot be used while the interpreter ends: the thread of its context has stopped",
                cure="atexit.register(function) for what runs at the end, not __del__",
            )
        return self._do(job)

    def is_here(self) -> bool:
        """Return whether this is the context's thread."""
        return threading.current_thread() is self._thread

    def _do(self, work: Callable[[], T]) -> T:
        job = _Job(work)
        try:
            self._jobs.put(job)
            return cast(T, job.result())
        except BaseException:
            job.is_awaited = False
            raise
        finally:
            del job  # the traceback of its error holds this frame

    def _serve(self) -> None:
        set_ieee_arithmetic()  # the driver's threads compute as this one does
        while (job := self._jobs.get()) is not None:
            self._job = job
            try:
                while self.doomed:
                    self.doomed.pop().release()
                job.give(job.work())
            except BaseException as error:
                if self.resting is not None:
                    self.restore()
                job.refuse(error)
            self._job = None
            del job  # and its references

    def restore(self) -> None:
        """Bring GL back to its state between jobs: one that raised may have left it anywhere."""
        self.resting.use()
        self.gl.disable(self.moderngl.BLEND | self.moderngl.DEPTH_TEST)
        while self.gl.error not in ("GL_NO_ERROR", "GL_UNKNOWN_ERROR"):  # a lost context has no other
            pass

    def go_on(self) -> None:
        """End a run whose caller no longer waits, after Ctrl-C, by an error that no user sees.

        As the process ends, only daemons still run kernels: their threads end.
        """
        if self._ending:
            raise SystemExit
        if self._job is None or not self._job.is_awaited:
            raise ShpyError("the run was interrupted")

    def _end(self) -> None:
        """Stop the runs of threads that the process does not wait for (daemons)."""
        self._ending = True
        self._do(lambda: None)
        self._ending = False

    def _create(self, index: int | None) -> None:
        options: dict[str, Any] = {"backend": "egl"} if sys.platform == "linux" else {}
        if index is not None and sys.platform == "linux":
            options["device_index"] = index
        gl = self.moderngl.create_context(standalone=True, require=330, **options)
        if gl.info["GL_RENDERER"] == "softpipe":  # a fault of Mesa 22.3, 25.0 and 26.1
            raise ShpyError("Mesa's softpipe mixes up the arrays of different elements, which llvmpipe does not")
        resting = gl.framebuffer([gl.texture((1, 1), 4)])
        resting.use()
        check(gl, "make a framebuffer")
        self.gl, self.resting = gl, resting

    def program(self, source: str, vertex: str = VERTEX) -> Any:
        """Compile and link a fragment shader; moderngl.Error with the driver's log if it is refused."""
        program = self.gl.program(vertex_shader=vertex, fragment_shader=source)
        check(self.gl, "link a program")
        return program

    def _drawn(self, source: str) -> list[float]:
        """Return what a probe's shader without inputs writes for eight elements."""
        target = self.gl.framebuffer([self.gl.texture((8, 1), 4, dtype="f4")])
        target.use()
        self.gl.vertex_array(self.program(source), []).render(self.moderngl.TRIANGLES, 3)
        values: list[float] = np.frombuffer(target.read(components=4, dtype="f4"), np.float32)[::4].tolist()
        return values

    def _asked(self, source: str, outputs: int, dtype: str) -> list[bytes]:
        """Return what a probe's shader writes for the hard inputs: a texel of four numbers for each."""
        gl, size = self.gl, (32, COUNT // 32)
        triples = np.zeros((COUNT, 4), np.float32)
        triples[:, :3] = np.stack(hard_inputs(), axis=-1)
        texture = gl.texture(size, 4, triples.tobytes(), dtype="f4")
        target = gl.framebuffer([gl.texture(size, 4, dtype=dtype) for _ in range(outputs)])
        target.use()
        texture.use(0)
        gl.vertex_array(self.program(source), []).render(self.moderngl.TRIANGLES, 3)
        return [target.read(components=4, dtype=dtype, attachment=n) for n in range(outputs)]

    def _faults(self) -> frozenset[str]:
        """Probe the device: return the names of its faults, from FAULTS and _OF_GLSL."""
        results = np.hstack([np.frombuffer(data, np.float32).reshape(-1, 4) for data in self._asked(PROBE, 2, "f4")])
        names = ("add", "sub", "mul", "div", "sqrt", "floor")
        wrong = set(wrong_operations({**dict(zip(names, results.T, strict=False)), "fma": results[:, 7]}))
        if not np.array_equal(results[:, 6], np.trunc(np.minimum(hard_inputs()[0], np.float32(2**24 - 1)))):
            wrong.add("convert")
        wrong |= {name for name, (text, right) in QUESTIONS.items() if self._drawn(text) != right}
        self.resting.use()
        check(self.gl, "probe the device")
        return frozenset(wrong)

    def _exact_in_binary64(self, roots: str, *, flushed: bool) -> frozenset[str]:
        """Probe the device: return _EXACT if it computes exactly in binary64, and what it needs no correction for.

        `roots`: the shader whose square roots are corrected.
        """
        try:
            *doubles, narrowed = self._asked(DOUBLES, 4, "u4")
            answers: dict[str, Array] = {"narrow": np.frombuffer(narrowed, np.float32)[::4]}
            for names, data in zip(_IN_DOUBLES, doubles, strict=True):
                answers |= dict(zip(names, np.frombuffer(data, np.float64).reshape(-1, 2).T, strict=True))
            root: dict[str, Array] = {"sqrt": answers.pop("sqrt")}
            abilities = {_EXACT} if is_exact_in_binary64(answers, flushed=flushed) else set()
            if is_exact_in_binary64(root, flushed=flushed):
                abilities.add(_ROOTED)
            elif abilities:
                (corrected,) = self._asked(roots, 1, "u4")
                root = {"sqrt": np.frombuffer(corrected, np.float64)[::2]}
                abilities = abilities if is_exact_in_binary64(root, flushed=flushed) else set()
            if self._drawn(decimal_doubles()) == [1] * 8:
                abilities.add(_READ)
        except self.moderngl.Error:
            return frozenset()
        self.resting.use()
        check(self.gl, "probe the device's binary64")
        return frozenset(abilities if _EXACT in abilities else ())

    def _binary64(self, about: tuple[str, ...], *, flushed: bool) -> frozenset[str]:
        """Return what the device is capable of in binary64, by the words above: asked once, and kept on disk."""
        roots = ROOTS.replace("PROLOGUE", ROOT)
        key = store.key("glsl binary64", *about, DOUBLES, roots, decimal_doubles())

        def ask() -> frozenset[str]:
            return self.call(lambda: self._exact_in_binary64(roots, flushed=flushed))

        return store.known_names(key, {_EXACT, _ROOTED, _READ}, ask)

    @property
    def about(self) -> tuple[str, ...]:
        """The device and its driver: vendor, renderer and version."""
        info = self.gl.info
        return info["GL_VENDOR"], info["GL_RENDERER"], info["GL_VERSION"]

    def _probe(self) -> Limits:
        """Return the limits of the device. The store is asked on the caller's thread, whose line its warnings name."""
        about, info, extensions, version = self.call(
            lambda: (self.about, self.gl.info, self.gl.extensions, self.gl.version_code)
        )
        ordered = "GL_ARB_gpu_shader5" in extensions or version >= 400
        key = store.key("glsl faults", *about, str(ordered), PROBE, *(text for text, _ in QUESTIONS.values()))
        faults = store.known_names(key, FAULTS.keys() | _OF_GLSL, lambda: self.call(self._faults))
        doubles = ordered and "GL_ARB_gpu_shader_fp64" in extensions
        binary64 = self._binary64(about, flushed="denormals" in faults) if doubles else frozenset()
        return Limits(
            width=min(info["GL_MAX_TEXTURE_SIZE"], *info["GL_MAX_VIEWPORT_DIMS"]),
            outputs=min(info["GL_MAX_DRAW_BUFFERS"], info["GL_MAX_COLOR_ATTACHMENTS"]),
            textures=info["GL_MAX_TEXTURE_IMAGE_UNITS"],
            wrong=faults - _OF_GLSL,
            chooses="choices" not in faults,
            keeps_order=ordered,
            negates="negations" not in faults,
            signs="signs" not in faults,
            doubles=_EXACT in binary64,
            roots=_ROOTED in binary64,
            reads="decimals" not in faults and (_READ in binary64 or _EXACT not in binary64),
        )


_DRIVER = Driver("glsl")


def open_context(index: int | None) -> Context:
    """Return the context of a device (None: the driver chooses), made on first use; BackendUnavailable without one."""
    _DRIVER.use()  # before a lock that another thread of the parent may have held
    return _opened(index)


@once
def _opened(index: int | None) -> Context:
    _DRIVER.use()
    try:
        return Context(index)
    except BackendUnavailable:
        if not len(_opened):
            _DRIVER.release()
        raise
