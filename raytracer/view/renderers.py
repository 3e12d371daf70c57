"""The renderers of a view by backend and integrator, each made in a thread while the last one goes on.

Stage: the command line, in the worker.

    renderers = Renderers(wake)
    renderers.best(Form("opencl", Whitted()), scene)     # until it is made: the last renderer, or None
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

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
        self._wake = wake
        self._results: dict[Form, Any] = {}
        self._begun: set[Form] = set()
        self._last: Drawer | None = None

    def best(self, form: Form, scene: Scene) -> Drawer | None:
        """Return the wanted drawer; until it is made, the last one used, or None if there is none.

        Raises the error with which the wanted drawer could not be made.
        """
        if form not in self._begun:
            self._begun.add(form)
            threading.Thread(target=self._make, args=(form, scene), daemon=True).start()
        result = self._results.get(form)
        if isinstance(result, Exception):
            # Another scene, such as one without an environment light, may be possible.
            self._begun.discard(form)
            del self._results[form]
            raise result
        if result is not None:
            self._last = result
        return self._last

    def is_ready(self, form: Form) -> bool:
        """Return whether a form has been made, or has failed."""
        return form in self._results

    def _make(self, form: Form, scene: Scene) -> None:
        try:
            renderer = Renderer(scene, integrator=form.integrator, backend=form.backend)
            result: Any = Drawer(form, renderer, scene)
        except Exception as error:  # of a driver too: the page shows it
            result = error
        self._results[form] = result
        self._wake()
