"""Pictures of scenes that are cut into parts, each held by one worker, have the bits of one process."""

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from gltf_files import textured
from patience import HANGING
from scene_pictures import same

import shpy as sh
from raytracer import (
    Camera,
    ClusterError,
    DirectionalLight,
    EnvironmentLight,
    Material,
    Mesh,
    MetallicRoughness,
    Path,
    PointLight,
    Scene,
    SceneError,
    SpotLight,
    Staged,
    Surface,
    Texture,
    Unlit,
    render,
)
from raytracer.cluster import connection, part, partitioned
from raytracer.cluster.part import Records, next_part
from raytracer.cluster.partitioned import _groups
from raytracer.integrators.integrator import Whitted
from raytracer.integrators.layers import BANDS
from raytracer.meshes.shapes import box, floor, sphere


@pytest.fixture(scope="module")
def client():
    with connection.connected("local:2") as found:
        yield found


def striped(hit):
    return Surface(color=sh.cond(sh.fract(4 * hit.position.x) < 0.5, sh.Color3f(0.9), sh.Color3f(0.1)))


def numbered(hit):
    return Surface(color=sh.Color3f(0.01 * sh.Attrib1f(hit.triangle)))


def sky(direction):
    return sh.Color3f(0.4, 0.5, 0.5 + 0.5 * direction.y)


def mirrors():
    """Boxes and balls that share faces, edges and corners, with lights, mirrors, programs, a texture and an Unlit."""
    mirror = Material((0.9, 0.9, 0.9), reflectivity=0.7)
    picture = Material(Texture(np.random.default_rng(0).random((4, 4, 3))))
    meshes = (
        box((1, 1, 1), mirror),
        box((1, 1, 1), Material(surface=striped)).moved((1, 0, 0)),
        box((1, 1, 1), mirror).moved((1, 0, 0)),  # each of its triangles twice: ties are broken by the number
        sphere(0.7, Material((0.8, 0.2, 0.1), specular=0.6), rings=6, segments=8).moved((-0.5, 1.2, 0)),
        box((0.5, 2, 0.5), Material(cutout=Texture(np.eye(4)))).moved((-1.5, 0.5, 1)),
        sphere(0.3, Material(surface=numbered), rings=3, segments=4).moved((1, 1.2, 0.5)),
        sphere(0.3, Unlit((0.2, 0.7, 0.9)), rings=3, segments=4).moved((-1.2, 1.5, -0.5)),
        floor(9, picture).moved((0, -0.5, 0)),
    )
    lights = (PointLight((3, 6, 5), (0.8, 0.8, 0.7)), SpotLight((-4, 5, 3), (4, -5, -3), 5, 30, (9, 9, 12), range=20.0))
    return Scene(meshes, lights, background=sky)


@pytest.mark.slow
@pytest.mark.parametrize("parts", [8, 1, 2, 4])
def test_any_number_of_parts_makes_the_same_picture(client, parts):
    given = {"integrator": Whitted(bounces=2), "backend": "numpy"}
    found = render(mirrors(), (18, 13), cluster=client, partitions=parts, **given)
    wanted = render(mirrors(), (18, 13), **given)
    same(found, wanted)
    assert found.stats.rays == wanted.stats.rays
    moved = found.stats.moved
    assert moved["traced"] >= found.stats.rays - 18 * 13
    assert (moved["records"] > 0) == (moved["bytes"] > 0) == (parts > 1)
    assert (moved["rounds"] == 1) == (parts == 1)


def layers():
    """Balls of layered materials, of coloured mirrors, and of textures in their slots, which show each other."""
    picture = Texture(np.random.default_rng(2).random((4, 4, 3)))
    materials = (
        MetallicRoughness((1, 0.77, 0.34), 1, 0.1),
        MetallicRoughness((0.2, 0.4, 0.9), 0, picture, clearcoat=1, sheen_color=(0.4, 0.2, 0.1), sheen_roughness=0.6),
        Material((0.2, 0.9, 0.3), reflectivity=(0.7, 0.2, 0.4)),
        MetallicRoughness((0.8, 0.8, 0.8), 0.5, 0.6, emission=(0, 0.2, 0.1), anisotropy=0.7),
    )
    balls = [sphere(0.6, m, rings=6, segments=8).moved((k % 2, k // 2, -0.3 * k)) for k, m in enumerate(materials)]
    return [*balls, floor(9, MetallicRoughness(picture, 0, 0.4)).moved((0, -0.5, 0))]


@pytest.mark.slow
@pytest.mark.parametrize("around", [False, True])
def test_parts_of_layered_materials_and_coloured_mirrors_make_the_same_picture(client, around):
    light = EnvironmentLight(sky, rotation=30) if around else DirectionalLight((-1, -2, -1))
    scene = Scene(layers(), [light, PointLight((3, 4, 5))], Camera((0.5, 1, 5), (0.5, 0.5, 0), fov=50))
    options = {"integrator": Whitted(bounces=2), "backend": "numpy"}
    whole = render(scene, (18, 13), **options)
    same(render(scene, (18, 13), cluster=client, partitions=3, **options), whole)


@pytest.mark.slow
def test_a_gltf_file_is_rendered_in_parts(client, tmp_path):
    scene = Scene.load(textured().save(tmp_path / "tiles.glb"))
    options = {"integrator": Whitted(bounces=1), "backend": "numpy"}
    same(render(scene, (12, 9), cluster=client, partitions=2, **options), render(scene, (12, 9), **options))


def test_a_part_holds_its_own_triangles_alone():
    random = np.random.default_rng(3)
    centres = random.random((1000, 3)) * (9, 1, 1)
    groups = _groups(centres, np.arange(1000), 7)
    assert sorted(np.concatenate(groups).tolist()) == list(range(1000))
    assert max(map(len, groups)) - min(map(len, groups)) <= 3
    ends = sorted((centres[group, 0].min(), centres[group, 0].max()) for group in groups[:2])
    assert ends[0][1] <= ends[1][0]


def test_a_ray_goes_to_the_part_that_it_enters_next():
    low = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    high = low + 1

    def goals(eye, ray, reach=np.inf, last=-1):
        columns = {"ray.eye": [eye], "ray.direction": [ray], "nearest.l": [reach], "last": [last]}
        return next_part(Records({name: np.array(value) for name, value in columns.items()}), low, high).tolist()

    assert goals((-1.0, 0.5, 0.5), (1.0, 0.0, 0.0)) == [0]
    assert goals((-1.0, 0.5, 0.5), (1.0, 0.0, 0.0), last=0) == [1]
    assert goals((-1.0, 0.5, 0.5), (1.0, 0.0, 0.0), last=2) == [-1]
    assert goals((-1.0, 0.5, 0.5), (1.0, 0.0, 0.0), reach=1.5, last=0) == [-1]
    assert goals((4.0, 0.5, 0.5), (-1.0, 0.0, 0.0)) == [2]
    assert goals((1.5, 0.5, 0.5), (0.0, 0.0, 1.0)) == [1]
    assert goals((1.5, 1.5, 0.5), (0.0, 0.0, 1.0)) == [-1]
    assert goals((1.5, 0.5, 0.5), (np.nan, 0.0, 1.0)) == [-1]


def test_a_ray_visits_any_number_of_parts_once_and_in_their_order():
    low = np.random.default_rng(1).permutation(100)[:, None] * np.ones(3)
    last, visited = -1, []
    while True:
        columns = {"ray.eye": [[-1.0, -1, -1]], "ray.direction": [[1.0, 1, 1]], "nearest.l": [np.inf], "last": [last]}
        (last,) = next_part(Records({name: np.array(value) for name, value in columns.items()}), low, low + 1).tolist()
        if last < 0:
            break
        visited.append(last)
    assert visited == np.argsort(low[:, 0]).tolist()


def test_parts_are_found_for_blocks_of_rays(monkeypatch):
    monkeypatch.setattr(part, "AT_ONCE", 7)
    low = np.array([[0.0, 0, 0], [1, 0, 0]])
    eye = np.array([[0.5 + k % 2, 0.5, -1] for k in range(9)])
    rays = {"ray.eye": eye, "ray.direction": np.tile([0.0, 0, 1], (9, 1)), "nearest.l": np.full(9, np.inf)}
    rays["last"] = np.full(9, -1)
    assert next_part(Records(rays), low, low + 1).tolist() == [0, 1, 0, 1, 0, 1, 0, 1, 0]
    assert not len(next_part(Records({}), low, low + 1))


@pytest.mark.parametrize(
    ("material", "given", "message"),
    [
        (Material(transmission=1.0), {}, "this scene has glass"),
        (MetallicRoughness(transmission=0.5), {}, "this scene has glass"),
        (MetallicRoughness(alpha=0.5), {}, "this scene has glass"),
        (Material(), {"partitions": 0}, "a scene is cut into 1 to 1024 partitions, not 0"),
        (Material(), {"integrator": Path()}, 'partitions are rendered by Whitted\\(accel="bvh"\\)'),
        (Material(), {"integrator": Staged()}, 'partitions are rendered by Whitted\\(accel="bvh"\\)'),
        (Material(), {"accel": "grid"}, 'partitions are rendered by Whitted\\(accel="bvh"\\)'),
        (Material(), {"accel": "ldc:32"}, 'partitions are rendered by Whitted\\(accel="bvh"\\)'),
        (Material(), {"precision": "f16"}, 'partitions work at precision="f32" or "f64"'),
        (Material(), {"tile_rows": 2}, "resume and tile_rows are for scenes that every worker holds"),
        (Material(), {"cluster": None}, "tile_rows and partitions are for the workers of a cluster"),
    ],
)
def test_what_partitions_cannot_render_is_refused(client, material, given, message):
    scene = Scene(box((1, 1, 1), material))
    with pytest.raises(SceneError, match=message):
        render(scene, (4, 4), backend="numpy", **{"cluster": client, "partitions": 2, **given})


def test_a_camera_too_far_away_for_f32_is_named(client):
    cube = box()
    tiny = Scene([Mesh(cube.vertices * 1e-29, cube.faces)], [PointLight((0, 0, 5e-29))], Camera((0, 0, 4), (0, 0, 0)))
    with pytest.raises(SceneError, match=r"the camera at \(0, 0, 4\) is too far away for a scene of this size"):
        render(tiny, (4, 4), backend="numpy", cluster=client, partitions=2)


def test_the_parts_of_a_worker_that_is_killed_go_to_others(client, monkeypatch):
    monkeypatch.setitem(BANDS, "parts", 60)
    given = {"integrator": Whitted(bounces=2), "backend": "numpy"}
    pids, killed = list(client.run(os.getpid).values()), []

    def kill(done, rows):
        if not killed:
            killed.append(pids[0])
            os.kill(pids[0], signal.SIGKILL)

    found = render(mirrors(), (18, 13), cluster=client, partitions=4, progress=kill, **given)
    assert killed
    same(found, render(mirrors(), (18, 13), **given))


def test_the_loss_of_workers_again_and_again_over_the_same_band_is_told(client, monkeypatch):
    from distributed import CancelledError

    tries = []

    def lost(self, *band):
        tries.append(band)
        raise CancelledError("a part")

    monkeypatch.setattr(partitioned._Run, "_traced", lost)
    with pytest.raises(ClusterError, match="the cluster has lost or cancelled a task"):
        render(mirrors(), (4, 4), cluster=client, partitions=2, backend="numpy")
    assert tries == [(0, 4, 4)] * 4


@pytest.mark.slow
def test_pictures_of_parts_with_workers_killed_at_twenty_moments_are_the_same(client, monkeypatch):
    """Each run loses a worker after another number of milliseconds."""
    monkeypatch.setitem(BANDS, "parts", 4000)
    given = {"integrator": Whitted(bounces=2), "backend": "numpy"}
    wanted, counts = render(mirrors(), (160, 120), **given), []
    random = np.random.default_rng(5)
    for parts in (1, 2, 4, 8) * 5:
        client.wait_for_workers(2, timeout=HANGING)
        address, pid = list(client.run(os.getpid).items())[random.integers(2)]
        timer = threading.Timer(random.uniform(0, 4), os.kill, (pid, signal.SIGKILL))
        timer.start()
        found = render(mirrors(), (160, 120), cluster=client, partitions=parts, **given)
        timer.join()
        while address in client.nthreads():
            time.sleep(0.01)
        same(found, wanted)
        counts.append((parts, *found.stats.moved.values()))
    assert len(set(counts)) == 4  # what was lost is not counted


LIMIT = 400 * 10**6
"""Bytes that a worker may hold."""


def hills():
    """Return a hilly field of a million triangles."""
    across, x = 707, np.linspace(-4, 4, 708)
    height = 0.2 * np.sin(3 * x)[:, None] * np.cos(2 * x)
    vertices = np.stack(np.broadcast_arrays(x[:, None], height, x), axis=2).reshape(-1, 3)
    first = (np.arange(across)[:, None] * (across + 1) + np.arange(across)).ravel()
    faces = np.stack([first, first + 1, first + across + 2, first, first + across + 2, first + across + 1], axis=1)
    lights, camera = [PointLight((3, 6, 4), (0.8, 0.7, 0.6))], Camera((0, 3, 6), (0, -0.3, 0), fov=45)
    return Scene([Mesh(vertices, faces.reshape(-1, 3), material=Material(reflectivity=0.2))], lights, camera)


def peak():
    """Return the bytes that this process has held at most: `ru_maxrss` has those of its parent where that held more."""
    with open("/proc/self/status") as status:
        (line,) = (line for line in status if line.startswith("VmHWM:"))
    return int(line.split()[1]) * 1024


def alone(path):
    """Write the picture that one process makes, and print the bytes that it took at most."""
    np.savez(path, **render(hills(), (64, 48), backend="numpy").layers)
    print(peak())


@pytest.mark.slow
def test_a_scene_that_no_worker_may_hold_renders_by_parts(tmp_path):
    from dask.distributed import Client, LocalCluster

    folder = os.path.dirname(__file__)
    code = f"import sys; sys.path[:0] = {[folder, os.path.dirname(folder)]!r}; import test_partitions as t"
    words = [sys.executable, "-c", f"{code}; t.alone(sys.argv[1])", str(tmp_path / "alone.npz")]
    needed = int(subprocess.run(words, capture_output=True, text=True, check=True).stdout)
    assert needed > LIMIT
    with (
        LocalCluster(4, threads_per_worker=1, processes=True, memory_limit=LIMIT, dashboard_address=":0") as cluster,
        Client(cluster) as client,
    ):
        found = render(hills(), (64, 48), backend="numpy", cluster=client, partitions=8)
        peaks = client.run(peak).values()
    print(f"one process took {needed / 1e6:.0f} MB, a worker {max(peaks) / 1e6:.0f} of {LIMIT / 1e6:.0f} MB")
    assert max(peaks) < LIMIT
    for name, layer in np.load(tmp_path / "alone.npz").items():
        assert found.layers[name].tobytes() == layer.tobytes(), name
