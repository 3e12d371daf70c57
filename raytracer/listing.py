"""The commands that list what there is: scenes and their parts, and what is installed.

raytracer scenes chair.glb
raytracer doctor

Stage: the command line.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import shpy as sh
from raytracer import viewing
from raytracer.meshes.folder import shown
from raytracer.scene.loading import Contents, load_contents
from raytracer.scene.scene import furnished
from raytracer.scenes import SCENES


def scenes(options: argparse.Namespace) -> int:
    """List the built-in scenes, or the meshes, cameras and variants of a scene or file; return 0."""
    if options.scene is not None:
        path = Path(options.scene)
        contents = load_contents(path) if viewing.is_file(path) and options.scene not in SCENES else None
        scene = viewing.find_scene(options.scene) if contents is None else furnished(contents, path.stem)
        width = max(len(shown(mesh.name)) for mesh in scene.meshes)
        for mesh in scene.meshes:
            print(f"{shown(mesh.name):{width}}  {len(mesh):,} triangles")
        if contents is not None:
            _list_choices(contents)
        return 0
    width = max(map(len, SCENES))
    for name, make in SCENES.items():
        print(f"{name:{width}}  {(make.__doc__ or '').splitlines()[0].removeprefix('Return ')}")
    return 0


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
