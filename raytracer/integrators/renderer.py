"""From a scene to a picture: lays the scene out, records and compiles its tracer, and runs that over bands of rows.

Stage: render. A `Renderer` keeps the compiled kernels of one scene; `raytracer.render` makes one and uses it once.

    renderer = Renderer(Scene.builtin("boxes"), integrator=Whitted(bounces=2), backend="numpy")
    renderer.render(size=(512, 512)).save("boxes.png")
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import time
from collections.abc import Callable, Iterator, Sequence
from math import isqrt
from os import PathLike
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

import shpy as sh
from raytracer.accel.choice import INSTANCES, MOVABLE
from raytracer.backends import chosen_meanwhile
from raytracer.errors import SceneError
from raytracer.image import ALPHA, LAYERS, Image, Stats
from raytracer.integrators.integrator import Choice, Options, Path, Staged, check_scene, chosen
from raytracer.integrators.layers import (
    Progress,
    check_rows,
    checked_size,
    clear,
    rows_at_once,
    take_samples,
    uncover,
    unscale,
    unset,
    whole_size,
)
from raytracer.integrators.motion import Motion, all_or_nothing, laid_out, moved_instances, moved_rows, runs_kernels
from raytracer.integrators.origin import origin_of
from raytracer.integrators.primary import GBuffer, first_tables, seen_inputs, size_of
from raytracer.integrators.progressive import check_resume, passes, resumed
from raytracer.integrators.staged import Log, StagedTracer
from raytracer.integrators.tracers import tracer_of
from raytracer.integrators.turns import Turn, in_turn
from raytracer.kernels.eye_rays import eye_rays_of
from raytracer.kernels.path import PathTracer
from raytracer.kernels.picture import eye_rays, seen_rays
from raytracer.kernels.pixel import Pixel
from raytracer.kernels.walk import lanes_of
from raytracer.scene.camera import Camera, checked_camera
from raytracer.scene.layout import Layout
from raytracer.scene.scene import Scene

Resume = Image | str | PathLike[str] | None

_PASSING = 36
"""Bytes of a pixel that path tracing needs besides the layers: those of the pass before."""


class Renderer:
    """The compiled tracer of one scene, for pictures of any size from any camera.

    `integrator` is a `Whitted`, `Staged` or `Path`, or a name as in `render`, which also describes the `options`;
    `backend` is one of `sh.backends()`, None for the default one. `move` and `deform` change objects between pictures;
    `scene` is the scene of the last picture, and `builds` counts how often accelerators were built for all of it.
    Threads that share one take turns. The kernel that is compiled at once is that of `transparent` pictures, of those
    of a GBuffer (`primary`) or of others; one of another kind is compiled with its first picture.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        integrator: Choice = "whitted",
        backend: str | None = None,
        transparent: bool = False,
        primary: bool = False,
        **options: Unpack[Options],
    ) -> None:
        self.integrator = chosen(integrator, options)
        check_scene(scene)
        self.scene = scene
        chosen_later = chosen_meanwhile(backend)
        self.backend = chosen_later() if runs_kernels(self.integrator, scene) else "numpy"
        self.build_seconds = self.record_seconds = self.compile_seconds = 0.0
        self.features: dict[str, bool | int] = {}
        self.staged: StagedTracer | None = None
        self.program: Any = None
        self.kernel: Any = None
        self.params: dict[str, Any] = {}
        self.layout: Layout | None = None
        self.builds = 0
        self.turn = Turn()
        self._motion = Motion(scene.meshes)
        self._moving: tuple[int, ...] = ()
        self._transparent, self._seen = transparent, primary
        self._prepare(chosen_later)

    def __deepcopy__(self, memo: Any) -> Renderer:
        """Return a renderer of its own: a program is its own copy, so kernels with other params are recorded."""
        renderer = copy.copy(self)
        renderer.scene, renderer._motion, renderer.turn = copy.deepcopy((self.scene, self._motion, self.turn), memo)
        renderer.layout = None
        renderer._prepare()
        return renderer

    def _prepare(self, backend: Callable[[], str] | None = None) -> None:
        """Build the accelerators, then ask for the `backend`, and record and compile the kernel for the camera."""
        scene, chosen, before, self.layout = self.scene, self.integrator, self.layout, None
        if not scene.triangles:
            return
        self.builds += 1
        self.staged = self.program = self.kernel = None
        started = time.perf_counter()
        self.layout = laid_out(chosen, scene, self._motion, self._moving, self.backend, before and before.secondary)
        self.build_seconds = time.perf_counter() - started
        self.backend = self.backend if backend is None else backend()
        secondary = self.layout.secondary
        self._options: dict[str, Any] = self.integrator.arithmetic
        self._options |= lanes_of(self.backend, secondary)
        started = time.perf_counter()
        self._tracer = tracer_of(self.integrator, scene, self.layout, self.backend)
        self.features = self._tracer.features | self.layout.features
        self.record_seconds = time.perf_counter() - started
        self._kinds: dict[tuple[Any, ...], dict[str, Any]] = {}
        assert scene.camera is not None  # a Scene sets its own camera by default
        self._choose(scene.camera, self._seen and not isinstance(chosen, Path | Staged), self._transparent)

    @in_turn
    def move(self, name: str | int, transform: ArrayLike) -> None:
        """Place the meshes of a name, or the one of a number, where `transform` takes them, from the next picture on.

        `transform` (4, 4) multiplies columns (x, y, z, 1), as an `Instance`'s does, and is relative to where the scene
        has the mesh, or to the vertices that `deform` gave it: not to the last move. The picture is the same as for a
        new scene with these places. A number is the place among the scene's meshes, which is the object id of pictures.

        The first picture after an object's first move costs as much as a new Renderer: the object gets an accelerator
        of its own. From then on only the parts of tables that the object has are computed and sent, and the accelerator
        of what does not move stays. It is all built anew where the scene grows beyond the next power of two, or moves
        to far away from 0, which `builds` counts. With accel="grid" the objects that have moved leave the grid, which
        stays, and are found by a hierarchy beside it. Where instances share their triangles, a move of one costs a new
        hierarchy over the instances, and a move or a deformation of another mesh a new Renderer. Raises SceneError for
        unknown names, for other matrices, and for accel="brute".
        """
        self._check_movable()
        self._motion.move(name, transform)

    @in_turn
    def deform(self, name: str | int, vertices: ArrayLike, normals: ArrayLike | None = None) -> None:
        """Replace the `vertices` (V, 3) of a mesh, before it is transformed by `move`, from the next picture on.

        `normals` (V, 3) or (F, 3, 3) replace those of the mesh. None recomputes the normals of a mesh that has them, as
        `Mesh.smoothed` does, which takes time. Costs and errors are those of `move`. The boxes of the object's
        accelerator are refitted; it is rebuilt when refitting has made it `accel.forest.DEGRADED` times as costly as it
        was. Raises SceneError for vertices of another shape, numbers that are not finite, and a name that several
        meshes have.
        """
        self._check_movable()
        self._motion.deform(name, vertices, normals)

    @in_turn
    def show(self, scene: Scene) -> None:
        """Switch to another scene, from the next picture on.

        A scene fits if it has as many meshes, with the same names and as many vertices and faces each, and as many
        lights of the same kinds. Of such a scene only the differences are sent: positions, numbers of materials,
        lights, background and ambient. Nothing is compiled for new numbers. Any other scene rebuilds everything, which
        `builds` counts, and so does a number that needs other code: see docs/raytracer-pictures.md. Raises SceneError
        as a new Renderer does, and then keeps its scene.
        """
        check_scene(scene)
        if self._takes(scene):
            return
        with all_or_nothing(self):
            self.scene, self._motion, self._moving = scene, Motion(scene.meshes), ()
            self._prepare()

    def _takes(self, scene: Scene) -> bool:
        """Switch to a scene if the kernels and accelerators fit it; otherwise change nothing and return False."""
        if self.layout is None:
            return False
        alike = scene.environment is self.scene.environment
        if not alike or not self._motion.suit(scene.meshes, still=self._obstacle is not None):
            return False
        painted = self.layout.painted(scene)
        if painted is None or not self._tracer.repaint(*painted, scene):
            return False
        self.layout, self.scene = painted[0], scene
        self._motion.follow(scene.meshes)
        return True

    def _check_movable(self) -> None:
        if self._obstacle is not None:
            raise SceneError(
                f"objects move in a hierarchy or beside a grid, and this Renderer has {self._obstacle}: "
                'choose accel="bvh"'
            )

    @property
    def _obstacle(self) -> str | None:
        """The accelerator as the user wrote it, if objects cannot move in it; None if they can."""
        structure = self.integrator.structure
        return None if structure in (*MOVABLE, INSTANCES) else f"accel={structure!r}"

    def _follow_motion(self) -> None:
        """Update tables and accelerators to the present places of the objects, and samples to their programs' data."""
        if self.layout is not None and self._tracer.surfaces.sampled is not None:
            self._tracer.surfaces.sampled.follow()
        if not self._motion.changed:
            return
        with all_or_nothing(self):
            self._move_tables()
        self._motion.accept()

    def _move_tables(self) -> None:
        motion = self._motion
        self.scene = dataclasses.replace(self.scene, meshes=motion.meshes)
        assert self.layout is not None  # a mesh with triangles has changed
        if self.layout.instanced is not None:
            placed = moved_instances(motion, self.layout)
            if placed is None or not self._tracer.place(placed):
                self._prepare()
            else:
                self.layout = placed
            return
        changes = moved_rows(motion, self._moving, self.layout, self.integrator.precision)
        if changes is None or not self._tracer.renew(self.layout, changes):
            self._moving = tuple(sorted(motion.changed | set(self._moving)))
            self._prepare()

    @property
    def levels_around(self) -> NDArray[np.float32] | None:
        """The blurred environment that a kernel reads; None where it reads none."""
        return self._tracer.levels_around

    def _choose(self, camera: Camera, seen: bool = False, transparent: bool = False) -> None:
        """Take the kernels for a camera's projection, compiled once; `seen` where a G-buffer stands for eye rays."""
        transparent &= isinstance(self.integrator, Path)  # of other pictures the layers say which eye rays met nothing
        media = self._tracer.surfaces.media
        kind = camera.projection, bool(camera.aperture), media is not None and media.wades, seen, transparent
        if kind not in self._kinds:
            self._kinds[kind] = self._compiled(camera, seen, transparent)
        self.__dict__.update(self._kinds[kind])

    def _compiled(self, camera: Camera, seen: bool, transparent: bool) -> dict[str, Any]:
        """Compile the kernels for a camera's projection; return them as attributes."""
        started, rays = time.perf_counter(), eye_rays_of(camera)
        if isinstance(self._tracer, PathTracer):
            program = self._tracer.program(rays, transparent)
        elif isinstance(self.integrator, Staged):
            options = self._options | {"threshold": self.integrator.threshold, "early_z": self.integrator.early_z}
            staged = StagedTracer(self._tracer, rays, backend=self.backend, **options)
            staged.at_once.value = self.integrator.at_once
            self.compile_seconds += time.perf_counter() - started
            return {"staged": staged, "params": staged.params}
        elif seen:
            assert self.layout is not None
            program = seen_rays(self._tracer, rays, *first_tables(self.scene, self.layout))
        else:
            program = eye_rays(self._tracer, rays)
        recorded = time.perf_counter()
        # No loop limit: each iteration of the walk finishes a triangle or a cell, each iteration of the tracer a ray.
        try:
            kernel = program.compile(self.backend, **self._options, loop_limit=None)
        except sh.CompileError as error:
            if self.backend != "glsl":
                raise
            # The lines that it names, and its cure, are those of our kernels.
            reason = f"GLSL cannot run the kernel of this scene here: {error.message}"
            cure = 'backend="opencl" or backend="numpy"' + ('; or math="portable"' if error.lacks == "f64" else "")
            raise sh.CompileError(reason, cure=cure, lacks=error.lacks) from None
        self.record_seconds += recorded - started
        self.compile_seconds += time.perf_counter() - recorded
        return {"program": program, "kernel": kernel, "params": program.params}

    @in_turn
    def render(
        self,
        size: tuple[int, int] | None = None,
        *,
        camera: Camera | None = None,
        samples: int | None = None,
        progress: Progress | None = None,
        resume: Resume = None,
        primary: GBuffer | None = None,
        transparent: bool = False,
    ) -> Image:
        """Render a picture of `size` = (width, height) pixels; `samples` None are the integrator's. See `render`."""
        keywords: dict[str, Any] = {"camera": camera, "samples": samples, "progress": progress}
        size = size_of(size, primary, self.scene, self.integrator, self._samples(samples))
        if isinstance(self.integrator, Path):
            *_, image = self.passes(size, **keywords, resume=resume, transparent=transparent)
            return image
        check_resume(self.integrator, resume)
        _, height = checked_size(size)
        started = time.perf_counter()
        layers = self.rows(size, 0, height, **keywords, primary=primary, transparent=transparent)
        return Image(**layers, stats=self.stats(layers, started), samples=self._samples(samples))

    @in_turn
    def rows(
        self,
        size: tuple[int, int],
        top: int,
        count: int,
        *,
        camera: Camera | None = None,
        samples: int | None = None,
        progress: Progress | None = None,
        start: tuple[dict[str, Any], int] | None = None,
        primary: GBuffer | None = None,
        transparent: bool = False,
    ) -> dict[str, Any]:
        """Render the rows `top` to `top + count - 1` of a picture alone, with the bits that they have in the whole one.

        Return the layers of an `Image` of those rows. With a `Path`, `start` are the rows' layers in a picture of fewer
        samples, and their number. The other arguments are those of `render`.
        """
        samples = self._samples(samples)
        width, height = whole_size(size)
        check_rows(top, count, height)
        self._follow_motion()
        layers = unset(width, count, transparent=transparent)
        clear(layers, self.scene.background)
        if self.layout is None or not count:
            return layers
        if isinstance(self.integrator, Path):
            layers["pixels"][:] = layers["rays"][:] = 0  # the mean of no samples
            begun, first = start or (layers, 0)
            aim = functools.partial(self._aim_paths, camera, width, height, transparent)
            *_, (layers, _) = (begun, first), *self._passes(aim, begun, first, samples, progress, top)
            return layers
        fine = isqrt(samples)
        seen = [] if primary is None else seen_inputs(primary, self.scene, self.layout, self._tracer)
        self._aim(camera, width * fine, height * fine, primary is not None)
        if primary is not None:
            self.params["slack"].value = primary.slack
        self._bands(layers, top, fine, progress, seen)
        return layers

    @in_turn
    def origin(self, camera: Camera | None = None, transparent: bool = False) -> str:
        """Return the `Image.origin` of path traced pictures from a camera, None for the scene's; "" for others."""
        if not isinstance(self.integrator, Path):
            return ""
        tracer: Any = None if self.layout is None else self._tracer
        camera = checked_camera(self.scene.camera if camera is None else camera)
        return origin_of(self.scene, self.layout, tracer, camera, self.integrator, self.backend, transparent)

    def passes(
        self,
        size: tuple[int, int] = (512, 512),
        *,
        camera: Camera | None = None,
        samples: int | None = None,
        progress: Progress | None = None,
        resume: Resume = None,
        transparent: bool = False,
    ) -> Iterator[Image]:
        """Yield the path traced picture as it is after each pass over all pixels, the last one with all `samples`.

        For a `Path`; see `render`. The Renderer may make other pictures between two passes; raises SceneError if its
        scene has changed since the first one.
        """
        images = self._images(size, camera, samples, progress, resume, transparent)
        while True:
            with self.turn:
                image = next(images, None)
            if image is None:
                return
            yield image

    def _images(
        self,
        size: tuple[int, int],
        camera: Camera | None,
        samples: int | None,
        progress: Progress | None,
        resume: Resume,
        transparent: bool,
    ) -> Iterator[Image]:
        """Yield the pictures of `passes`."""
        if not isinstance(self.integrator, Path):
            raise SceneError('passes are those of integrator="path"')
        samples = self._samples(samples)
        width, height = checked_size(size, _PASSING)
        self._follow_motion()
        started, layers, first = time.perf_counter(), unset(width, height, transparent=transparent), 0
        origin = self.origin(camera, transparent)
        aim = functools.partial(self._aim_paths, camera, width, height, transparent)
        clear(layers, self.scene.background)
        if self.layout is not None:
            layers["pixels"][:] = layers["rays"][:] = 0  # the mean of no samples
        if resume is not None:
            layers, first = resumed(resume, (width, height), origin, samples)
        if first == samples or self.layout is None:
            yield Image(**layers, stats=self.stats(layers, started), samples=samples, origin=origin)
            return
        for pass_layers, done in self._passes(aim, layers, first, samples, progress):
            yield Image(**pass_layers, stats=self.stats(pass_layers, started), samples=done, origin=origin)

    def _passes(
        self,
        aim: Callable[[], None],
        layers: dict[str, Any],
        first: int,
        samples: int,
        progress: Progress | None = None,
        top: int = 0,
    ) -> Iterator[tuple[dict[str, Any], int]]:
        """Add samples to the layers of rows from `top` on; see `passes`. `aim` sets the eye rays before each pass."""
        assert self.layout is not None  # `passes` returns early for a scene without triangles
        aim()
        # A driver without a GPU ends loops of many iterations, and rays take more of them through a cube.
        at_once = 1 if self.backend == "glsl" and self.layout.secondary is not None else None
        device = self.kernel, self.params, self.backend, self.layout.scale
        scene = self.scene
        for pass_layers, done in passes(*device, layers, first, samples, progress, at_once, top):
            yield pass_layers, done
            if done == samples:
                return
            if self.scene is not scene:
                raise SceneError("the Renderer's scene has changed since these passes began: call passes() again")
            aim()

    def _samples(self, samples: int | None) -> int:
        """Return the number of samples of a picture; SceneError for one that the integrator cannot have."""
        if samples is None:
            return self.integrator.samples
        return dataclasses.replace(self.integrator, samples=samples).samples

    def stats(self, layers: dict[str, Any], started: float) -> Stats:
        """Return the cost of the layers, whose rendering began at `started`."""
        return Stats(
            backend=self.backend,
            seconds=time.perf_counter() - started,
            build_seconds=self.build_seconds,
            record_seconds=self.record_seconds,
            compile_seconds=self.compile_seconds,
            rays=int(layers["rays"].sum(dtype=np.int64)),
            triangles=self.scene.triangles,
            features=self.features,
            calls={} if self.staged is None else dict(self.staged.log.calls),
            alive=() if self.staged is None else tuple(self.staged.log.alive),
        )

    def _aim(
        self, camera: Camera | None, width: int, height: int, seen: bool = False, transparent: bool = False
    ) -> None:
        """Set the eye rays of a camera, None for the scene's."""
        camera = checked_camera(self.scene.camera if camera is None else camera)
        assert self.layout is not None
        layout, media = self.layout, self._tracer.surfaces.media
        values = camera.uniforms(width, height, layout.origin, layout.scale, layout.dtype)
        if media is not None:
            media.look_from(*camera.origins(values, width, height))
        self._choose(camera, seen, transparent)
        for name, value in values.items():
            self.params[name].value = value

    def _aim_paths(self, camera: Camera | None, width: int, height: int, transparent: bool) -> None:
        """Set the eye rays and the seed of path tracing."""
        assert isinstance(self.integrator, Path)
        self._aim(camera, width, height, transparent=transparent)
        self.params["seed"].value = self.integrator.seed

    def _bands(
        self, layers: dict[str, Any], top: int, fine: int, progress: Progress | None, seen: Sequence[Any] = ()
    ) -> None:
        """Trace the rows of layers, those of the picture from `top` on, band by band; `seen` is all of a G-buffer."""
        height, width = layers["depth"].shape
        kind = "numpy" if self.backend == "numpy" else "device"
        if self.staged is not None:
            kind, self.staged.log = "staged", Log()
        rows = rows_at_once(kind, width * fine * fine)
        for first in range(0, height, rows):
            past = min(first + rows, height)
            inputs = [array[top + first : top + past] for array in seen]
            band = {name: layer[first:past] for name, layer in layers.items()}
            self._band(Pixel(*(band[name] for name in LAYERS)), top + first, fine, inputs, band.get(ALPHA))
            if progress is not None:
                progress(past, height)

    def _band(self, band: Pixel, top: int, fine: int, inputs: Sequence[Any], alpha: Any) -> None:
        """Trace the rows of the picture from `top` on into `band`, and into `alpha` where there is that layer."""
        assert self.layout is not None
        self.params["first_row"].value = top * fine
        count, width = np.shape(band.depth)
        if fine == 1 and self.staged is None and self.kernel.options.precision == "f32":
            self.kernel.run(*inputs, shape=(count, width), out=band)
            if alpha is not None:
                alpha[:] = uncover(band)
        else:
            shape = (count * fine, width * fine)
            samples = self.kernel(*inputs, shape=shape) if self.staged is None else self.staged.trace(shape)
            take_samples(band, samples, fine, alpha)
        unscale(band, self.layout.scale)
