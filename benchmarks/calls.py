"""Measure the overhead of a call: x + 1 of 64 numbers, from an array to an array.

python -m benchmarks --only calls
"""

import os
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np

import shpy as sh
from benchmarks.opencl import Device
from benchmarks.rounds import Apart, in_turns, peer_run
from benchmarks.tables import Setup, Table
from benchmarks.work import Run

COUNT = 64
ROUNDS = 14
CALLS = 200
STEPS = 100
"""Kernels of a chain, of which the table shows one."""


@sh.program
def increment(x: sh.Attrib1f) -> sh.Attrib1f:
    return x + 1


def calls(setup: Setup) -> Table:
    """Microseconds of a call: the median of the rounds' means, their quartiles, and the best mean."""
    x = np.arange(COUNT, dtype=np.float32)
    runs: dict[str, tuple[Run | Apart, int]] = {"shpy, plain call": (lambda: increment(x), 1)}
    for info in sh.backends():
        if info.available:
            runs |= _ours(info.name, x)
    rounds = 2 if setup.quick else ROUNDS
    with ExitStack() as ending:
        for name in setup.installed(*PEERS):
            label, make = PEERS[name]
            runs[label] = ending.enter_context(peer_run(name, make, x)), 1
        calls = {name: 5 if setup.quick else max(CALLS // parts, 10) for name, (_, parts) in runs.items()}
        warm = {name: run for name, (run, _) in runs.items()}
        in_turns(warm, 1, calls)  # compiles and settles
        seconds = {name: np.divide(t.seconds, runs[name][1]) for name, t in in_turns(warm, rounds, calls).items()}
    rows = []
    for name, means in seconds.items():
        low, middle, high = np.percentile(1e6 * means, (25, 50, 75))
        rows.append([name, f"{middle:.1f}", f"{low:.1f} to {high:.1f}", f"{1e6 * means.min():.1f}"])
    note = (
        f"Microseconds of a call of x + 1 over {COUNT} float32 numbers: the median of {rounds} rounds of {CALLS} "
        f"calls, the quartiles, the best round. Of a chain of {STEPS} kernels, one kernel."
    )
    means_by_name = {name: means.tolist() for name, means in seconds.items()}
    return Table("calls", note, ["call", "median", "quartiles", "best"], rows, means_by_name)


def _ours(backend: str, x: np.ndarray) -> dict[str, tuple[Run, int]]:
    kernel, out = increment.compile(backend), np.empty_like(x)
    stream = sh.Stream(x, sh.Attrib1f, backend)
    chain = sh.repeat(kernel, STEPS)

    def streamed() -> Any:
        answer = kernel(stream)
        answer.place.space.finish()
        return answer

    def chained() -> Any:
        answer = chain.run(x=stream).streams["x"]
        answer.place.space.finish()
        return answer

    return {
        f"shpy, {backend}": (lambda: kernel(x), 1),
        f"shpy, {backend}, out=": (lambda: kernel.run(x, out=out), 1),
        f"shpy, {backend}, streams": (streamed, 1),
        f"shpy, {backend}, in a chain": (chained, STEPS),
    }


def _numpy(x: np.ndarray) -> Run:
    return lambda: x + np.float32(1)


def _numba(x: np.ndarray) -> Run:
    from numba import vectorize

    function = vectorize(["float32(float32)"])(lambda a: a + np.float32(1))
    return lambda: function(x)


def _jax(x: np.ndarray) -> Run:
    import jax

    function = jax.jit(lambda a: a + np.float32(1))
    return lambda: np.asarray(function(x))


def _opencl(x: np.ndarray) -> Run:
    device = Device.opened()
    text = """
    __kernel void increment(__global const float *x, __global float *y) {
        y[get_global_id(0)] = x[get_global_id(0)] + 1;
    }
    """
    source, target = device.empty(x.nbytes), device.empty(x.nbytes)
    start = device.kernel(text, "increment", x.size, x.size, source, target)

    def run() -> np.ndarray:
        out = np.empty_like(x)
        device.cl.enqueue_copy(device.queue, source, x, is_blocking=False)
        start()
        device.copy(out, target)
        return out

    return run


def _glsl(x: np.ndarray) -> Run:
    """Return a call that draws a fragment for each number, from a texture to a texture."""
    import moderngl

    gl = moderngl.create_context(standalone=True, require=330, **({"backend": "egl"} if os.name == "posix" else {}))
    program = gl.program(
        vertex_shader="""
        #version 330
        void main() {
            gl_Position = vec4(gl_VertexID == 1 ? 3 : -1, gl_VertexID == 2 ? 3 : -1, 0, 1);
        }
        """,
        fragment_shader="""
        #version 330
        uniform sampler2D x;
        out float y;
        void main() {
            y = texelFetch(x, ivec2(gl_FragCoord.xy), 0).r + 1.0;
        }
        """,
    )
    triangle = gl.vertex_array(program, [])
    source, target = (gl.texture((x.size, 1), 1, dtype="f4") for _ in range(2))
    frame = gl.framebuffer([target])

    def run() -> np.ndarray:
        source.write(x)
        source.use(0)
        frame.use()
        triangle.render(vertices=3)
        return np.frombuffer(frame.read(components=1, dtype="f4"), np.float32)

    return run


PEERS: dict[str, tuple[str, Callable[..., Run]]] = {
    "masks": ("numpy", _numpy),
    "numba": ("numba", _numba),
    "jax": ("JAX", _jax),
    "hand": ("OpenCL C by hand", _opencl),
    "moderngl": ("GLSL by hand", _glsl),
}
