"""Several pictures by one Renderer in turns: each is the one that it would be alone."""

import copy
import dataclasses
import pickle
import threading

import numpy as np
import pytest
from scene_pictures import same

from raytracer import Camera, Material, Path, Renderer, Scene, SceneError, Staged, Whitted
from raytracer.integrators.layers import BANDS
from raytracer.meshes.shapes import floor

CAMERAS = [Camera((0.2, 1, 3.0), (0, 1, 0)), Camera((0, 1, 3.0), (0, 1, 0), aperture=0.1)]


@pytest.fixture(scope="module")
def small():
    lamp = floor(1, Material((0, 0, 0), specular=0, emission=(1, 1, 1))).moved((0, 2, 0))
    return Renderer(Scene([floor(9), lamp], camera=Camera((2, 1, 2))), backend="numpy", integrator="path", bounces=1)


@pytest.mark.slow
def test_other_pictures_between_two_passes_change_nothing(small):
    """Two progressive pictures from cameras of different kinds, and a smaller picture, by one Renderer in turns."""
    wanted = [small.render((4, 3), camera=camera, samples=40) for camera in CAMERAS]
    found = []
    for images in zip(*(small.passes((4, 3), camera=camera, samples=40) for camera in CAMERAS), strict=True):
        small.render((2, 2), samples=1)
        found.append(images)
    for image, expected in zip(found[-1], wanted, strict=True):
        same(image, expected)


def test_passes_end_where_the_scene_has_changed(small):
    scene = small.scene
    images = small.passes((4, 3), samples=40)
    next(images)
    try:
        small.show(dataclasses.replace(scene, background=(1, 0, 0)))
        with pytest.raises(SceneError, match=r"has changed since these passes began: call passes\(\) again"):
            next(images)
    finally:
        small.show(scene)


def test_each_pass_sets_the_eye_rays_once(small, monkeypatch):
    aimed, uniforms = [], Camera.uniforms
    monkeypatch.setattr(Camera, "uniforms", lambda *given: aimed.append(given) or uniforms(*given))
    assert len(list(small.passes((4, 3), samples=40))) == len(aimed) == 3
    with pytest.raises(SceneError, match=r"is a Camera, such as .*, not \(\)"):
        next(small.passes((4, 3), camera=()))


def test_passes_do_not_change_pictures_that_were_given(small):
    images = list(small.passes((4, 3), samples=40))
    assert [image.samples for image in images] == [16, 32, 40]
    same(images[0], small.render((4, 3), samples=16))
    kept = small.render((4, 3), samples=16, resume=images[0])  # no sample is added
    kept.pixels[:] = 0
    same(images[0], small.render((4, 3), samples=16))


def test_threads_that_share_a_renderer_take_turns(monkeypatch):
    """While a picture is half done, another thread asks for one from another camera, and waits."""
    monkeypatch.setitem(BANDS, "numpy", 8)
    both = Renderer(Scene([floor(9)], camera=CAMERAS[0]), backend="numpy")
    wanted = [both.render((4, 4), camera=camera) for camera in CAMERAS]
    found, threads = {}, []

    def progress(done, rows):
        if not threads:
            threads.append(threading.Thread(target=lambda: found.update({1: both.render((4, 4), camera=CAMERAS[1])})))
            threads[0].start()
            threads[0].join(0.2)

    found[0] = both.render((4, 4), camera=CAMERAS[0], progress=progress)
    threads[0].join()
    for k, image in enumerate(wanted):
        same(found[k], image)


def test_a_renderer_that_was_pickled_has_turns_of_its_own(small):
    with small.turn:
        other = pickle.loads(pickle.dumps(small))
    assert other.turn is not small.turn
    for camera in CAMERAS:
        same(other.render((4, 3), camera=camera, samples=2), small.render((4, 3), camera=camera, samples=2))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("integrator", [Whitted(), Staged(), Path(samples=2), Whitted(accel="ldc:16")])
def test_a_renderer_that_was_copied_has_a_camera_and_places_of_its_own(small, integrator):
    first = Renderer(small.scene, integrator=integrator, backend="numpy")
    places = integrator.structure != "grid"
    if places:
        first.move(0, np.diag([1.5, 1.5, 1.5, 1]))
    other = copy.deepcopy(first)
    for camera in CAMERAS:
        same(other.render((4, 3), camera=camera), first.render((4, 3), camera=camera))
    if places:
        before = first.render((4, 3))
        other.move(0, np.diag([0.5, 0.5, 0.5, 1]))
        other.render((4, 3))
        same(first.render((4, 3)), before)


@pytest.mark.parametrize(("top", "count"), [(-1, 2), (0, 4), (2, 2), (4, 0), (0, -1), (1.5, 1), (0, True)])
def test_rows_beyond_a_picture_are_refused(small, top, count):
    with pytest.raises(SceneError, match=f"a picture 3 pixels high has no {count} rows from row {top} on"):
        small.rows((4, 3), top, count)


def test_rows_of_a_picture_are_its_parts(small):
    direct = Renderer(small.scene, backend="numpy")
    for each in (small, direct):
        whole = each.render((4, 3), samples=1).layers
        for top, count in ((0, 3), (1, 2), (2, 1), (1, 0), (3, 0)):
            part = each.rows((4, 3), top, count, samples=1)
            for name, layer in whole.items():
                np.testing.assert_array_equal(part[name], layer[top : top + count])
