"""The origin of a path traced picture: digests of all that decides its pixels, by which another picture is refused.

Stage: render. An origin is one line of text with a word for each part, so that a refusal can name the parts that
differ. Nothing is in it that changes no bit of a picture: names, accelerators, the number of samples, `Scene.ambient`,
and in strict and portable mode the backend.

    parts_of("4 seed=0 camera=1f3a...")      # {"seed": "0", "camera": "1f3a..."}
"""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from raytracer.appearance.metallic_roughness import AnyMaterial, MetallicRoughness
from raytracer.appearance.programs import UserProgram
from raytracer.appearance.textures import Texture
from raytracer.appearance.unlit import Unlit
from raytracer.errors import SceneError
from raytracer.integrators.integrator import REPRODUCIBLE, Path
from raytracer.kernels.appearance import Appearance
from raytracer.kernels.path import PathTracer
from raytracer.meshes.mesh import unplaced
from raytracer.scene.camera import Camera
from raytracer.scene.layout import Layout
from raytracer.scene.light_tables import cone_rows, light_rows
from raytracer.scene.scene import Scene

GENERATION: Final = "6"
"""The number of the path tracer: raise it with a change that gives any scene other pixels."""
_NO_BITS: Final = ("samples", "accel", "grid", "secondary")
"""The options of an integrator that an origin leaves out; `secondary` is included with the layout."""
_DIGEST: Final = re.compile("[0-9a-f]{16}")
# Parts of a recorded program's text that change no pixel: places in the user's file, first values of Params, and names.
_LOCATIONS: Final = re.compile(r"^file .*\n| @\d+:\d+", re.MULTILINE)
_VALUES: Final = re.compile(r"^(param .*?) = .*$", re.MULTILINE)
_NAMES: Final = re.compile(r"([%$])(?:\w+|\"(?:[^\"\\]|\\.)*\")\.(\d+)")


def origin_of(
    scene: Scene,
    layout: Layout | None,
    tracer: PathTracer | None,
    camera: Camera,
    integrator: Path,
    backend: str,
    transparent: bool = False,
) -> str:
    """Return the origin of the pictures of a scene; without a layout and a tracer, of one without triangles."""
    options = {field.name: str(getattr(integrator, field.name)) for field in dataclasses.fields(integrator)}
    parts = {name: value for name, value in options.items() if name not in _NO_BITS}
    if not integrator.fuse:
        del parts["fuse"]  # origins of earlier versions have none
    if integrator.math not in REPRODUCIBLE:
        parts["backend"] = backend
    if transparent:
        parts["transparent"] = "True"
    parts["background"] = _digest(*_background(scene, tracer))
    if layout is None or tracer is None:
        parts["triangles"] = _digest(None)
    else:
        parts |= _of_scene(scene, layout, tracer) | {"camera": _digest(repr(camera))}
    return " ".join([GENERATION, *(f"{name}={value}" for name, value in parts.items())])


def _of_scene(scene: Scene, layout: Layout, tracer: PathTracer) -> dict[str, str]:
    """Return the parts that meshes, materials and lights are."""
    if layout.forest is not None:
        layout = layout.exact(scene)
    appearance, environment = tracer.surfaces.appearance, tracer.emitters.around
    digests: dict[Texture, str] = {}
    materials = [_described(material, digests, appearance) for material in layout.materials]
    lights = light_rows(scene.placed_lights, np.zeros(3), 1.0, np.dtype(np.float64))
    cones = cone_rows(scene.placed_lights, 1.0)
    around: list[Any] = []
    if environment is not None:
        picture, examined = environment.sky.picture, environment.sky.examined
        around = [repr(environment.light.color), picture and _picture(picture)]
        around += [] if examined is None else _recorded(examined)
        light = environment.light
        around += [repr((light.rotation, light.strength))] if (light.rotation, light.strength) != (0, 1) else []
    instanced = layout.instanced
    meshes, places = scene.meshes, {}
    if instanced is not None:
        meshes = [unplaced(mesh) for mesh in meshes]
        places = {"instances": _digest(instanced.meshes, instanced.levels.rows)}
    return places | {
        "triangles": _digest(layout.origin, repr(layout.scale), layout.triangles, layout.object_of),
        "normals": _digest(layout.normals),
        "vertex-colors": _digest(*(mesh.colors for mesh in meshes if len(mesh))),
        "uv-coordinates": _digest(layout.uvs),
        "materials": _digest(repr(materials), layout.material_of),
        "surface-programs": _digest(*(part for surface in appearance.examined for part in _recorded(surface))),
        "lights": _digest(lights) if cones is None else _digest(lights, cones),
        "environment": _digest(*around),
        "secondary-accelerator": _digest(layout.secondary and repr(layout.secondary.options)),
    }


def _background(scene: Scene, tracer: PathTracer | None) -> Iterable[Any]:
    """Yield what decides the light of a scene's background."""
    examined = None if tracer is None else tracer.background.examined
    if isinstance(scene.background, Texture):
        yield _picture(scene.background)
    elif examined is not None:
        yield from _recorded(examined)
    else:
        yield repr(scene.background)


def _described(material: AnyMaterial, digests: dict[Texture, str], appearance: Appearance) -> list[Any]:
    """Return the fields of a material: of a texture its digest, of a program its place among the scene's."""
    entries: list[Any] = ["metallic-roughness"] if isinstance(material, MetallicRoughness) else []
    entries += ["unlit"] if isinstance(material, Unlit) else []
    for field in dataclasses.fields(material):
        value = getattr(material, field.name)
        if isinstance(value, Texture):
            if value not in digests:
                digests[value] = _picture(value)
            entries.append(digests[value])
        elif callable(value):
            entries.append(appearance.surfaces.index(value))
        else:
            entries.append(None if value is None else np.asarray(value, np.float64).tolist())
    return entries


def _picture(texture: Texture) -> str:
    moved = () if texture.transform is None else (np.array(texture.transform),)
    return _digest(texture.image, texture.filter, texture.wrap, *moved)


def _recorded(examined: UserProgram) -> Iterable[Any]:
    """Yield what decides the results of a recorded program: its text, and the data that it reads at present."""
    recorded = examined.program.recorded
    text = str(examined.program.ir)
    for pattern, kept in ((_LOCATIONS, ""), (_VALUES, r"\1"), (_NAMES, r"\1\2")):
        text = pattern.sub(kept, text)
    yield text
    for param in recorded.params.values():
        yield np.asarray(param)
    for table in recorded.tables.values():
        yield table.data(np.float32).array


def _digest(*parts: Any) -> str:
    """Return a digest of texts and arrays, which are not copied; None is a part of its own."""
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, str):
            part = np.frombuffer(part.encode(), np.uint8)
        if part is None:
            digest.update(b"-")
            continue
        digest.update(f"{part.dtype.str}{part.shape}".encode())
        digest.update(np.ascontiguousarray(part).data)
    return digest.hexdigest()[:16]


def check_origin(name: str, origin: str, expected: str) -> None:
    """Raise SceneError, which calls the picture `name`, if its `origin` is not the `expected` one."""
    if origin == expected:
        return
    if not origin:
        raise SceneError(f"{name} was not path traced by raytracer, so it has no samples to add to: begin a new one")
    if origin.split(" ")[0] != GENERATION:
        raise SceneError(f"{name} was path traced by another version of raytracer: begin a new one with this version")
    before, here = parts_of(origin), parts_of(expected)
    changed = [part for part in {**here, **before} if before.get(part) != here.get(part)]
    listed = ", ".join(_difference(part, before.get(part), here.get(part)) for part in changed)
    raise SceneError(
        f"{name} was not path traced from this scene, camera, seed and options; they differ in: {listed}. "
        "Begin a new one"
    )


def parts_of(origin: str) -> dict[str, str]:
    """Return the parts of an origin by name."""
    words = (word.partition("=") for word in origin.split(" ")[1:])
    return {name: value for name, _, value in words}


def _difference(part: str, before: str | None, here: str | None) -> str:
    """Return the name of a part as users read it, with the values of an option."""
    name = part.replace("-", " ")
    digested = any(value is not None and _DIGEST.fullmatch(value) for value in (before, here))
    return name if digested else f"{name} ({before or 'not noted'} in the picture, {here or 'not noted'} here)"
