"""The renderers of a view by backend and integrator, each made in a thread while the last one goes on.

Stage: the command line, in the worker.

    renderers = Renderers(wake)
    renderers.best(Form("opencl", Whitted()), scene)     # until it is made: the last renderer, or None
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import shpy as sh
from raytracer.integrators.integrator import Integrator
from raytracer.integrators.renderer import Renderer
from raytracer.scene.scene import Scene
from raytracer.view.refining import Pace


@dataclass(frozen=True, slots=True)
class Form:
    """A backend and an integrator, as a `Renderer` takes them."""

    backend: str
    integrator: Integrator

    def __str__(self) -> str:
        return f"{type(self.integrator).__name__} on {self.backend}"


@dataclass(eq=False)
class Drawer:
    """A renderer, the scene that it shows, and how long its rays take."""

    form: Form
    renderer: Renderer
    scene: Scene
    pace: Pace = field(default_factory=Pace)

    def show(self, scene: Scene) -> None:
        """Switch to another scene, from the next picture on."""
        if scene is not self.scene:
            self.renderer.show(scene)
            self.scene = scene


class Renderers:
    """Renderers by their form, each made in a thread; a form that failed keeps its error until it is asked for."""

    def __init__(self, wake: Callable[[], None]) -> None:
        self._drawers: sh.view.Background[Form, Drawer] = sh.view.Background(wake)
        self._last: Drawer | None = None

    def best(self, form: Form, scene: Scene) -> Drawer | None:
        """Return the wanted drawer; until it is made, the last one used, or None if there is none.

        Raises the error with which the wanted drawer could not be made.
        """
        self._drawers.begin(form, partial(_make, form, scene))
        error = self._drawers.error(form)
        if error is not None:
            # Another scene, such as one without an environment light, may be possible.
            self._drawers.forget(form)
            raise error
        if self._drawers.is_done(form):
            self._last = self._drawers.result(form)
        return self._last

    def is_ready(self, form: Form) -> bool:
        """Return whether a form has been made, or has failed."""
        return self._drawers.has_ended(form)


def _make(form: Form, scene: Scene) -> Drawer:
    return Drawer(form, Renderer(scene, integrator=form.integrator, backend=form.backend), scene)
