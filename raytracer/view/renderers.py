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
        self._found: dict[Form, Any] = {}
        self._begun: set[Form] = set()
        self._last: Drawer | None = None

    def best(self, wanted: Form, scene: Scene) -> Drawer | None:
        """Return the wanted drawer; until it is made, the last one used, or None if there is none.

        Raises the error with which the wanted drawer could not be made.
        """
        if wanted not in self._begun:
            self._begun.add(wanted)
            threading.Thread(target=self._make, args=(wanted, scene), daemon=True).start()
        found = self._found.get(wanted)
        if isinstance(found, Exception):
            # Another scene, such as one without an environment light, may be possible.
            self._begun.discard(wanted)
            del self._found[wanted]
            raise found
        if found is not None:
            self._last = found
        return self._last

    def is_ready(self, form: Form) -> bool:
        """Return whether a form has been made, or has failed."""
        return form in self._found

    def _make(self, form: Form, scene: Scene) -> None:
        try:
            renderer = Renderer(scene, integrator=form.integrator, backend=form.backend)
            made: Any = Drawer(form, renderer, scene)
        except Exception as error:  # of a driver too: the page shows it
            made = error
        self._found[form] = made
        self._wake()
