"""Path tracing against Mitsuba: the Cornell box, as many samples, scatterings and colours for both.

    print(z_test(quick=False).markdown())

The pictures are estimates with other random numbers, so each pixel is compared by a z-test. `equal_error.py` has the
times.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

from benchmarks import peers
from benchmarks.rays import mitsuba_mesh, mitsuba_sensor
from benchmarks.studies import backend
from benchmarks.tables import Table
from raytracer import Renderer, Scene

BOUNCES = 8
RUNS = 16
"""Pictures of other seeds, from which the study knows how far each pixel scatters."""


@cache
def mitsuba_cornell() -> Any:
    """Return the Cornell box as Mitsuba's."""
    return mitsuba_scene(Scene.builtin("cornell"))


def mitsuba_scene(scene: Scene) -> Any:
    """Return a scene of matt surfaces and of lamps as Mitsuba's."""
    import mitsuba as mi

    description: dict[str, Any] = {"type": "scene"}
    for number, part in enumerate(scene.meshes):
        color = [part.material.numbers["diffuse"] * c for c in part.material.tint]
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(
            {
                "type": "twosided",
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": color}},
            }
        )
        properties["face_normals"] = True
        if any(part.material.emission):
            radiance = {"type": "rgb", "value": list(part.material.emission)}
            properties["emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
        description[f"mesh_{number}"] = mitsuba_mesh(part, properties)
    return mi.load_dict(description)


def mitsuba_picture(size: int, samples: int, seed: int, scene: Any = None, ours: Scene | None = None) -> Any:
    """Mitsuba's linear picture (size, size, 3) of its `scene`, from the camera of `ours`; of the box by default."""
    import mitsuba as mi

    camera = (ours or Scene.builtin("cornell")).camera
    assert camera is not None
    integrator = mi.load_dict({"type": "path", "max_depth": BOUNCES + 1, "rr_depth": BOUNCES})
    scene = mitsuba_cornell() if scene is None else scene
    return np.asarray(
        mi.render(scene, sensor=mitsuba_sensor(camera, size), integrator=integrator, spp=samples, seed=seed)
    )[..., :3]


def z_test(quick: bool) -> Table:
    """Return the distance of our picture from Mitsuba's at each pixel, in standard errors of their difference."""
    note = "no Mitsuba"
    rows: list[list[str]] = []
    if not peers.available(["mitsuba"])[1]:
        peers.start("mitsuba")
        size, samples = (16, 16) if quick else (64, 256)
        columns = scores(size, samples)
        rows = [[f"{backend()} and Mitsuba", *columns]]
        note = f"Cornell box, {size} x {size} pixels, {RUNS} pictures of {samples} samples each."
    head = ["pictures", "mean difference / mean", "standard error of that", "mean z²", "|z| > 2 (normal: 4.6 %)"]
    return Table("path-z", note, head, rows)


def scores(size: int, samples: int) -> list[str]:
    """Return the numbers of `z_test`'s row."""
    scene = Scene.builtin("cornell")
    ours = [
        Renderer(scene, backend=backend(), integrator="path", seed=seed).render((size, size), samples=samples).pixels
        for seed in range(RUNS)
    ]
    theirs = [mitsuba_picture(size, samples, seed) for seed in range(RUNS)]
    (a, va), (b, vb) = (
        (np.mean(pictures, axis=0, dtype=np.float64), np.var(pictures, axis=0, ddof=1, dtype=np.float64) / RUNS)
        for pictures in (ours, theirs)
    )
    seen = va + vb > 0
    z = (a - b)[seen] / np.sqrt((va + vb)[seen])
    # Means over the picture of each run are independent of each other; its channels are not.
    differences = [p.mean(dtype=np.float64) - q.mean(dtype=np.float64) for p, q in zip(ours, theirs, strict=True)]
    mean = float(np.mean(theirs))
    error = float(np.std(differences, ddof=1)) / math.sqrt(RUNS)
    return [
        f"{float(np.mean(differences)) / mean:+.1e}",
        f"{error / mean:.1e}",
        f"{np.mean(z**2):.3f}",
        f"{np.mean(np.abs(z) > 2):.2%}",
    ]
