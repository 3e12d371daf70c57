"""The picture of a view as text: a command of `raytracer`, and Python code, which give it again to the bit.

Stage: the command line, in the worker.

    Shown(options, size, backend, integrator, camera, seen, stops, moment).command()    # raytracer render glass …
"""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from raytracer import viewing
from raytracer.animation import ANIMATIONS, spread
from raytracer.integrators.integrator import Integrator, Path as PathTracing, Staged
from raytracer.scene.camera import Camera
from raytracer.scene.loading import FORMATS
from raytracer.scenes import SCENES

_PLACES = ("camera", "target", "up", "fov")


@dataclass(frozen=True)
class Shown:
    """The state of a view: the options of the command line, and the later choices of the page.

    `turned` is the camera that the page has turned, None for that of the scene; `seen` is the one of the picture.
    `time` is that of a scene that moves, and `length` its seconds; both are None for a still one. `changes` are the
    fields of materials, by the numbers of the meshes, and of lights, by their places, that the page has changed.
    """

    options: argparse.Namespace
    size: tuple[int, int]
    backend: str
    integrator: Integrator
    turned: Camera | None
    seen: Camera
    stops: float
    time: float | None = None
    length: float | None = None
    meshes: tuple[tuple[tuple[int, ...], Mapping[str, Any]], ...] = ()
    lights: tuple[tuple[int, Mapping[str, Any]], ...] = ()

    # The command

    def command(self) -> str:
        """Return the command that renders the picture."""
        words = ["raytracer", "render", self.options.scene]
        words += ["--size", f"{self.size[0]}x{self.size[1]}", "--backend", self.backend, *self._timed()]
        words += self._tracing()
        for name, value in self._unusual().items():
            words += [f"--{name}", str(value)]
        return shlex.join([*words, *self._seen()])

    def animation(self) -> str | None:
        """Return the command that renders the whole animation; None for a still scene."""
        if self.time is None:
            return None
        words = ["raytracer", "animate", self.options.scene, *self._clip(), "--size", f"{self.size[0]}x{self.size[1]}"]
        words += self._tracing()
        words += ["--accel", self.integrator.accel] if self.integrator.accel else []
        return shlex.join([*words, *self._seen()])

    def note(self) -> str:
        """Return the parts of a view that the command cannot express; empty where it gives the picture to the bit."""
        notes = []
        if self.meshes or self.lights:
            notes.append("No option changes materials and lights: the code has them.")
        if self.turned is not None and self.seen.projection == "orthographic":
            notes.append("No option gives the span of an orthographic camera: the code has it.")
        return " ".join(notes)

    @property
    def _is_path(self) -> bool:
        return isinstance(self.integrator, PathTracing)

    def _tracing(self) -> list[str]:
        """Return the options that name the integrator."""
        if self._is_path:
            return ["--integrator", "path"]
        return ["--tracer", "staged"] if isinstance(self.integrator, Staged) else []

    def _clip(self) -> list[str]:
        return ["--clip", self.options.clip] if self.options.clip else []

    def _timed(self) -> list[str]:
        return [] if self.time is None else [*self._clip(), "--time", repr(self.time)]

    def _unusual(self) -> dict[str, Any]:
        """Return the numbers of the integrator that are not its default."""
        numbers = {
            field.name: (getattr(self.integrator, field.name), field.default) for field in fields(self.integrator)
        }
        return {
            name: numbers[name][0] for name in ("bounces", "samples", "accel") if numbers[name][0] != numbers[name][1]
        }

    def _placed(self) -> dict[str, Any]:
        """Return the options of the camera: those of the command line until the page turns it."""
        if self.turned is None:
            options = {name: getattr(self.options, name) for name in _PLACES}
            return {name: value for name, value in options.items() if value is not None}
        camera = {"camera": self.seen.position, "target": self.seen.target, "up": self.seen.up}
        return camera | ({"fov": self.seen.fov} if self.seen.projection == "perspective" else {})

    def _seen(self) -> list[str]:
        """Return the options of the camera and of what is seen."""
        options, arguments = self.options, []
        for name, value in self._placed().items():
            arguments += [f"--{name}", _numbers(value) if isinstance(value, tuple) else str(value)]
        arguments += ["--exposure", repr(self.stops)] if self.stops else []
        arguments += [word for name, curve in self._curve().items() for word in (f"--{name}", curve)]
        arguments += ["--variant", options.variant] if options.variant is not None else []
        arguments += ["--multiscatter"] if options.multiscatter else []
        arguments += ["--no-floor"] if options.no_floor else []
        arguments += ["--strict"] if options.strict else []
        shown = options.background
        if shown is not None:
            arguments += ["--background", str(shown) if isinstance(shown, Path) else _numbers(shown)]
        arguments += ["--environment", str(options.environment)] if options.environment is not None else []
        arguments += ["--rotation", repr(options.rotation)] if options.rotation is not None else []
        return arguments

    def _curve(self) -> dict[str, str]:
        """Return the curve of the command line, where it names one."""
        return {} if self.options.tonemap == "none" else {"tonemap": self.options.tonemap}

    # The code

    def camera(self) -> str:
        """Return the camera as code; a calibrated one is the scene's own."""
        return (
            "scene.camera  # calibrated: the scene has its intrinsics"
            if self.seen.intrinsics is not None
            else (f"Camera({_named(_fields_of(self.seen))})")
        )

    def code(self) -> str:
        """Return Python code that renders the picture, with all that the page has changed."""
        changed = [line for line in (*self._changed_meshes(), *self._changed_lights()) if line]
        lines = [*self._opening(), *self._lit(), *changed, *self._replacing()]
        integrator = f"rt.{type(self.integrator).__name__}({_named(self._unusual())})"
        lines.append(f"image = rt.render(scene, {self.size!r}, integrator={integrator}, backend={self.backend!r})")
        look = ({"exposure": self.stops} if self.stops else {}) | self._curve()
        text = "\n".join([*lines, f"image.save({', '.join(filter(None, [repr('picture.png'), _named(look)]))})"])
        heads = ["import dataclasses"] if "dataclasses." in text else []
        heads += ["import runpy"] if "runpy." in text else []
        heads += ["", "import raytracer as rt"] if heads else ["import raytracer as rt"]
        heads += ["from raytracer.animation import ANIMATIONS"] if "ANIMATIONS[" in text else []
        heads += ["from raytracer.scene.animated_file import AnimatedFile"] if "AnimatedFile(" in text else []
        return "\n".join([*heads, "", text])

    def _opening(self) -> list[str]:
        """Return the lines that make the scene of the command line."""
        options, path = self.options, Path(self.options.scene)
        if options.scene in SCENES:
            return [f"scene = rt.Scene.builtin({options.scene!r})"]
        if options.scene in ANIMATIONS:
            return [f"scene = ANIMATIONS[{options.scene!r}]({self.time!r})"]
        if path.suffix == ".py":
            return [f'scene = runpy.run_path({options.scene!r})["scene"]({self.time!r})']
        framing = _named(self._framing())
        choices = {name: value for name, value in viewing.choices(options).items() if value}
        if self.time is None:
            return [
                f"scene = rt.Scene.load({', '.join(filter(None, [repr(options.scene), framing, _named(choices)]))})"
            ]
        frames, fps = spread(self.length or 0.0, None, None)
        named = _named({**({"clip": options.clip} if options.clip else {}), **choices})
        file = f"AnimatedFile({', '.join(filter(None, [repr(options.scene), named]))})"
        make = ", ".join(filter(None, [repr(frames), repr(fps), framing]))
        return [f"scene = {file}.make({make})({self.time!r})"]

    def _framing(self) -> dict[str, Any]:
        """Return the keywords of `Scene.load` for a file."""
        options = self.options
        keywords: dict[str, Any] = {} if options.up is None else {"up": options.up}
        keywords |= {"floor": False} if options.no_floor else {}
        if options.environment is not None:
            keywords["lights"] = _Text(f"[{self._sky()}]")
        named = {"position": options.camera, "target": options.target, "up": options.up, "fov": options.fov}
        named = {name: value for name, value in named.items() if value is not None}
        if isinstance(options.camera, str | int):  # the others turn it, see `_replacing`
            keywords["camera" if self.time is None else "which"] = options.camera
        elif named:
            keywords["camera"] = _Text(f"lambda camera: dataclasses.replace(camera, {_named(named)}, intrinsics=None)")
        return keywords

    def _changed_meshes(self) -> list[str]:
        if not self.meshes:
            return []
        lines = ["meshes = list(scene.meshes)"]
        for numbers, values in self.meshes:
            numbers_text = ", ".join(map(str, numbers))
            lines.append(f"for k in [{numbers_text}]:")
            changed = f"dataclasses.replace(meshes[k].material, {_named(values)})"
            lines.append(f"    meshes[k] = meshes[k].with_material({changed})")
        return lines

    def _changed_lights(self) -> list[str]:
        if not self.lights:
            return []
        changed = (f"lights[{k}] = dataclasses.replace(lights[{k}], {_named(values)})" for k, values in self.lights)
        return ["lights = list(scene.lights)", *changed]

    @property
    def _is_framed(self) -> bool:
        return Path(self.options.scene).suffix.lower() in FORMATS

    def _lit(self) -> list[str]:
        """Return the line that lights a scene that is no file by the environment of the command line."""
        if self.options.environment is None or self._is_framed:
            return []
        return [f"scene = dataclasses.replace(scene, lights=[*scene.placed_lights, {self._sky()}])"]

    def _sky(self) -> str:
        """Return the environment light of the command line as code."""
        turn = "" if self.options.rotation is None else f", rotation={self.options.rotation!r}"
        return f"rt.EnvironmentLight({str(self.options.environment)!r}{turn})"

    def _replacing(self) -> list[str]:
        """Return the line that gives the scene what the page and the command line change."""
        options = self.options
        keywords: dict[str, Any] = {"meshes": _Text("meshes")} if self.meshes else {}
        keywords |= {"lights": _Text("lights")} if self.lights else {}
        placed = self._placed().keys() - ({"camera"} if isinstance(options.camera, str | int) else set())
        turned = isinstance(options.camera, str | int) or not self._is_framed
        if self.seen.intrinsics is None and (self.turned is not None or (turned and placed)):
            keywords["camera"] = _Text(f"rt.{self.camera()}")
        if options.background is not None:
            shown = options.background
            keywords["background"] = _Text(f"rt.Texture({str(shown)!r})") if isinstance(shown, Path) else shown
        return [f"scene = dataclasses.replace(scene, {_named(keywords)})"] if keywords else []


class _Text(str):
    """Code, in place of a value whose code is to be written."""


def _fields_of(camera: Camera) -> dict[str, Any]:
    """Return what makes a camera, without what is at its default."""
    words: dict[str, Any] = {"position": camera.position, "target": camera.target, "up": camera.up}
    words |= {"projection": camera.projection} if camera.projection != "perspective" else {}
    words |= {"span": camera.span} if camera.projection == "orthographic" else {}
    words |= {"fov": camera.fov} if camera.projection == "perspective" else {}
    words |= {"aspect": camera.aspect} if camera.aspect != 1 else {}
    return words | ({"aperture": camera.aperture, "focus": camera.focus} if camera.aperture else {})


def _named(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name}={_code(value)}" for name, value in values.items())


def _code(value: Any) -> str:
    if isinstance(value, _Text):
        return str(value)
    return f"({', '.join(f'{x!r}' for x in value)})" if isinstance(value, tuple) else repr(value)


def _numbers(values: Any) -> str:
    """Return numbers with commas between them, with as many digits as tell them from all others."""
    return ",".join(repr(float(x)).removesuffix(".0") for x in values)
