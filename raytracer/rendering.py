"""The picture of a scene: `render`.

Stage: render. Above the integrators, and above the trade-off that chooses among them.

    image = render(Scene.builtin("boxes"), integrator=Path(samples=64), backend="opencl")
    image.save("boxes.png")
"""

from __future__ import annotations

import dataclasses
from typing import Any, Unpack

from raytracer.arrays import is_whole
from raytracer.backends import chosen_backend
from raytracer.denoising import finisher_of
from raytracer.errors import SceneError
from raytracer.image import Image
from raytracer.integrators.integrator import Choice, Integrator, Options, Whitted, chosen
from raytracer.integrators.layers import Progress, checked_size
from raytracer.integrators.primary import GBuffer, size_of
from raytracer.integrators.progressive import check_resume
from raytracer.integrators.renderer import Renderer, Resume
from raytracer.scene.scene import Scene


def render(
    scene: Scene,
    size: tuple[int, int] | None = None,
    *,
    integrator: Choice = "whitted",
    backend: str | None = None,
    resume: Resume = None,
    max_error: float | None = None,
    progress: Progress | None = None,
    cluster: Any = None,
    tile_rows: int | None = None,
    partitions: int | None = None,
    primary: GBuffer | None = None,
    transparent: bool = False,
    denoise: bool = False,
    **options: Unpack[Options],
) -> Image:
    """Render a scene from its camera, `size` = (width, height) pixels; an empty scene shows its background.

    `integrator` says how light is followed: `Whitted()`, the default, direct light, by mirrors and through glass, too;
    `Staged()`, the same pictures by kernels over streams of rays; `Path()`, an unbiased estimate of all light. Their
    options may also be keywords, `Options`, of "whitted", with `tracer="staged"` of `Staged`, or "path". `primary` is a
    `GBuffer`, the surfaces that a rasteriser sees, which `Whitted` takes for the hits of its eye rays. `size` None is
    the buffer's, and (512, 512) without one.
    A `transparent` picture has `image.alpha`, the share of a pixel's eye rays that meet a surface; its pixels hold the
    light of these alone, which may mirror the background. Of a `Path` eye rays count for what is behind clear surfaces.
    With a `Path`, `resume` continues a picture of fewer samples, an `Image` or its .exr or .npy file, and `denoise`
    estimates the pixels without noise, by Open Image Denoise. With `max_error`, a root mean square error in 255ths of
    sRGB, the fastest variant that `tradeoff` finds is rendered: `image.stats.picked`, of all options and fewer bounces.

    `cluster` renders the same bits by the workers of a Dask cluster: a dask.distributed.Client, the address of a
    scheduler such as "tcp://host:8786", or "local:4" for four processes of this machine. A task renders `tile_rows`
    rows into a temporary file. With `partitions`, for `Whitted` without glass, the scene is cut into so many parts,
    each held by one worker, between which rays travel; `image.stats.moved` counts them.

    Raises SceneError for arguments that make no picture, do not fit into memory or exclude each other, and for an error
    that no variant keeps; sh.BackendUnavailable for a missing backend; ClusterError for a cluster that cannot be used.
    """
    chosen_integrator = chosen(integrator, options)
    size = size_of(size, primary, scene, chosen_integrator, chooses=not (cluster is max_error is None))
    _check_together(cluster, max_error, tile_rows, partitions, transparent)
    finish = finisher_of(denoise, chosen_integrator, scene, backend)
    if cluster is not None:
        work = scene, chosen_integrator, chosen_backend(backend, shares_cores=True)
        return finish(_by_workers(cluster, work, size, max_error, tile_rows, partitions, resume, progress))
    checked_size(size)  # before a scene is laid out and compiled
    if max_error is not None and scene.triangles:
        return _within(max_error, scene, size, chosen_integrator, backend, progress, resume)
    renderer = _renderer(scene, chosen_integrator, backend, transparent, primary)
    return finish(renderer.render(size, progress=progress, resume=resume, primary=primary, transparent=transparent))


def _renderer(
    scene: Scene, integrator: Integrator, backend: str | None, transparent: bool, primary: GBuffer | None
) -> Renderer:
    """Return a Renderer that compiles the kernel of its first picture alone."""
    kind = primary is not None
    return Renderer(scene, integrator=integrator, backend=backend, transparent=transparent, primary=kind)


def _check_together(
    cluster: Any, max_error: float | None, tile_rows: int | None, partitions: int | None, transparent: bool
) -> None:
    """Raise SceneError for arguments that exclude each other."""
    if transparent and not (cluster is max_error is None):
        raise SceneError("a transparent picture is rendered by this process as it is: leave cluster and max_error out")
    if cluster is None and not (tile_rows is partitions is None):
        raise SceneError("tile_rows and partitions are for the workers of a cluster: name one, or leave them out")


def _by_workers(
    cluster: Any,
    work: tuple[Scene, Integrator, str],
    size: tuple[int, int],
    max_error: float | None,
    tile_rows: int | None,
    partitions: int | None,
    resume: Resume,
    progress: Progress | None,
) -> Image:
    """Render by the workers of a cluster, which hold the scene or, with `partitions`, parts of it.

    `work` is the scene, the integrator and the name of the backend.
    """
    # Here, since most pictures need no cluster: to import these takes 40 ms of CPU, and Dask more.
    from raytracer.cluster.connection import connected
    from raytracer.cluster.job import Job
    from raytracer.cluster.partitioned import check_partitions, render_partitioned
    from raytracer.cluster.replicated import render_tiles

    if max_error is not None:
        raise SceneError("max_error chooses by times measured on this machine: leave it or the cluster out")
    if not (tile_rows is None or is_whole(tile_rows, 1)):
        raise SceneError(f"tile_rows is a number of rows, 1 or more, not {tile_rows!r}")
    job = Job(*work)
    if partitions is not None:
        check_partitions(job, partitions)
        if resume is not None or tile_rows is not None:
            raise SceneError("resume and tile_rows are for scenes that every worker holds: leave out partitions")
    with connected(cluster) as client:
        if partitions is not None:
            return render_partitioned(client, job, size, partitions, progress=progress)
        return render_tiles(client, job, size, tile_rows=tile_rows, resume=resume, progress=progress)


def _within(
    max_error: float,
    scene: Scene,
    size: tuple[int, int],
    chosen_integrator: Integrator,
    backend: str | None,
    progress: Progress | None,
    resume: Resume,
) -> Image:
    """Render by the fastest variant that keeps an error."""
    from raytracer.studies.tradeoff import fastest  # here, since most pictures ask for no error

    check_resume(chosen_integrator, resume)
    if not (isinstance(chosen_integrator, Whitted) and chosen_integrator.is_plain):
        raise SceneError("max_error chooses among the variants of the unified tracer: leave the choice to it")
    variant, renderer = fastest(scene, max_error, backend, chosen_integrator.bounces)
    image = renderer.render(size, samples=chosen_integrator.samples, progress=progress)
    return dataclasses.replace(image, stats=dataclasses.replace(image.stats, picked=str(variant)))
