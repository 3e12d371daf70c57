"""The commands that list what there is: scenes and their parts, and what is installed.

raytracer scenes chair.glb
raytracer doctor

Stage: the command line.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import shpy as sh
from raytracer import viewing
from raytracer.animation import ANIMATIONS, Make, made_by
from raytracer.meshes.folder import shown
from raytracer.scene.loading import Contents, load_contents
from raytracer.scene.scene import Scene, furnished
from raytracer.scenes import SCENES


def scenes(options: argparse.Namespace) -> int:
    """List the built-in scenes, or the meshes, cameras and variants of a scene or file; return 0."""
    if options.scene is not None:
        path = Path(options.scene)
        make, contents = _moving(options.scene, path), None
        if make is None and viewing.is_file(path) and options.scene not in SCENES:
            contents = load_contents(path)
            scene = furnished(contents, path.stem)
        else:
            scene = viewing.find_scene(options.scene) if make is None else make(0.0)
        width = max((len(shown(mesh.name)) for mesh in scene.meshes), default=0)
        for mesh in scene.meshes:
            print(f"{shown(mesh.name):{width}}  {len(mesh):,} triangles")
        if make is not None:
            print("a function of the time, listed at 0 seconds")
        if contents is not None:
            _list_choices(contents)
        return 0
    makers: dict[str, Callable[..., Scene]] = {**SCENES, **ANIMATIONS}
    width = max(map(len, makers))
    for name, make in makers.items():
        when = ", a function of the time" if name in ANIMATIONS else ""
        text = (make.__doc__ or "").splitlines()[0].removeprefix("Return ").removesuffix(".")
        print(f"{name:{width}}  {text[:1].upper()}{text[1:]}{when}.")
    return 0


def _moving(name: str, path: Path) -> Make | None:
    """Return the function of the time that a name or a Python file stands for; None for a scene that stands still."""
    return ANIMATIONS.get(name) or (made_by(path) if path.suffix.lower() == ".py" else None)


def _list_choices(contents: Contents) -> None:
    """Print the cameras and the variants of a file, as --camera and --variant name them."""
    for number, (name, camera) in enumerate(contents.cameras):
        perspective = camera.projection == "perspective"
        frame = f"{camera.fov:.3g} degrees" if perspective else f"{camera.span:.3g} across"
        print(f"camera {number}: {shown(name)}, {camera.projection}, {frame}")
    for name in contents.variants:
        print(f"variant: {shown(name)}")


_PACKAGES = {
    "trimesh": "meshes and scenes of trimesh",
    "mapbox-earcut": "cuts faces that are not convex",
    "pillow": "reads textures, writes PNG",
    "OpenEXR": "writes EXR",
    "rich": "shows progress",
}


def doctor(_: argparse.Namespace) -> int:
    """Say what is installed, what is missing, and how to install it; return 0."""
    for backend in sh.backends():
        for device in backend.devices:
            print("\n  ".join([f"{backend.name}: {device.name}, {device.version}", *device.notes]))
        if not backend.available:
            print(f"{backend.name}: missing, {backend.reason}; to mend it: {backend.cure}")
    missing = [name for name in _PACKAGES if sh.packages.installed(name) is None]
    for name, purpose in _PACKAGES.items():
        print(f"{name} ({purpose}): {'missing' if name in missing else 'installed'}")
    if missing:
        print(f"to install them: {sh.packages.install(*missing)}")
    return 0
