"""Kernels and chains over Dask arrays: the bits of one process for any chunks, also where a worker is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from typing import NamedTuple

import dask
import dask.array as da
import numpy as np
import pytest
from dask.distributed import Client, LocalCluster

import shpy as sh
from shpy.backend.registry import NAMES
from shpy.cluster import overlap
from shpy.passes.reach import reach

every = pytest.mark.parametrize("name", NAMES)
draw = np.random.default_rng(7)
X = draw.random((13, 17, 3)).astype(np.float32)
K = draw.random(17).astype(np.float32)
U, V = draw.random((2, 40, 31)).astype(np.float32)


class Two(NamedTuple):
    a: sh.Attrib3f
    b: sh.Attrib1f


class UV(NamedTuple):
    u: sh.Attrib1f
    v: sh.Attrib1f


@sh.struct
class Ray:
    o: sh.Point3f
    m: sh.Matrix2f


@sh.program
def two(x: sh.Attrib3f, k: sh.Attrib1f) -> Two:
    i = sh.grid_index(2)
    return Two(x * sh.sin(k) + i.x, sh.dot(x, x) + i.y * sh.grid_shape(2).x)


@sh.program
def placed() -> sh.Attrib2i:
    return sh.grid_index(2)


@sh.program
def turned(ray: Ray, s: sh.Attrib1f) -> Ray:
    return Ray(ray.o * s, ray.m @ ray.m)


def laplacian(t, i):
    return t[i + (0, 1)] + t[i - (0, 1)] + t[i + (1, 0)] + t[i - (1, 0)] - 4 * t[i]


@sh.program
def gray_scott(u: sh.Table[sh.Attrib1f, 2], v: sh.Table[sh.Attrib1f, 2]) -> UV:
    i = sh.grid_index(2)
    a, b = u[i], v[i]
    reaction = a * b * b
    ramp = 0.035 + 0.0001 * i.y / sh.grid_shape(2).y
    return UV(a + 0.16 * laplacian(u, i) - reaction + ramp * (1 - a), b + 0.08 * laplacian(v, i) + reaction - 0.095 * b)


@sh.program
def clamped(u: sh.Table[sh.Attrib1f, 1]) -> sh.Attrib1f:
    i, n = sh.grid_index(1), sh.grid_shape(1)
    return u[sh.min(i + 2, n - 1)] - u[sh.max(i - 1, 0)] * 0.5


@sh.program
def stored(u: sh.Table[sh.Attrib1f, 2]) -> sh.Attrib1f:
    i = sh.grid_index(2)
    i.x = sh.max(i.x - 1, 0)
    i.y += 2
    return u[i] + 1


@sh.program
def torus(u: sh.Table[sh.Attrib1f, 2], f: sh.Attrib1f) -> dict:
    """A stencil that is periodic along both axes, whose result depends on the place as well."""
    i, n = sh.grid_index(2), sh.grid_shape(2)
    around = u[(i + (0, 1)) % n] + u[(i - (0, 1)) % n] + u[(i + (2, 0)) % u.shape] + u[(i - (1, 0)) % n]
    return {"u": 0.25 * around + 0.01 * f * i.x - 0.02 * i.y}


@sh.program
def tube(u: sh.Table[sh.Attrib1f, 2]) -> dict:
    """A stencil that is periodic along one axis and clamped along the other."""
    i = sh.grid_index(2)
    column = (i.y - 2) % sh.grid_shape(2).y
    return {"u": 0.5 * u[i.x, column] + 0.4 * u[i + (1, 0)] + 0.1 * u[i - (3, 0)]}


@sh.program
def mixed(u: sh.Table[sh.Attrib1f, 1]) -> sh.Attrib1f:
    i = sh.grid_index(1)
    return u[(i + 1) % sh.grid_shape(1)] + u[i - 1]


@sh.program
def far(u: sh.Table[sh.Attrib1f, 2]) -> sh.Attrib1f:
    return u[sh.grid_index(2).yx]


@sh.program
def counted(u: sh.Table[sh.Attrib1f, 2]) -> sh.Attrib1f:
    i, k, total = sh.grid_index(2), sh.Attrib1i(0), sh.Attrib1f(0)
    with sh.SH_WHILE(lambda: k < 3):
        total += u[i + sh.Attrib2i(k, 0)]
        k += 1
    return total


def cut(array, *chunks):
    return da.from_array(array, chunks=chunks)


@pytest.fixture(autouse=True)
def one_thread():
    with dask.config.set(scheduler="synchronous"):
        yield


@pytest.mark.sampled(4)
@every
@pytest.mark.parametrize("chunks", [(5, 4, 3), (13, 17, 3), (1, 17, 3)])
def test_blocks_have_the_bits_of_one_run(name, chunks):
    kernel = two.compile(name)
    wanted = kernel(X, K)
    found = sh.map_blocks(kernel, cut(X, *chunks), K)
    assert type(found) is Two
    assert (found.a.shape, found.a.dtype, found.b.shape) == ((13, 17, 3), np.float32, (13, 17))
    assert found.b.chunks == found.a.chunks[:2]
    assert found.a.compute().tobytes() == wanted.a.tobytes()
    assert found.b.compute().tobytes() == wanted.b.tobytes()


@pytest.mark.sampled(3)
@every
def test_structs_and_matrices_go_in_and_out(name):
    rays = {"o": X[0], "m": draw.random((17, 2, 2)).astype(np.float32)}
    lazy = {"o": cut(rays["o"], 4, 3), "m": cut(rays["m"], 6, 2, 2)}
    wanted = turned.compile(name)(rays, 2.5)
    found = sh.map_blocks(turned.compile(name), lazy, 2.5)
    assert found.m.shape == (17, 2, 2)
    assert found.o.compute().tobytes() == wanted.o.tobytes()
    assert found.m.compute().tobytes() == wanted.m.tobytes()


def test_without_arrays_shape_and_chunks_say_over_what():
    @sh.program
    def ramp() -> sh.Attrib1f:
        return sh.grid_index(2).x * 10 + sh.grid_index(2).y

    found = sh.map_blocks(ramp, shape=(5, 7), chunks=(2, 3))
    assert found.chunks == ((2, 2, 1), (3, 3, 1))
    assert found.compute().tolist() == ramp(shape=(5, 7)).tolist()


def test_params_are_sent_as_they_are_when_the_array_is_made():
    gain = sh.Param(sh.Attrib1f, 2.0)

    @sh.program
    def scale(x: sh.Attrib1f) -> sh.Attrib1f:
        return gain * x

    before = sh.map_blocks(scale, cut(K, 5))
    gain.value = 3.0
    after = sh.map_blocks(scale, cut(K, 5))
    assert before.compute().tolist() == (K * 2).tolist()
    assert after.compute().tolist() == (K * 3).tolist()


@pytest.mark.sampled(15)
@every
@pytest.mark.parametrize("chunks", [(10, 10), (40, 31), (7, 31), (3, 4)])
def test_stencils_have_the_bits_of_one_run(name, chunks):
    kernel = gray_scott.compile(name)
    wanted = sh.repeat(kernel, 6).run(u=U, v=V).streams
    found = sh.map_overlap(kernel, {"u": cut(U, *chunks), "v": V}, steps=4)
    found = sh.map_overlap(sh.repeat(kernel, 2), found)
    for stream in "uv":
        assert found[stream].compute().tobytes() == wanted[stream].numpy().tobytes()


@pytest.mark.sampled(30)
@every
@pytest.mark.parametrize("chunks", [(10, 10), (40, 31), (7, 31), (3, 4)])
@pytest.mark.parametrize("step", [torus, tube], ids=["torus", "tube"])
def test_borders_that_wrap_around_have_the_bits_of_one_run(name, chunks, step):
    kernel = step.compile(name)
    given = {"u": U, "f": V} if step is torus else {"u": U}
    wanted = sh.repeat(kernel, 6).run(**given).streams["u"].numpy()
    lazy = given | {"u": cut(U, *chunks)}
    found = sh.map_overlap(kernel, lazy, steps=4)
    found = sh.map_overlap(sh.repeat(kernel, 2), lazy | {"u": found["u"]})
    assert found["u"].compute().tobytes() == wanted.tobytes()


def test_the_reach_of_each_kernel_is_found_once_and_sent(monkeypatch):
    @sh.program
    def wide(u: sh.Table[sh.Attrib1f, 2]) -> dict:
        i, n = sh.grid_index(2), sh.grid_shape(2)
        return {"u": u[(i + (0, 5)) % n] - 0.5 * u[(i - (3, 0)) % n]}

    asked = []
    monkeypatch.setattr(overlap, "reach", lambda *given: asked.append(reach(*given)) or asked[-1])
    chain = sh.sequence(torus, sh.repeat(wide, 2))
    found = sh.map_overlap(chain, {"u": cut(U, 17, 13), "f": V})["u"]
    assert [each.distance for each in asked] == [(2, 1), (3, 5)]
    assert found.compute().tobytes() == chain.run(u=U, f=V).streams["u"].numpy().tobytes()
    assert len(asked) == 2


@pytest.mark.parametrize("n", [2, 3, 4, 5, 9])
def test_arrays_that_are_hardly_longer_than_the_reach_wrap_around(n):
    wanted = sh.repeat(torus, 1).run(u=U[:n, :n], f=V[:n, :n]).streams["u"].numpy()
    found = sh.map_overlap(torus, {"u": cut(U[:n, :n], 1, 2), "f": V[:n, :n]})["u"]
    assert found.compute().tobytes() == wanted.tobytes()


@pytest.mark.sampled(4)
@every
@pytest.mark.parametrize("size", [1, 3, 9, 17])
def test_indices_clamped_by_the_program_reach_as_far(name, size):
    kernel = clamped.compile(name)
    wanted = sh.repeat(kernel, 3).run(u=K).streams["u"].numpy()
    assert sh.map_overlap(kernel, {"u": cut(K, size)}, steps=3)["u"].compute().tobytes() == wanted.tobytes()


def test_an_index_whose_components_are_stored_reaches_as_far():
    wanted = sh.repeat(stored, 2).run(u=U).streams["u"].numpy()
    assert sh.map_overlap(stored, {"u": cut(U, 4, 4)}, steps=2)["u"].compute().tobytes() == wanted.tobytes()


def test_an_index_that_differs_from_branch_to_branch_reaches_as_far_as_each():
    @sh.program
    def upwind(u: sh.Table[sh.Attrib1f, 2], f: sh.Attrib1f) -> dict:
        i = sh.grid_index(2)
        at = sh.Attrib2i(i)
        with sh.SH_FOR(0, 2):
            with sh.SH_IF(u[at] > 0.5):
                at[:] = i + (0, 3)
            with sh.SH_ELSE():
                at[:] = i - (2, 0)
        return {"u": 0.5 * u[at] + f}

    wanted = sh.repeat(upwind, 3).run(u=U, f=V).streams["u"].numpy()
    found = sh.map_overlap(upwind, {"u": cut(U, 9, 9), "f": V}, steps=3)["u"]
    assert found.compute().tobytes() == wanted.tobytes()


def test_a_step_that_also_reads_a_whole_table_and_its_own_element():
    weights = sh.Table([0.5, 0.25], sh.Attrib1f)

    @sh.program
    def step(u: sh.Table[sh.Attrib1f], w: sh.Table[sh.Attrib1f], f: sh.Attrib1f, s: sh.Attrib1f) -> dict:
        i = sh.grid_index(1)
        return {"u": w[0] * u[i - 1] + w[1] * u[i] + f * s}

    force = K[::-1].copy()
    wanted = sh.repeat(step, 4).run(u=K, w=weights, f=force, s=0.1).streams["u"].numpy()
    found = sh.map_overlap(step, {"u": cut(K, 5), "w": weights, "f": force, "s": 0.1}, steps=4)
    assert found["u"].compute().tobytes() == wanted.tobytes()


@sh.program
def looked_up(k: sh.Attrib1i, u: sh.Table[sh.Attrib1f, 2], rays: sh.Table[Ray, 1]) -> dict:
    ray = rays[k]
    return {"value": u[k % 40, k // 3] * ray.o.y, "point": ray.m @ ray.o.xy, "place": sh.grid_index(1)}


@pytest.mark.sampled(3)
@every
def test_a_dask_array_is_a_table_with_the_bits_of_one_run(name):
    """Each worker joins the chunks of arrays that its blocks read at any index, plain ones and fields of structs."""
    k = draw.integers(-5, 60, 57).astype(np.int32)
    rays = {"o": draw.random((21, 3)).astype(np.float32), "m": draw.random((21, 2, 2)).astype(np.float32)}
    kernel = looked_up.compile(name)
    alone = kernel(k, U, rays)
    lazy = {"o": cut(rays["o"], 4, 2), "m": rays["m"]}
    for index, table, fields in ((cut(k, 10), cut(U, 9, 31), lazy), (k, cut(U, 40, 7), rays), (cut(k, 57), U, lazy)):
        blocks = sh.map_blocks(kernel, index, table, fields)
        for part, wanted in alone.items():
            assert blocks[part].compute().tobytes() == wanted.tobytes(), part


def test_a_joined_table_is_made_once_for_all_blocks(monkeypatch):
    made = []
    original = sh.Table.__init__
    monkeypatch.setattr(sh.Table, "__init__", lambda self, *a, **k: (made.append(a), original(self, *a, **k))[1])

    @sh.program
    def read(k: sh.Attrib1i, u: sh.Table[sh.Attrib1f, 1]) -> sh.Attrib1f:
        return u[k]

    result = sh.map_blocks(read, cut(np.arange(60, dtype=np.int32), 5), cut(U[0], 8))
    assert result.compute().tobytes() == U[0][np.minimum(np.arange(60), 30)].tobytes()
    assert len(made) == 1


def test_numbers_are_read_in_the_precision_of_the_kernel():
    @sh.program
    def step(u: sh.Table[sh.Attrib1f], s: sh.Attrib1f) -> dict:
        return {"u": 0.5 * u[sh.grid_index(1) - 1] + s}

    kernel = step.compile("numpy", precision="f64")
    given = {"u": np.float64(K) / 3, "s": 1e300}
    wanted = sh.repeat(kernel, 2).run(**given).streams["u"].numpy()
    found = sh.map_overlap(kernel, {**given, "u": cut(given["u"], 5)}, steps=2)
    assert found["u"].compute().tobytes() == wanted.tobytes()


REFUSED = [
    (
        lambda: two(cut(X, 5, 4, 3), K),
        "x is a Dask array, whose chunks may not fit into the memory of one process",
        "sh.map_blocks(kernel, x), or x.compute() where it fits",
    ),
    (
        lambda: sh.map_blocks(two, cut(X, 5, 4, 2), K),
        "x is an Attrib3f, and its chunks (2, 1) on the last axis cut the components of elements",
        "x.rechunk({-1: -1})",
    ),
    (
        lambda: sh.map_blocks(turned, {"o": cut(X[:, 0], 5, 3), "m": da.ones((13, 2, 2), chunks=(13, 2, 1))}, 1.0),
        "ray.m[0] is an Attrib2f, and its chunks (1, 1) on the last axis cut the components of elements",
        "ray.m.rechunk({-1: -1})",
    ),
    (
        lambda: sh.map_blocks(placed, shape=(5, 4), chunks=(2,)),
        "chunks=(2,) of the shape (5, 4): Chunks and shape must be of the same length/dimension. Got chunks=(2,), "
        "shape=(5, 4)",
        "chunks=(512, 512), one for each axis",
    ),
    (
        lambda: sh.map_blocks(placed, shape=(5, 4), chunks=0),
        "chunks=0 of the shape (5, 4): a chunk has elements",
        "chunks=(512, 512), one for each axis",
    ),
    (
        lambda: sh.Texture2D(cut(X, 5, 4, 3)),
        "a texture is a Dask array, whose chunks may not fit into the memory of one process",
        "sh.map_blocks(kernel, x), or x.compute() where it fits",
    ),
    (
        lambda: sh.map_blocks(two, cut(X, 5, 4, 3), K[:5]),
        "the element shapes do not broadcast: x (13, 17), k (5,)",
        "shapes as numpy's rules join them",
    ),
    (
        lambda: sh.map_blocks(two, X, K),
        "no input of two is a Dask array",
        "kernel(…), which runs here, or da.from_array(x, chunks=…); without inputs, shape= and chunks=",
    ),
    (
        lambda: sh.map_blocks(far, cut(U, 9, 9)),
        "far reads u at any index, and no input tells how many elements there are",
        "shape= and chunks=, or sh.map_overlap for a stencil",
    ),
    (
        lambda: sh.map_blocks(far, cut(U[0], 9), shape=(4, 4)),
        "u is a Table[Attrib1f, 2], and the Dask array u has the shape (31,)",
        "an array of 2 axes of elements, one or more on each",
    ),
    (
        lambda: sh.map_blocks(
            looked_up, K.astype(np.int32), cut(U, 9, 9), {"o": cut(X[0], 3, 3), "m": np.ones((4, 2, 2))}
        ),
        "rays has fields of several shapes: rays.o (17,), rays.m[0] (4,), rays.m[1] (4,)",
        "one element of each field a place",
    ),
    (
        lambda: sh.map_blocks(sh.repeat(far, 2), cut(U, 9, 9)),
        "sh.map_blocks takes a program or kernel, not <Chain repeat(far, 2)>",
        "sh.map_overlap(chain, {name: array})",
    ),
    (
        lambda: sh.map_overlap(far, {"u": cut(U, 9, 9)}),
        "u is read at an index whose distance from sh.grid_index has no known bound, so no halo is wide enough",
        "u[i + (0, 1)] with i = sh.grid_index(2) and constants, or the whole array as a sh.Table",
    ),
    (
        lambda: sh.map_overlap(counted, {"u": cut(U, 9, 9)}),
        "u is read at an index whose distance from sh.grid_index has no known bound, so no halo is wide enough",
        "u[i + (0, 1)] with i = sh.grid_index(2) and constants, or the whole array as a sh.Table",
    ),
    (
        lambda: sh.map_overlap(gray_scott, {"u": cut(U, 9, 9)}),
        "sequence(gray_scott) lacks v",
        "sh.map_overlap(chain, {'u': u, 'v': v})",
    ),
    (
        lambda: sh.map_overlap(mixed, {"u": cut(K, 9)}),
        "sequence(mixed) reads across the border of axis 0 both modulo its length and clamped",
        "% sh.grid_shape(n) in all indices, or in none",
    ),
    (
        lambda: sh.map_overlap(torus, {"u": cut(U, 9, 9), "f": V}, steps=21),
        "all steps read 42 elements along axis 0, which has 40, and wrap around",
        "fewer steps, several times, or sh.repeat(program, steps).run(...) without Dask",
    ),
    (lambda: sh.map_overlap(far, {"u": cut(U, 9, 9)}, steps=0), "steps=0 is no number of executions", "steps=8"),
]


@pytest.mark.parametrize(("call", "message", "cure"), REFUSED)
def test_mistakes_are_errors_before_anything_runs(call, message, cure):
    with pytest.raises(sh.ShpyTypeError) as caught:
        call()
    assert (caught.value.message, caught.value.cure) == (message, cure)


def test_an_error_about_the_numbers_of_a_block_names_no_line_of_dask():
    made = sh.map_blocks(two, da.full((4, 3), 1e300, chunks=(2, 3)), 1.0).a
    with pytest.raises(sh.ShpyTypeError, match=r"holds 1e\+300, out of the range") as caught:
        made.compute(scheduler="threads")
    assert caught.value.loc is None
    with pytest.raises(sh.ShpyTypeError, match=r"holds 1e\+300, out of the range") as caught:
        made.compute(scheduler="synchronous")
    assert caught.value.loc.file == __file__


def test_importing_shpy_does_not_import_dask():
    """Nor the modules of names that few programs use."""
    late = {"dask", "distributed", "shpy.cluster", "shpy.pictures.animation"}
    code = f"import sys, shpy; print(*{late} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "\n"


def kill_once(block, flag):
    """Kill the worker that runs the first block; a file marks that this has happened."""
    try:
        os.close(os.open(flag, os.O_CREAT | os.O_EXCL))
    except FileExistsError:
        return block
    os.kill(os.getpid(), signal.SIGKILL)
    return block


@pytest.mark.slow  # `raytracer/test_partitions.py` kills one in every run
def test_a_worker_that_is_killed_costs_nothing_but_its_blocks(tmp_path):
    flag = str(tmp_path / "killed")
    kernel = gray_scott.compile("numpy")
    wanted = sh.repeat(kernel, 4).run(u=U, v=V).streams
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        Client(cluster) as client,
        dask.config.set(scheduler=client),
    ):
        found = sh.map_overlap(kernel, {"u": cut(U, 11, 9), "v": cut(V, 11, 9)}, steps=2)
        found = {n: a.map_blocks(kill_once, flag=flag, dtype=a.dtype, meta=a._meta) for n, a in found.items()}
        found = sh.map_overlap(kernel, found, steps=2)
        u, v = dask.compute(found["u"], found["v"], scheduler=client)
    assert os.path.exists(flag)
    assert u.tobytes() == wanted["u"].numpy().tobytes()
    assert v.tobytes() == wanted["v"].numpy().tobytes()
