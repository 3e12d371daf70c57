"""The backend of a picture whose user names none: it is chosen while the scene is laid out."""

import threading

import numpy as np
import pytest
from patience import HANGING

import shpy as sh
from raytracer import Renderer, Scene, render
from raytracer.integrators import renderer as renderers
from shpy.backend import registry


@pytest.fixture(autouse=True)
def auto(monkeypatch):
    monkeypatch.setenv("SHPY_BACKEND", "auto")
    monkeypatch.setattr(registry, "_default", None)


def test_a_scene_is_laid_out_while_the_device_opens(monkeypatch):
    begun, lay_out = threading.Event(), renderers.laid_out

    def laid_out(*args):
        begun.set()
        return lay_out(*args)

    def fault():
        assert begun.wait(HANGING)

    monkeypatch.setattr(renderers, "laid_out", laid_out)
    monkeypatch.setattr(registry, "_fault_of_opencl", fault)
    renderer = Renderer(Scene.builtin("boxes"))
    assert renderer.backend == "opencl"
    assert renderer.builds == 1


@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_a_device_that_the_caller_names_opens_meanwhile(monkeypatch, backend):
    begun, opened, lay_out = threading.Event(), threading.Event(), renderers.laid_out
    opening, empty = [], sh.Stream.empty

    def laid_out(*args):
        begun.set()
        assert opened.wait(HANGING)
        return lay_out(*args)

    def stream(shape, type_, backend=None, *options):
        if not opened.is_set():
            opening.append((backend, threading.current_thread()))
            assert begun.wait(HANGING)
            opened.set()
        return empty(shape, type_, backend, *options)

    monkeypatch.setattr(renderers, "laid_out", laid_out)
    monkeypatch.setattr(sh.Stream, "empty", stream)
    assert Renderer(Scene.builtin("boxes"), backend=backend).backend == backend
    ((name, thread),) = opening
    assert name == backend
    assert thread is not threading.current_thread()


@pytest.mark.sampled(2)
@pytest.mark.parametrize("options", [{}, {"accel": "ldc:16"}])
def test_numpy_takes_the_tables_where_opencl_cannot(monkeypatch, options):
    monkeypatch.setattr(registry, "_fault_of_opencl", lambda: "a device gets it wrong")
    scene = Scene.builtin("boxes")
    image, expected = (render(scene, (16, 12), backend=backend, **options) for backend in (None, "numpy"))
    assert image.stats.backend == "numpy"
    np.testing.assert_array_equal(image.pixels, expected.pixels)


def test_an_empty_scene_has_the_chosen_backend():
    assert Renderer(Scene([])).backend == "opencl"


def test_errors_of_the_choice_are_those_of_the_caller(monkeypatch):
    monkeypatch.setenv("SHPY_BACKEND", "nonsense")
    with pytest.raises(sh.BackendUnavailable, match="SHPY_BACKEND names no backend"):
        Renderer(Scene.builtin("boxes"))


@pytest.mark.parametrize("settings", [{}, {"SHPY_BACKEND": "numpy"}], ids=["named", "pinned"])
def test_numpy_opens_no_device(monkeypatch, settings):
    def refuse(*_):
        raise AssertionError("a device is opened")

    for name, value in settings.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(registry, "_fault_of_opencl", refuse)
    monkeypatch.setattr(sh.Stream, "empty", refuse)
    before = set(threading.enumerate())  # threads of earlier tests may end meanwhile
    renderer = Renderer(Scene.builtin("boxes"), backend=None if settings else "numpy")
    assert renderer.backend == "numpy"
    assert set(threading.enumerate()) <= before


def test_errors_of_a_device_that_the_caller_names_are_those_of_the_kernel():
    with pytest.raises(sh.ShpyError, match="'nonsense'"):
        Renderer(Scene.builtin("boxes"), backend="nonsense")
