"""Pictures by the workers of a cluster: real processes of this machine, and the bits of one process."""

import logging
import os
import signal
import subprocess
import sys
import threading
import time
import types
from contextlib import contextmanager, nullcontext
from unittest.mock import Mock

import numpy as np
import pytest
from patience import HANGING
from PIL import Image
from scene_pictures import same

import shpy as sh
from raytracer import (
    Camera,
    ClusterError,
    EnvironmentLight,
    Instance,
    Material,
    MetallicRoughness,
    Path,
    PointLight,
    Scene,
    SceneError,
    Staged,
    Surface,
    Whitted,
    cli,
    render,
)
from raytracer.animation import animate
from raytracer.cluster import connection, tasks
from raytracer.meshes.shapes import box, floor, icosahedron, sphere


@pytest.fixture(scope="module")
def client():
    with connection.connected("local:2") as found:
        yield found


def assert_same(found, wanted):
    same(found, wanted)
    assert (found.samples, found.origin, found.stats.rays) == (wanted.samples, wanted.origin, wanted.stats.rays)


@pytest.mark.parametrize(
    ("name", "integrator"),
    [
        pytest.param("boxes", Whitted(samples=4, accel="grid", precision="f64"), marks=pytest.mark.slow),
        pytest.param("boxes", Staged(samples=4), marks=pytest.mark.slow),
        ("cornell", Path(samples=5, seed=5)),
    ],
    ids=["whitted", "staged", "path"],
)
def test_pictures_have_the_bits_of_one_process(client, name, integrator):
    scene = Scene.builtin(name)
    options = {"integrator": integrator, "backend": "numpy"}
    assert_same(render(scene, (16, 9), cluster=client, **options), render(scene, (16, 9), **options))


@pytest.mark.slow
def test_workers_share_the_triangles_of_instances(client, tmp_path):
    ball = icosahedron(0.4)

    def make(time):
        places = (-1.0, 3 * time, 1.0)
        return Scene([Instance(ball, np.eye(4) + np.diag([x], 3)) for x in places], [PointLight((1, 3, 2))])

    options = {"integrator": Whitted(accel="instances"), "backend": "numpy"}
    assert_same(render(make(0), (16, 9), cluster=client, **options), render(make(0), (16, 9), **options))
    for folder, cluster in (("here", None), ("workers", client)):
        assert list(animate(make, tmp_path / folder, 5, fps=10, size=(16, 9), cluster=cluster, **options)) == [
            *range(1, 6)
        ]
    pictures = [[path.read_bytes() for path in sorted((tmp_path / name).iterdir())] for name in ("here", "workers")]
    assert pictures[0] == pictures[1]
    assert len(set(pictures[0])) == 5


@pytest.mark.slow
def test_workers_render_bodies_and_brushed_metal_and_the_client_denoises(client, monkeypatch):
    amber = MetallicRoughness(roughness=0.3, transmission=1, thickness=1, attenuation_color=(0.9, 0.5, 0.1))
    steel = MetallicRoughness((0.8, 0.8, 0.8), 1, 0.3, anisotropy=0.8, multiscatter=True)
    meshes = [sphere(0.5, amber, rings=6, segments=8), floor(3, steel).moved((0, -0.5, 0))]
    scene = Scene(meshes, [EnvironmentLight((0.5, 0.7, 1.0))], Camera((0, 1, 4)))
    options = {"integrator": Path(samples=3), "backend": "numpy"}
    half = types.SimpleNamespace(denoise=lambda color, *guides, **_: color / 2)
    monkeypatch.setitem(sys.modules, "pyoidn", half)
    image = render(scene, (12, 9), cluster=client, denoise=True, **options)
    np.testing.assert_array_equal(image.pixels, render(scene, (12, 9), **options).pixels / 2)


@pytest.mark.slow
def test_tiles_of_any_size_make_the_same_picture(client):
    scene, given = Scene.builtin("cornell"), {"integrator": Path(samples=5, seed=5), "backend": "numpy"}
    wanted = render(scene, (11, 13), **given)
    for rows in (1, 4, 13, 100):
        progress = Mock()
        assert_same(render(scene, (11, 13), cluster=client, tile_rows=rows, progress=progress, **given), wanted)
        assert progress.call_count == -(-13 // rows)
        assert progress.call_args.args == (13, 13)


def renderers():
    from raytracer.cluster import tasks

    return {key: id(thing.renderer) for key, (thing, _) in tasks._things.items()}


def test_a_scene_is_compiled_once_in_a_process(client):
    scene = Scene.builtin("boxes")
    before = render(scene, (6, 20), backend="numpy", cluster=client, tile_rows=1)
    kept = client.run(renderers)
    again = render(Scene.builtin("boxes"), (6, 20), backend="numpy", cluster=client, tile_rows=1)
    assert kept == client.run(renderers)
    assert_same(again, before)


@pytest.mark.slow
def test_more_samples_go_on_from_a_picture(client, tmp_path):
    scene = Scene.builtin("cornell")
    few = render(scene, (8, 9), integrator=Path(samples=2), backend="numpy", cluster=client)
    given = {"integrator": Path(samples=5), "backend": "numpy"}
    wanted = render(scene, (8, 9), **given)
    for begun in (few, few.save(tmp_path / "few.npy")):
        assert_same(render(scene, (8, 9), resume=begun, cluster=client, tile_rows=2, **given), wanted)
    with pytest.raises(SceneError, match="was not path traced from this scene, camera, seed"):
        render(scene, (8, 9), integrator=Path(samples=5, seed=1), backend="numpy", resume=few, cluster=client)


def test_an_empty_scene_is_its_background(client):
    assert_same(render(Scene(), (5, 4), cluster=client), render(Scene(), (5, 4)))


SCENES = """
from raytracer import Material, Scene
from raytracer.meshes.shapes import box

def scene(time):
    if time > 0.3:
        missing
    return Scene(box((1, 1, 1), Material()).moved((time, 0, 0)))
"""


@pytest.mark.slow
def test_the_commands_write_what_they_write_without_a_cluster(client, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    here = ["--cluster", client.scheduler.address]
    line = ["--size", "12x9", "--backend", "numpy", "-o"]
    for words in (["boxes"], ["cornell", "--integrator", "path", "--samples", "5", "--seed", "5"]):
        assert cli.main(["render", *words, *line, "one.png"]) == 0
        assert cli.main(["render", *words, *here, *line, "several.png"]) == 0
        assert (tmp_path / "several.png").read_bytes() == (tmp_path / "one.png").read_bytes()
    (tmp_path / "moves.py").write_text(SCENES)
    frames = ["animate", "moves.py", "--fps", "10", *line]
    assert cli.main([*frames, "one", "--frames", "3"]) == 0
    assert cli.main([*frames, "several", "--frames", "3", *here]) == 0
    made = {path.name: path.read_bytes() for path in (tmp_path / "one").iterdir()}
    assert {path.name: path.read_bytes() for path in (tmp_path / "several").iterdir()} == made
    (tmp_path / "several/0001.png").unlink()
    Image.new("RGB", (12, 9), "red").save(tmp_path / "several/0002.png")
    kept = (tmp_path / "several/0002.png").read_bytes()
    assert cli.main([*frames, "several", "--frames", "3", "--resume", *here]) == 0
    assert (tmp_path / "several/0001.png").read_bytes() == made["0001.png"]
    assert (tmp_path / "several/0002.png").read_bytes() == kept
    capsys.readouterr()
    assert cli.main([*frames, "more", "--frames", "6", *here]) == 1
    assert capsys.readouterr().err == "raytracer: moves.py:7: NameError: name 'missing' is not defined\n"
    assert cli.main(["render", "boxes", "--cluster", "nowhere", *line, "one.png"]) == 1
    assert capsys.readouterr().err.startswith("raytracer: a cluster is a dask.distributed.Client, an address")


HERE = int(os.environ.setdefault("TEST_CLUSTER_PID", str(os.getpid())))


def broken_on_workers(hit):
    color = 1 if os.getpid() == HERE else 1 / 0  # the user's mistake
    return Surface(color=sh.Color3f(color))


def forgetful(hit):
    return None


def test_an_error_of_a_shader_is_shown_with_its_line_alone(client):
    scene = Scene(box((1, 1, 1), Material(surface=broken_on_workers)))
    with pytest.raises(ZeroDivisionError) as caught:
        render(scene, (4, 4), cluster=client)
    files = [entry.path.name for entry in caught.traceback]
    assert files[-1] == "test_cluster.py"
    assert "1 / 0  # the user's mistake" in str(caught.traceback[-1].statement)
    assert not any("distributed" in str(entry.path) for entry in caught.traceback)
    assert len(files) <= 8
    with pytest.raises(SceneError, match=r"forgetful \(test_cluster.py:\d+\): a surface gives a raytracer.Surface"):
        render(Scene(box((1, 1, 1), Material(surface=forgetful))), (4, 4), cluster=client)


def test_what_a_cluster_cannot_do_is_refused_before_anything_runs():
    scene = Scene.builtin("boxes")
    with pytest.raises(ClusterError, match=r'"local:N" for 1 to 1024 workers of this machine, not \'local:0\''):
        render(scene, cluster="local:0")
    with pytest.raises(ClusterError, match=r"not 4"):
        render(scene, cluster=4)
    with pytest.raises(SceneError, match="max_error chooses by times measured on this machine"):
        render(scene, cluster="local:2", max_error=1.0)
    with pytest.raises(SceneError, match="tile_rows and partitions are for the workers of a cluster"):
        render(scene, tile_rows=4)
    with pytest.raises(SceneError, match="tile_rows is a number of rows, 1 or more, not 0"):
        render(scene, cluster="local:2", tile_rows=0)
    with pytest.raises(SceneError, match="the integrator is one of"):
        render(scene, cluster="local:2", integrator="magic")


def test_what_a_picture_cannot_be_is_refused_by_the_client(client):
    with pytest.raises(SceneError, match="a picture is from 1 to 32768 pixels"):
        render(Scene.builtin("boxes"), (0, 4), cluster=client)
    with pytest.raises(SceneError, match="resume is for"):
        render(Scene.builtin("boxes"), (4, 4), resume="a.npy", cluster=client)
    with pytest.raises(sh.BackendUnavailable, match="no backend"):
        render(Scene.builtin("boxes"), (4, 4), backend="abacus", cluster=client)


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch):
    monkeypatch.setattr(connection, "FIRST_ANSWER", 0.2)
    with pytest.raises(ClusterError, match=r"no Dask scheduler answers at tcp://127.0.0.1:9"):
        render(Scene.builtin("boxes"), cluster="tcp://127.0.0.1:9")


@pytest.mark.parametrize("partitions", [None, 2])
def test_a_cluster_without_workers_is_told(monkeypatch, partitions):
    from distributed import Client, LocalCluster

    monkeypatch.setattr(tasks, "FIRST_WORKER", 0.2)
    with (
        LocalCluster(n_workers=0, processes=False, dashboard_address=None) as cluster,
        Client(cluster, set_as_default=False) as client,
        pytest.raises(ClusterError, match="the cluster has no workers: start some by `dask worker "),
    ):
        render(Scene.builtin("boxes"), (4, 4), backend="numpy", cluster=client, partitions=partitions)


def test_connections_that_close_while_the_workers_end_are_not_logged(monkeypatch, caplog):
    logger = logging.getLogger("distributed.batched")  # Dask's loggers do not reach the root once it is imported
    told = logger.info

    @contextmanager
    def workers(count):
        yield count
        told("Batched Comm Closed")

    class Client(nullcontext):
        def __init__(self, cluster, **options):
            super().__init__(Mock())

    monkeypatch.setattr(connection, "_workers", workers)
    monkeypatch.setattr(connection, "_distributed", lambda: Mock(Client=Client))
    monkeypatch.setattr(logger, "handlers", [caplog.handler])
    monkeypatch.setattr(logger, "propagate", False)
    caplog.set_level(logging.INFO, logger=logger.name)
    with connection.connected("local:2"):
        pass
    assert not caplog.records
    told("another")
    assert [record.message for record in caplog.records] == ["another"]


def test_without_dask_the_command_that_installs_it_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ClusterError, match=r"a cluster needs Dask: .*install .*dask.*distributed"):
        render(Scene.builtin("boxes"), cluster="local:1")


def changed(name):
    """Make this process one whose processor rounds differently; None: itself again."""
    from raytracer.cluster import job, tasks

    tasks.forget()
    own = job.__dict__.setdefault("own", job.probed)
    job.probed = (lambda *_: name) if name else own


def test_workers_that_compute_different_bits_are_refused(client):
    first = next(iter(client.nthreads()))
    client.run(changed, None)
    client.run(changed, "another", workers=[first])
    try:
        with pytest.raises(ClusterError, match="workers compute different bits with math='relaxed' on numpy"):
            render(Scene.builtin("boxes"), (64, 64), backend="numpy", math="relaxed", cluster=client, tile_rows=1)
    finally:
        client.run(changed, None)


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_its_unfinished_tasks_alone(client):
    scene, given = Scene.builtin("cornell"), {"integrator": Path(samples=5, seed=5), "backend": "numpy"}
    pids = list(client.run(os.getpid).values())
    killed = []

    def kill(done, rows):
        if not killed and done > 5:
            killed.append(pids[0])
            os.kill(pids[0], signal.SIGKILL)

    found = render(scene, (20, 30), cluster=client, tile_rows=1, progress=kill, **given)
    assert killed
    assert_same(found, render(scene, (20, 30), **given))


@pytest.mark.slow
def test_pictures_with_workers_killed_at_twenty_moments_are_the_same(client):
    """Each run loses a worker after another number of tiles, or of milliseconds within one."""
    scene, given = Scene.builtin("cornell"), {"integrator": Path(samples=5, seed=5), "backend": "numpy"}
    wanted = render(scene, (20, 30), **given)
    random = np.random.default_rng(5)
    started = time.monotonic()
    assert_same(render(scene, (20, 30), cluster=client, tile_rows=1, **given), wanted)
    seconds = time.monotonic() - started
    for _ in range(20):
        timer = threading.Timer(random.uniform(0, seconds), os.kill, (random.choice(processes(client)), signal.SIGKILL))
        timer.start()
        found = render(scene, (20, 30), cluster=client, tile_rows=1, **given)
        timer.join()
        assert_same(found, wanted)


def processes(client):
    """Return the processes of two workers that answer: one that was just killed is still listed."""
    end = time.monotonic() + HANGING
    while True:
        client.wait_for_workers(2, timeout=HANGING)
        try:
            return [int(pid) for pid in client.run(os.getpid).values()]
        except OSError:
            if time.monotonic() > end:
                raise
            time.sleep(0.1)


def features():
    import numpy._core._multiarray_umath as core

    return sorted(name for name, there in core.__cpu_features__.items() if there)


@pytest.mark.slow
def test_a_cluster_of_different_processors_is_the_same_in_strict_and_refused_in_relaxed_mode():
    """One of two workers has numpy leave out the wide instructions of this processor."""
    from distributed import Client, LocalCluster

    narrow = {"NPY_DISABLE_CPU_FEATURES": " ".join(WIDE)}
    with (
        LocalCluster(n_workers=0, dashboard_address=":0") as cluster,
        Client(cluster) as client,
    ):
        words = [sys.executable, "-m", "dask", "worker", cluster.scheduler_address, "--nthreads", "1", "--no-dashboard"]
        folder = os.path.dirname(__file__)  # `features` comes from this file, which imports from both folders
        path = os.pathsep.join([folder, os.path.dirname(folder)])
        here = {**os.environ, "PYTHONPATH": path, "DASK_LOGGING__DISTRIBUTED": "critical"}
        workers = [subprocess.Popen(words, env={**here, **env}) for env in ({}, narrow)]
        try:
            client.wait_for_workers(2, timeout=HANGING)
            one, other = client.run(features).values()
            given = {"integrator": Path(samples=4), "backend": "numpy"}
            scene = Scene.builtin("cornell")
            assert_same(render(scene, (32, 32), cluster=client, tile_rows=1, **given), render(scene, (32, 32), **given))
            if one != other:
                given["integrator"] = Path(samples=4, math="relaxed")
                with pytest.raises(ClusterError, match="workers compute different bits with math='relaxed'"):
                    render(scene, (32, 32), cluster=client, tile_rows=1, **given)
        finally:
            for worker in workers:
                worker.terminate()
                worker.wait()


WIDE = ("AVX512_ICL", "AVX512_CNL", "AVX512_CLX", "AVX512_SKX", "AVX512F", "AVX2", "FMA3", "X86_V3", "X86_V4")
