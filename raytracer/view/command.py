"""The command `raytracer view`: a page in the browser that shows a scene, until Ctrl-C.

Stage: the command line.

    raytracer view mixed
    raytracer view chair.glb --camera 2,1,3 --integrator path --port 8001
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final

import shpy as sh
from raytracer import animation, scenes, viewing
from raytracer.animation import ANIMATIONS
from raytracer.errors import SceneError
from raytracer.integrators import integrator
from raytracer.scene.loading import FORMATS
from raytracer.scenes import SCENES

PAGE: Final = Path(__file__).with_name("page")
SAMPLES: Final = {"whitted": 16, "path": 256}
"""The samples of a pixel after which a picture is not refined further."""
_WRITTEN: Final = Path("view.png")
"""A picture such as the page shows, for the checks of options."""


def add_arguments(
    command: argparse.ArgumentParser, samples: Callable[[str], int], bounces: Callable[[str], int]
) -> None:
    """Add the arguments of `raytracer view`."""
    command.add_argument(
        "scene", help="a built-in scene, `animated`, a mesh file, or a Python file that defines scene(time) -> Scene"
    )
    sh.view.add_serving(command)
    command.add_argument("--backend", choices=("numpy", "opencl", "glsl"), help="(the fastest there is)")
    kinds = integrator.INTEGRATORS
    command.add_argument("--integrator", choices=kinds, default="whitted", help="as of render (whitted)")
    command.add_argument("--bounces", type=bounces, help="as of render")
    command.add_argument("--samples", type=samples, help="when to stop refining a pixel (16; path: 256)")
    viewing.add_tracing(command)
    command.add_argument("--clip", metavar="NAME", help="which animation of a GLB or glTF file (the first one)")
    command.add_argument(
        "--seconds", type=sh.command.real(0.01), default=10.0, help="Python files: when to begin anew (10)"
    )
    viewing.add_arguments(command)
    command.set_defaults(run=view)


def view(options: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C; return 0. Raises SceneError and sh.ShpyError for scenes that cannot be shown."""
    path, request = file_of(options.scene), request_of(options)
    chosen(options, options.integrator)
    viewing.check(options, _WRITTEN, framed=path.suffix.lower() in FORMATS)
    state = {"size": list(options.size), "backend": options.backend, "playing": False}
    report = partial(print, f"raytracer view {options.scene}:", flush=True)
    shown = sh.view.View("raytracer.view.session", request, state, (PAGE, sh.view.PAGE))
    sh.view.serve(shown, address=options.listen, port=options.port, report=report)
    return 0


def file_of(scene: str) -> Path:
    """Return the file that a scene comes from: for a built-in one, the module that makes it."""
    if scene in SCENES:
        return Path(scenes.__file__)
    if scene in ANIMATIONS:
        return Path(animation.__file__)
    if not Path(scene).is_file():
        names = ", ".join([*SCENES, *ANIMATIONS])
        raise SceneError(f"{scene!r} is neither a file nor a built-in scene; the scenes are {names}")
    return Path(scene)


def chosen(options: argparse.Namespace, kind: str) -> integrator.Integrator:
    """Return the integrator of a kind; `bounces` and `samples` of the options are for the one that they name.

    `accel` is for both kinds, and `tracer` for Whitted's, since path tracing has one alone.
    """
    numbers: dict[str, Any] = {"samples": SAMPLES[kind], "accel": options.accel}
    if kind in ("whitted", options.integrator):
        numbers["tracer"] = options.tracer
    if kind == options.integrator:
        named = {name: getattr(options, name) for name in ("bounces", "samples")}
        numbers |= {name: value for name, value in named.items() if value is not None}
    return integrator.chosen(kind, numbers)


def request_of(options: argparse.Namespace) -> dict[str, Any]:
    """Return the request that opens a session, for JSON."""
    words = {name: str(value) if isinstance(value, Path) else value for name, value in vars(options).items()}
    words.pop("run", None)
    return {"path": str(file_of(options.scene)), "name": options.scene, "program": None, "options": words}


def options_of(request: dict[str, Any]) -> argparse.Namespace:
    """Return the options of a request as the command line gave them."""
    words: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in request["options"].items()
    }
    for name in ("environment", "background"):
        if isinstance(words[name], str):
            words[name] = Path(words[name])
    return argparse.Namespace(**words)
