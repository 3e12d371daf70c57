"""A session: one version of a scene in a worker, and the frames of it.

Stage: the command line. `shpy.view.child` calls it from one thread; `wake` is called from others when a renderer is
made, and when the camera has come to rest.

    session = Session(request, wake, tell)
    session.set({"size": [640, 360], "scene": {"camera": {"position": [0, 2, 8], …}}})
    header, pixels = session.next()          # None where the page has what there is
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.errors import SceneError
from raytracer.image import MOST_STOPS
from raytracer.integrators.integrator import INTEGRATORS
from raytracer.integrators.renderer import Renderer
from raytracer.scene.camera import Camera
from raytracer.view.command import chosen, options_of
from raytracer.view.editing import Edits
from raytracer.view.opening import open_scene
from raytracer.view.refining import Drawer, Form, Piece, Refinement, Renderers
from raytracer.view.texts import Shown

_REST: Final = 0.15
"""Seconds without a change until a coarse picture is refined: a piece that is under way delays the next answer."""
_STEP: Final = 1 / 24
"""Seconds of a single step."""
_EXPOSURE: Final = {
    "name": "exposure",
    "title": "exposure",
    "description": "brighter by 2 to this power",
    "form": "number",
    "range": [-6.0, 6.0],
    "step": 0.1,
    "whole": False,
    "bounded": False,
}
Vector = NDArray[np.float64]


class Session(sh.view.Live):
    """The frames of one scene, as the state of the view asks for them."""

    def __init__(
        self, request: dict[str, Any], wake: Callable[[], None], tell: Callable[[dict[str, Any]], None]
    ) -> None:
        """Open the scene. Raises SceneError, and whatever reading a file raises."""
        self.options = options_of(request)
        super().__init__(request, wake, self.options.backend or sh.view.preferred())
        with sh.view.noted(Path(request["path"])):
            self.opened = open_scene(self.options)
        first = self.opened.make(0.0)
        self.edits = Edits(first)
        self._integrators = {kind: chosen(self.options, kind) for kind in INTEGRATORS}
        self._kind = self.options.integrator
        self.camera: Camera | None = None
        """The camera that the page has turned; None for the scene's."""
        self.stamp: Any = None
        """The mark that the page sent with the last camera: it tells which frame shows it."""
        self.stops = self._stops = float(self.options.exposure or 0.0)
        self._renderers = Renderers(wake)
        self._refinement: Refinement | None = None
        self._drawer: Drawer | None = None
        self._scene = first
        self._exposed, self._waking = False, False
        self._moved = time.monotonic()

    # The state

    @property
    def form(self) -> Form:
        """The backend and the integrator that the page has chosen."""
        return Form(self.backend, self._integrators[self._kind])

    @property
    def seen(self) -> Camera:
        """The camera of the picture."""
        camera = self.camera or self._scene.camera
        assert camera is not None  # a Scene sets its own camera by default
        return camera

    def describe(self) -> dict[str, Any]:
        """Return the description of this version for the page: names, camera, controls and choices."""
        return {
            "program": self.request["name"],
            "triangles": self._scene.triangles,
            "camera": dataclasses.asdict(self.opened.make(0.0).camera or self.seen),
            **self.edits.describe(),
            "exposure": {**_EXPOSURE, "value": [self._stops], "first": [self._stops]},
            "seconds": self.opened.seconds,
            "backends": sh.view.available(),
            "integrators": list(INTEGRATORS),
            "backend": self.backend,
            "integrator": self._kind,
            "notices": list(self.opened.notices),
        }

    def files(self) -> list[str]:
        """Return the files to watch: the scene is opened again when one of them changes."""
        return files_of(self.request)

    def set(self, changes: dict[str, Any]) -> list[str]:
        """Change the state of the view; return the messages of what is refused."""
        params = dict(changes.get("params", {}))
        exposure = params.pop("exposure", [self.stops])
        stops = self._stops if exposure is None else float(exposure[0])
        refused = self.edits.set(params)
        if not abs(stops) <= MOST_STOPS:
            refused.append(f"an exposure is a number from -{MOST_STOPS:g} to {MOST_STOPS:g}, not {stops:g}")
        elif stops != self.stops:
            self.stops, self._exposed = stops, True
        mark = self.mark
        refused += super().set(changes)
        self._exposed |= mark != self.mark
        if "scene" in changes:
            try:
                self._look(changes["scene"])
            except (SceneError, KeyError, TypeError, ValueError) as error:
                refused.append(str(error))
        self._moved = time.monotonic()
        self._changed |= bool(set(changes) - {"params", "mark"}) or bool(params) or not changes
        return refused

    def _look(self, scene: dict[str, Any]) -> None:
        """Take the camera and the integrator that the page sends."""
        kind = scene.get("integrator") or self._kind
        if kind not in INTEGRATORS:
            raise SceneError(f"the integrator is one of {', '.join(INTEGRATORS)}, not {kind!r}")
        self._kind, self.stamp = kind, scene.get("stamp")
        camera = scene.get("camera")
        if camera is None:
            self.camera = None
            return
        places = {name: tuple(map(float, camera[name])) for name in ("position", "target", "up")}
        numbers = {name: float(camera[name]) for name in ("fov", "span")}
        # Directions that a calibration fixes would not follow.
        self.camera = dataclasses.replace(self.seen, **places, **numbers, intrinsics=None)  # type: ignore[arg-type]

    def woken(self) -> None:
        """Note that a renderer has been made, or that it is time to refine."""
        self._waking = False
        if self._drawer is None or (self._drawer.form != self.form and self._renderers.is_ready(self.form)):
            self._changed = True

    # Frames

    def next(self) -> tuple[dict[str, Any], NDArray[np.uint8]] | None:
        """Return the header and the pixels (height, width, 4) of the next frame; None while there is nothing new."""
        if self.opened.seconds and (self.playing or self._single):
            self._go_on()
        if self._changed and not self._begin():
            return None
        refinement = self._refinement
        if refinement is None:
            return None
        if self._exposed and refinement.layers:
            self._exposed = False
            refinement.expose(self.stops)
            return self._frame(refinement, None)
        if refinement.layers and self._is_resting(refinement):
            return None
        piece = next(refinement, None)
        return None if piece is None else self._frame(refinement, piece)

    def _begin(self) -> bool:
        """Begin a picture of the present state; return False while there is no renderer for one."""
        if self.opened.seconds:
            self._scene = self.opened.make(self.time)
        scene = self.edits.applied(self._scene)
        drawer = self._renderers.best(self.form, scene)
        if drawer is None:
            return False
        drawer.show(scene)
        self._drawer = drawer
        self._changed = self._exposed = self._single = False
        moving = bool(self.opened.seconds and self.playing)
        look = self.stops, self.options.tonemap
        self._refinement = Refinement(drawer.renderer, drawer.pace, self.size, self.seen, *look, at_once=moving)
        return True

    def _is_resting(self, refinement: Refinement) -> bool:
        """Return whether it is too early to refine; if so, start a timer that wakes the session."""
        left = self._moved + _REST - time.monotonic()
        if left <= 0 or refinement.finished:
            return False
        if not self._waking:
            self._waking = True
            self.wake_after(left)
        return True

    def _go_on(self) -> None:
        self.time = (self.time + self.passed(_STEP)) % self.opened.seconds
        self.frame += 1
        self._changed = True

    def _frame(self, refinement: Refinement, piece: Piece | None) -> tuple[dict[str, Any], NDArray[np.uint8]]:
        """Return the header and the pixels of a frame; `piece` is None where no ray was traced for it."""
        drawer, last = self._drawer, refinement.last
        assert drawer is not None  # there is a refinement
        assert last is not None  # and a picture
        height, width = refinement.shown.shape[:2]
        waiting = drawer.form != self.form and not self._renderers.is_ready(self.form)
        header = {
            "width": width,
            "height": height,
            "time": self.time,
            "frame": self.frame,
            "milliseconds": 1000 * piece.seconds if piece else 0.0,
            "form": str(drawer.form),
            "waiting": str(self.form) if waiting else None,
            "coarse": last.coarse,
            "plain": last.plain,
            "samples": last.samples,
            "of": drawer.form.integrator.samples,
            "share": last.share,
            "finished": refinement.finished,
            "odd": sh.view.counts(refinement.layers["pixels"]) if refinement.layers else {"nan": 0, "infinite": 0},
            "stamp": self.stamp,
        }
        shown = refinement.shown
        return header, sh.view.marked(shown, refinement.layers["pixels"]) if self.mark else shown

    # Questions

    def cancel(self, page: int | None) -> None:
        """Do nothing: no answer about a scene takes long."""

    def answer(self, question: dict[str, Any]) -> tuple[dict[str, Any], Any]:
        """Return the answer to a question about the picture, with bytes behind it."""
        match question["about"]:
            case "object":
                return self._object(question["at"]), b""
            case "surface":
                return self._surface(question["at"]), b""
            case "camera":
                return self._camera_texts(), b""
            case "picture":
                return {}, sh.view.png_of(self._refinement.shown if self._refinement else np.zeros((1, 1, 4), np.uint8))
            case "text":
                return self._texts(), b""
            case other:
                return {"problem": f"there is no answer about {other}"}, b""

    def _object(self, at: list[int]) -> dict[str, Any]:
        """Return the object at a pixel, from the layers of the picture, without tracing a ray; None for no object."""
        if self._refinement is None or not self._refinement.layers:
            return {"at": at, "number": None}
        row, column = self._inside(at)
        numbers = self._refinement.layers["object_id"]
        height, width = numbers.shape
        number = int(numbers[row * height // self.size[1], column * width // self.size[0]])
        if number < 0:
            return {"at": at, "number": None}
        return {"at": at, "number": number, **self._names(number)}

    def _surface(self, at: list[int]) -> dict[str, Any]:
        """Return what is known of the surface of a pixel."""
        if self._drawer is None or self._refinement is None:
            return {"at": at, "number": None}
        seen = surface(self._drawer.renderer, self._refinement.camera, self.size, self._inside(at))
        return seen if seen["number"] is None else {**seen, **self._names(seen["number"])}

    def _camera_texts(self) -> dict[str, Any]:
        meshes, lights = self.edits.changed(self._scene)
        length = self.opened.seconds or None
        shown = Shown(
            self.options,
            self.size,
            self.backend,
            self.form.integrator,
            self.camera,
            self.seen,
            self.stops,
            time=self.time if length else None,
            length=length,
            meshes=meshes,
            lights=lights,
        )
        texts = {"code": shown.camera(), "command": shown.command(), "picture": shown.code(), "note": shown.note()}
        return {**texts, "animation": shown.animation()}

    def _texts(self) -> dict[str, Any]:
        """Return the text that is emitted for the tracer."""
        if self._drawer is None:
            return {"problem": "nothing is compiled yet"}
        staged, kernel = self._drawer.renderer.staged, self._drawer.renderer.kernel
        kernels = [kernel] if staged is None else staged.kernels.values()
        texts = [{"name": each.recorded.module.name, "text": each.source} for each in kernels]
        return {"form": str(self._drawer.form), "texts": texts}

    def _names(self, number: int) -> dict[str, Any]:
        return {"object": self._scene.meshes[number].name, "material": self.edits.label(self._scene, number)}

    def _inside(self, at: list[int]) -> tuple[int, int]:
        row, column = (min(n, most - 1) for n, most in zip(at, (self.size[1], self.size[0]), strict=True))
        return row, column

    def explain(self, error: BaseException) -> dict[str, Any]:
        """Return an error for the page."""
        return explained(error, self.request)


def eye_ray(camera: Camera, size: tuple[int, int], at: tuple[int, int]) -> tuple[Vector, Vector]:
    """Return the origin and the unit direction of the eye ray through the middle of a pixel (row, column)."""
    width, height = size
    row, column = at[0] + 0.5, at[1] + 0.5
    uniforms = camera.uniforms(width, height, np.zeros(3), 1.0)
    eye = np.asarray(uniforms["eye"], np.float64)
    if camera.projection == "panorama":
        azimuth, altitude = 2 * math.pi * (column / width - 0.5), math.pi * (0.5 - row / height)
        level = math.sin(azimuth) * uniforms["right"] + math.cos(azimuth) * uniforms["forward"]
        return eye, math.cos(altitude) * level + math.sin(altitude) * uniforms["above"]
    aside = column * uniforms["across"] + row * uniforms["down"]
    if camera.projection == "orthographic":
        return eye + aside, uniforms["corner"]
    ray = uniforms["corner"] + aside
    return eye, ray / np.linalg.norm(ray)


def surface(renderer: Renderer, camera: Camera, size: tuple[int, int], at: tuple[int, int]) -> dict[str, Any]:
    """Return the object, position, normal and distance of what a pixel (row, column) shows; object None for nothing.

    With path tracing the distance is that of the first sample, which lies elsewhere in the pixel.
    """
    layers = renderer.rows(size, at[0], 1, camera=camera, samples=1)
    number, distance = int(layers["object_id"][0, at[1]]), float(layers["depth"][0, at[1]])
    if number < 0:
        return {"at": list(at), "number": None}
    origin, ray = eye_ray(camera, size, at)
    return {
        "at": list(at),
        "number": number,
        "object": renderer.scene.meshes[number].name,
        "position": origin + distance * ray,
        "normal": layers["normal"][0, at[1]],
        "distance": distance,
    }


def explained(error: BaseException, request: dict[str, Any]) -> dict[str, Any]:
    """Return an error for the page: of a Python file with the line of the mistake itself."""
    path = Path(request["path"])
    mistake = error.__cause__ if isinstance(error, SceneError) and path.suffix == ".py" else None
    return sh.view.explain(mistake or error, path)


def explain_opening(error: BaseException, request: dict[str, Any]) -> dict[str, Any]:
    """Return the error of a scene that cannot be opened, for the page, and the files to watch."""
    return {**explained(error, request), "files": files_of(request)}


def files_of(request: dict[str, Any]) -> list[str]:
    """Return the files that are watched: what this process has read in the scene's folder, and pictures of skies."""
    skies = (request["options"].get(name) for name in ("environment", "background"))
    return [*map(str, sh.view.files_read()), *(sky for sky in skies if isinstance(sky, str))]


def warm() -> None:
    """Open the devices, and import the modules of a session."""
    sh.view.warm()
