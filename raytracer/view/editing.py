"""Materials and lights with other numbers than the scene gives them.

Stage: the command line, in the worker. A material is named by the first mesh that has it, a light by its place. The
page gets controls as `shpy.view` has them, and sends their values by name.

    edits = Edits(scene)
    edits.set({"material.knot.color": [0.1, 0.2, 0.3]})      # the messages of what is refused
    edits.applied(scene)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from raytracer.appearance.materials import Material
from raytracer.appearance.metallic_roughness import AnyMaterial, MetallicRoughness
from raytracer.appearance.textures import Texture
from raytracer.errors import SceneError
from raytracer.meshes.folder import shown
from raytracer.meshes.mesh import Mesh
from raytracer.scene.lights import DirectionalLight, EnvironmentLight, SpotLight
from raytracer.scene.scene import Scene

_LONGEST: Final = 120
"""Characters of a name that the page gets."""
_RANGES: Final = {
    "color": (0.0, 1.0),
    "diffuse": (0.0, 1.0),
    "specular": (0.0, 1.0),
    "shininess": (1.0, 200.0),
    "reflectivity": (0.0, 1.0),
    "transmission": (0.0, 1.0),
    "ior": (1.0, 2.5),
    "absorption": (0.0, 4.0),
    "emission": (0.0, 4.0),
    "base_color": (0.0, 1.0),
    "metallic": (0.0, 1.0),
    "roughness": (0.0, 1.0),
    "specular_color": (0.0, 1.0),
    "clearcoat": (0.0, 1.0),
    "clearcoat_roughness": (0.0, 1.0),
    "sheen_color": (0.0, 1.0),
    "sheen_roughness": (0.0, 1.0),
    "anisotropy": (0.0, 1.0),
    "anisotropy_rotation": (0.0, 180.0),
    "thickness": (0.0, 1.0),
    "attenuation_color": (0.0, 1.0),
    "alpha": (0.0, 1.0),
}
"""The span of the slider of each number of a material."""
_BOUNDED: Final = (
    *("reflectivity", "transmission", "base_color", "metallic", "roughness"),
    *("clearcoat", "clearcoat_roughness", "sheen_color", "sheen_roughness", "anisotropy"),
    *("attenuation_color", "alpha"),
)
_COLORS: Final = ("color", "base_color", "specular_color", "sheen_color", "attenuation_color")
_SAID: Final = {
    "shininess": "the exponent of the highlight",
    "transmission": "the share that lets light through, as glass does",
    "ior": "the refractive index",
    "absorption": "light that is lost inside, per unit of length",
}
_SAID_OF_LAYERS: Final = {
    "metallic": "0 for what is no metal, 1 for a metal",
    "roughness": "0 for a mirror, 1 for a surface without highlights",
    "ior": "the refractive index: how much is mirrored where it is no metal",
    "specular": "a factor of what is mirrored where it is no metal",
    "sheen_color": "the light of fibres at grazing angles, as of velvet",
    "anisotropy": "how much rougher the surface is along a direction than across it, as brushed metal",
    "anisotropy_rotation": "the angle, in degrees, from where u grows to that direction",
    "transmission": "the share of what is no metal that is clear",
    "thickness": "0 for a thin clear wall, above 0 for the surface of a body that refracts",
    "attenuation_color": "what is left of white light after the attenuation_distance inside a body",
    "alpha": "the share of the surface that is there",
}


class Edits:
    """The changes to a scene, which may have more or fewer meshes and lights at other times."""

    def __init__(self, scene: Scene) -> None:
        self.labels: list[str] = []
        """The name of each mesh's material."""
        self._materials: dict[str, AnyMaterial] = {}
        labels_by_material: dict[int, str] = {}
        for mesh in scene.meshes:
            if id(mesh.material) not in labels_by_material:
                labels_by_material[id(mesh.material)] = self._name(mesh)
                self._materials[labels_by_material[id(mesh.material)]] = mesh.material
            self.labels.append(labels_by_material[id(mesh.material)])
        self._objects = [mesh.name for mesh in scene.meshes]
        self._lights = scene.lights
        self._changed: dict[str, list[Any]] = {}
        self._applied: tuple[Scene, Scene] | None = None

    def _name(self, mesh: Any) -> str:
        label, number = shown(mesh.name, _LONGEST), 1
        while label in self._materials:
            number += 1
            label = f"{shown(mesh.name, _LONGEST)} {number}"
        return label

    def set(self, values: Mapping[str, Any]) -> list[str]:
        """Change numbers by name, by None to those of the scene; return the messages of what is refused.

        A page may send names of an earlier version of the file, which are left out.
        """
        refused = []
        for name, value in values.items():
            make = self._maker(name)
            if make is None:
                continue
            before, self._applied = dict(self._changed), None
            self._changed.pop(name, None)
            if value is not None:
                self._changed[name] = value
            try:
                make()
            except (SceneError, TypeError, ValueError) as error:
                self._changed = before
                refused.append(str(error))
        return refused

    def _maker(self, name: str) -> Callable[[], Any] | None:
        """Return the function that makes the material or light of a name, and raises for values that it refuses."""
        kind, _, rest = name.partition(".")
        label, _, _ = rest.rpartition(".")
        if kind == "material" and label in self._materials:
            return lambda: self._material(label)
        if kind == "light" and label.isdecimal() and int(label) < len(self._lights):
            return lambda: self._light(int(label), self._lights[int(label)])
        return None

    def applied(self, scene: Scene) -> Scene:
        """Return a scene with the changes; the same one again for the same scene."""
        if not self._changed:
            return scene
        if self._applied is None or self._applied[0] is not scene:
            meshes = [self._remade(mesh, self.label(scene, number)) for number, mesh in enumerate(scene.meshes)]
            lights = [self._light(number, light) for number, light in enumerate(scene.lights)]
            self._applied = scene, dataclasses.replace(scene, meshes=meshes, lights=lights)
        return self._applied[1]

    def changed(self, scene: Scene) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """Return the changed fields of materials, with their meshes' numbers, and those of lights with theirs."""
        meshes: dict[str, list[int]] = {}
        for number in range(len(scene.meshes)):
            meshes.setdefault(self.label(scene, number), []).append(number)
        values = {label: self._values(f"material.{label}.", scene.meshes[n[0]].material) for label, n in meshes.items()}
        lamps = ((k, light) for k, light in enumerate(scene.lights) if not isinstance(light, EnvironmentLight))
        lights = ((number, self._values(f"light.{number}.", light)) for number, light in lamps)
        placed = tuple((tuple(meshes[label]), changes) for label, changes in values.items() if changes)
        return placed, tuple((number, changes) for number, changes in lights if changes)

    def label(self, scene: Scene, number: int) -> str:
        """Return the name of a mesh's material; of a mesh that came later, that of a mesh with the same one."""
        if number < len(self.labels):
            return self.labels[number]
        mesh = scene.meshes[number]
        pairs = zip(scene.meshes, self.labels, strict=False)
        return next((label for other, label in pairs if other.material == mesh.material), shown(mesh.name, _LONGEST))

    def _remade(self, mesh: Mesh, label: str) -> Mesh:
        values = self._values(f"material.{label}.", mesh.material)
        return mesh.with_material(dataclasses.replace(mesh.material, **values)) if values else mesh

    def _material(self, label: str) -> AnyMaterial:
        material = self._materials[label]
        return dataclasses.replace(material, **self._values(f"material.{label}.", material))

    def _light(self, number: int, light: Any) -> Any:
        if isinstance(light, EnvironmentLight):
            return light
        return dataclasses.replace(light, **self._values(f"light.{number}.", light))

    def _values(self, prefix: str, thing: Any) -> dict[str, Any]:
        """Return the fields of a thing that are changed, in their own types."""
        values: dict[str, Any] = {}
        for field in dataclasses.fields(thing):
            value = self._changed.get(prefix + field.name)
            if value is not None:
                numbers = tuple(map(float, value))
                values[field.name] = numbers if isinstance(getattr(thing, field.name), tuple) else numbers[0]
        return values

    def describe(self) -> dict[str, Any]:
        """Return the materials and lights, each with its controls, as the page shows them."""
        materials = []
        for label, material in self._materials.items():
            objects = [name for name, other in zip(self._objects, self.labels, strict=True) if other == label]
            fields = {field.name for field in dataclasses.fields(material)}
            spans = {name: span for name, span in _RANGES.items() if name in fields}
            own = [_control(f"material.{label}.", name, material, span) for name, span in spans.items()]
            pictured = [name for name, value in material.textures.items() if isinstance(value, Texture)]
            programs = [name for name in ("surface", "shade") if getattr(material, name) is not None]
            materials.append(
                {
                    "label": label,
                    "objects": [shown(name, _LONGEST) for name in objects[:8]],
                    "count": len(objects),
                    "controls": [one for one in own if one is not None],
                    "pictures": pictured,
                    "programs": programs,
                }
            )
        return {"materials": materials, "lights": [self._lamp(k, light) for k, light in enumerate(self._lights)]}

    def _lamp(self, number: int, light: Any) -> dict[str, Any]:
        if isinstance(light, EnvironmentLight):
            return {"label": "environment", "controls": []}
        if isinstance(light, DirectionalLight):
            most = max(map(abs, light.direction))
            spans = {"color": (0.0, 2.0), "direction": (-most, most)}
        else:
            most = 2 * max(map(abs, light.position)) or 1.0
            spans = {"color": (0.0, max(2.0, 2 * max(light.color))), "position": (-most, most)}
        what = "spot" if isinstance(light, SpotLight) else "direction" if "direction" in spans else "point"
        controls = [_control(f"light.{number}.", name, light, span) for name, span in spans.items()]
        return {"label": f"{number + 1}: {what}", "controls": [one for one in controls if one is not None]}


def _descriptions(thing: Any) -> Mapping[str, str]:
    """Return the descriptions of a material's numbers; those of lights need none."""
    if isinstance(thing, Material):
        return _SAID
    return _SAID_OF_LAYERS if isinstance(thing, MetallicRoughness) else {}


def _control(prefix: str, name: str, thing: Any, span: tuple[float, float]) -> dict[str, Any] | None:
    """Return the control of a field; None where a picture gives its values."""
    value = getattr(thing, name)
    if isinstance(value, Texture):
        return None
    numbers = [float(x) for x in np.atleast_1d(value)]
    low, high = min(span[0], *numbers), max(span[1], *numbers)
    return {
        "name": prefix + name,
        "title": name,
        "description": _descriptions(thing).get(name, ""),
        "value": numbers,
        "first": numbers,
        "form": "color" if name in _COLORS and max(numbers) <= 1 else "number",
        "linear": True,
        "components": "xyz" if name in ("position", "direction") else "rgb",
        "range": [low, high],
        "step": 1.0 if high >= 100 else 10.0 ** np.floor(np.log10((high - low) / 100)),
        "whole": False,
        "bounded": name in _BOUNDED,
    }
