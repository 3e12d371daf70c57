"""The tracer of an integrator, for what a scene has.

Stage: render. Takes a scene and its layout, gives the tables and the loop that a kernel is recorded from.
"""

from __future__ import annotations

from typing import Any

from raytracer.errors import SceneError
from raytracer.integrators.integrator import Integrator, Path, Staged, Whitted
from raytracer.kernels.glass import GlassTracer
from raytracer.kernels.path import PathTracer
from raytracer.kernels.tracer import Tracer
from raytracer.scene.layout import Layout
from raytracer.scene.scene import Scene


def tracer_of(integrator: Integrator, scene: Scene, layout: Layout, backend: str) -> Tracer | PathTracer:
    """Return the tracer of an integrator. Raises SceneError for a scene that the integrator cannot show."""
    bounces = integrator.bounces
    if isinstance(integrator, Path):
        return PathTracer(layout, scene, bounces, backend, integrator.clamp)
    arguments = layout, scene.background, scene.ambient, bounces, backend
    options: dict[str, Any] = {"environment": scene.environment}
    if isinstance(integrator, Whitted):
        options["min_contribution"] = integrator.min_contribution
    tracer = Tracer(*arguments, **options)
    if not tracer.surfaces.clear:
        return tracer
    if isinstance(integrator, Staged):
        raise SceneError(
            "the staged tracer follows mirrored rays alone, and this scene has glass: "
            "choose the unified tracer, Whitted()"
        )
    return GlassTracer(*arguments, **options)
