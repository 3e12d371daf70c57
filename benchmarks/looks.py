"""Compares materials with those of Mitsuba, pixel by pixel: `python -m benchmarks --only looks`.

    print(looks(Setup(peers=["mitsuba"])).markdown())

A ball of each material, of flat triangles, stands on a matt floor under a lamp that has an area. Pictures of several
seeds tell the variance of the mean of each pixel; z is the difference of both means over its standard error. Where the
models agree z has the mean 0 and, for eight seeds, the root mean square 1.08 (Student's t of 14 degrees of freedom).
The column `models` says how Mitsuba's differs, where it does.
"""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np

from benchmarks.rays import mitsuba_mesh, mitsuba_sensor
from benchmarks.studies import backend
from benchmarks.tables import Setup, Table
from raytracer import Camera, EnvironmentLight, Material, Mesh, MetallicRoughness, Renderer, Scene, Texture
from raytracer.meshes.shapes import floor, sphere

SIZE, SAMPLES, SEEDS, BOUNCES = 40, 64, 8, 8
"""Pixels along each side, samples of a pixel for each seed, seeds, and scatterings of a path."""
GOLD, COPPER, RED = (1.0, 0.77, 0.34), (0.95, 0.64, 0.54), (0.7, 0.05, 0.04)
GREY = MetallicRoughness((0.5, 0.5, 0.5), specular=0, roughness=1)
STENCIL = Texture(np.indices((8, 8)).sum(axis=0) % 2 * np.float32(1), srgb=False, filter="nearest")
CAMERA = Camera((0, 2.2, 5.5), (0, 0.75, 0), fov=28)
LAMP_POWER, AROUND = 16.0, (0.6, 0.8, 1.0)


class Look(NamedTuple):
    """A material, that of Mitsuba as a dictionary, and how its model differs."""

    ours: MetallicRoughness
    theirs: dict[str, Any]
    models: str = ""
    around: bool = False
    """True if light comes from everywhere in place of the lamp, which rays through glass meet by chance alone."""


def rgb(color: Any) -> dict[str, Any]:
    """Return a colour as Mitsuba's."""
    return {"type": "rgb", "value": list(color)}


def principled(**numbers: Any) -> dict[str, Any]:
    """Return a principled BSDF, of which triples are colours; both sides of it are seen."""
    surface = {name: rgb(x) if isinstance(x, tuple) else x for name, x in numbers.items()}
    return {"type": "twosided", "bsdf": {"type": "principled", **surface}}


def conductor(along: float, across: float) -> dict[str, Any]:
    """Return a white rough conductor of these widths."""
    surface = {"type": "roughconductor", "material": "none", "distribution": "ggx"}
    return {"type": "twosided", "bsdf": surface | {"alpha_u": along, "alpha_v": across}}


def plastic(roughness: float) -> Look:
    """Return red plastic."""
    note = "matt light is brighter at grazing angles, and gains (Burley)"
    return Look(MetallicRoughness(RED, roughness=roughness), principled(base_color=RED, roughness=roughness), note)


def catalogue() -> dict[str, Look]:
    """Return the materials by name."""
    product = "masking as a product of two factors"
    glass = MetallicRoughness((1, 1, 1), roughness=0.0, transmission=1, thickness=1)
    paint = {"roughness": 0.5, "clearcoat": 1.0}
    matt = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(RED)}}
    holes = {"type": "bitmap", "raw": True, "filter_type": "nearest"}
    smooth = {"type": "roughplastic", "distribution": "ggx", "alpha": 0.01}
    tinted = replace(glass, attenuation_color=(0.9, 0.5, 0.2), attenuation_distance=2.0)
    medium = {"type": "homogeneous", "albedo": 0.0, "sigma_t": rgb(tinted.absorption)}
    return {
        "chalk": Look(MetallicRoughness(RED, specular=0, roughness=1), matt),
        "gold .2": Look(MetallicRoughness(GOLD, 1, 0.2), principled(base_color=GOLD, metallic=1.0, roughness=0.2)),
        "copper .5": Look(
            MetallicRoughness(COPPER, 1, 0.5), principled(base_color=COPPER, metallic=1.0, roughness=0.5), product
        ),
        "plastic .1": Look(
            MetallicRoughness(RED, roughness=0.1),
            {"type": "twosided", "bsdf": smooth | {"diffuse_reflectance": rgb(RED)}},
            "Fresnel's equations",
        ),
        "plastic .3": plastic(0.3),
        "plastic .6": plastic(0.6),
        "car paint": Look(
            MetallicRoughness((0.02, 0.1, 0.3), 0.5, clearcoat_roughness=0.1, **paint),
            principled(base_color=(0.02, 0.1, 0.3), metallic=0.5, clearcoat_gloss=0.9, **paint),
            "another distribution and strength of the coat (Burley)",
        ),
        "velvet": Look(
            MetallicRoughness(RED, roughness=1, specular=0, sheen_color=(0.8, 0.8, 0.8), sheen_roughness=0.5),
            principled(base_color=RED, roughness=1.0, specular=0.01, sheen=0.8),
            "a sheen by Schlick's fifth power (Burley)",
        ),
        "brushed metal": Look(
            MetallicRoughness((1, 1, 1), 1, 0.3, anisotropy=0.6), conductor(0.09 + 0.36 * 0.91, 0.09), product
        ),
        "white metal .8": Look(MetallicRoughness((1, 1, 1), 1, 0.8), conductor(0.64, 0.64), product),
        "frosted glass": Look(
            replace(glass, roughness=0.3),
            {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.09, "int_ior": 1.5, "ext_ior": 1.0},
            product,
            around=True,
        ),
        "glass": Look(glass, {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}, around=True),
        "tinted glass body": Look(
            tinted, {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0, "interior": medium}, around=True
        ),
        "thin glass": Look(
            replace(glass, thickness=0.0),
            {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0},
            "mirror images inside of the pane",
            around=True,
        ),
        "emissive": Look(
            MetallicRoughness((0, 0, 0), specular=0, emission=(0.3, 0.2, 0.1)),
            {"type": "diffuse", "reflectance": rgb((0, 0, 0))},
        ),
        "cut-out": Look(
            MetallicRoughness(RED, specular=0, roughness=1, cutout=STENCIL),
            {"type": "mask", "bsdf": matt, "opacity": holes},
        ),
    }


def scene_of(look: Look) -> Scene:
    """Return the ball on its floor under a lamp, which shines to both sides, or in light from everywhere."""
    smooth = sphere(0.75, rings=24, segments=48)
    ball = Mesh(smooth.vertices, smooth.faces, uv=smooth.uv, material=look.ours, name="ball").moved((0, 0.75, 0))
    lamp = Material((0, 0, 0), diffuse=0.0, specular=0.0, emission=(LAMP_POWER,) * 3)
    above = replace(floor(1.2, lamp), name="lamp").moved((1.5, 3.5, 1.5), tilt=180)
    meshes, lights = [ball, floor(8, GREY)], [EnvironmentLight(AROUND)]
    return Scene(meshes, lights, CAMERA) if look.around else Scene([*meshes, above], (), CAMERA, (0, 0, 0), 0.0)


def ours(look: Look, size: int, samples: int, seeds: int) -> tuple[np.ndarray, np.ndarray]:
    """Return pictures of as many seeds, (seeds, size, size, 3), and the pixels that show the ball."""
    renderer = Renderer(scene_of(look), backend=backend(), integrator="path", bounces=BOUNCES)
    pictures = []
    for seed in range(seeds):
        renderer.integrator = replace(renderer.integrator, seed=seed)
        image = renderer.render((size, size), samples=samples)
        pictures.append(np.asarray(image.pixels, np.float64))
    return np.array(pictures), np.asarray(image.object_id == 0)


def theirs(look: Look, size: int, samples: int, seeds: int) -> np.ndarray:
    """Return pictures of Mitsuba, of as many seeds."""
    import mitsuba as mi

    scene = scene_of(look)
    description: dict[str, Any] = {"type": "scene"}
    grey = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(GREY.tint)}}
    look_of = {"ball": dict(look.theirs)}
    interior = look_of["ball"].pop("interior", None)
    if "opacity" in look.theirs:
        look_of["ball"]["opacity"] = {**look.theirs["opacity"], "bitmap": mi.Bitmap(np.flip(STENCIL.image, 0).copy())}
    meshes = list(scene.meshes)
    if look.around:
        description["around"] = {"type": "constant", "radiance": rgb(AROUND)}
    else:  # Mitsuba's lamps shine to the front alone
        faces = np.asarray(meshes[-1].faces)[:, ::-1]
        meshes.append(replace(meshes[-1], faces=faces, uv=None, name="lamp above").moved((0, 1e-3, 0)))
    for mesh in meshes:
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(look_of.get(mesh.name, grey))
        properties["face_normals"] = True
        if any(mesh.material.emission):
            properties["emitter"] = mi.load_dict({"type": "area", "radiance": rgb(mesh.material.emission)})
        if interior is not None and mesh.name == "ball":
            properties["interior"] = mi.load_dict(interior)
        description[mesh.name.replace(" ", "_")] = mitsuba_mesh(mesh, properties, textured=True)
    kind = "path" if interior is None else "volpath"
    integrator = mi.load_dict({"type": kind, "max_depth": BOUNCES + 1, "rr_depth": BOUNCES + 1})
    built, sensor = mi.load_dict(description), mitsuba_sensor(CAMERA, size)
    pictures = (mi.render(built, sensor=sensor, integrator=integrator, spp=samples, seed=k) for k in range(seeds))
    return np.array([np.asarray(picture, np.float64)[..., :3] for picture in pictures])


def looks(setup: Setup) -> Table:
    """Return z and means of the materials; without Mitsuba, of our pictures the means alone."""
    size, samples, seeds = (16, 4, 2) if setup.quick else (SIZE, SAMPLES, SEEDS)
    alone = "mitsuba" not in setup.peers or find_spec("mitsuba") is None
    if not alone:
        import mitsuba as mi

        mi.set_variant("scalar_rgb")  # which needs no LLVM
    rows = []
    chosen = catalogue()
    for name in list(chosen)[:: 8 if setup.quick else 1]:
        look = chosen[name]
        pictures, on_ball = ours(look, size, samples, seeds)
        mean = pictures[:, on_ball].mean()
        if alone:
            rows.append([name, f"{mean:.4f}", "", "", "", look.models])
            continue
        others = theirs(look, size, samples, seeds)
        (a, va), (b, vb) = ((p.mean(axis=0), p.var(axis=0, ddof=1) / seeds) for p in (pictures, others))
        error = np.sqrt(va + vb)
        z = ((a - b) / np.where(error > 0, error, 1))[on_ball & (error > 0).all(axis=-1)]
        ratio = mean / others[:, on_ball].mean() - 1
        rms = np.sqrt((z * z).mean())
        rows.append([name, f"{mean:.4f}", f"{100 * ratio:+.1f} %", f"{z.mean():+.2f}", f"{rms:.2f}", look.models])
    note = (
        f"{size} x {size} pixels, {seeds} seeds of {samples} samples. Where both models agree, z has the mean 0 and "
        f"the root mean square 1.08 for eight seeds.{' Mitsuba is missing or left out.' if alone else ''}"
    )
    return Table("looks", note, ["material", "mean", "to Mitsuba", "mean z", "rms z", "models of Mitsuba"], rows)
