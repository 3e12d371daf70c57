"""Integrators: how a picture follows light, each a value that holds its own options.

Stage: render. `render` and `Renderer` take one; `chosen` makes one of the keywords that they took before.

>>> Path(samples=16)
Path(bounces=8, samples=16, accel=None, grid=None, precision='f32', math='strict', fuse=False, secondary=None, seed=0, \
clamp=None)
>>> chosen("whitted", {"tracer": "staged", "bounces": 1}).structure
'grid'
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import inf, isqrt
from typing import Any, ClassVar, Final, TypedDict

import numpy as np

from raytracer.accel.choice import INSTANCES, check
from raytracer.accel.grid import MAX_PER_SIDE
from raytracer.arrays import is_whole, one_float
from raytracer.errors import SceneError
from raytracer.kernels.shares import MIN_CONTRIBUTION
from raytracer.kernels.stages import AT_ONCE
from raytracer.layered.cube import LayeredCube, is_layered
from raytracer.scene.instanced import shares_many
from raytracer.scene.scene import Scene

THRESHOLD: Final = 0.2
"""The share of waiting rays in Christen's thesis."""
PRECISIONS: Final = ("f16", "f32", "f64")
MATH: Final = ("strict", "portable", "relaxed", "fast")
"""The values of `precision` and `math` that `Program.compile` takes."""
REPRODUCIBLE: Final = ("strict", "portable")
"""The modes of arithmetic in which all backends give the same bits, also with `fuse`."""
MOST_BOUNCES: Final = 64
MOST_AT_ONCE: Final = 1 << 16
MOST_SAMPLES: Final = 1 << 24
"""Samples of a path traced pixel, at most: f32 does not hold every larger number."""


@dataclass(frozen=True, kw_only=True)
class Integrator:
    """The options that every integrator has.

    `accel` is "bvh", "grid" or "brute", which differ only in time; None chooses the one that suits the integrator.
    With "instances" the instances of a mesh share its triangles: see docs/raytracer-files.md. A
    grid has `grid` cells along each axis; None chooses the number from the triangles. `precision`, `math` and `fuse`
    are those of `Program.compile`. Raises SceneError for options out of range, and for options that exclude each other.
    """

    bounces: int
    samples: int
    accel: str | None = None
    grid: int | None = None
    precision: str = "f32"
    math: str = "strict"
    fuse: bool = False

    _structure: ClassVar[str] = "bvh"

    def __post_init__(self) -> None:
        for name in (field.name for field in fields(self)):
            if isinstance(value := getattr(self, name), np.generic):
                object.__setattr__(self, name, value.item())
        if not is_whole(self.bounces, 0, MOST_BOUNCES):
            raise SceneError(f"bounces is a number from 0 to {MOST_BOUNCES}, not {self.bounces!r}")
        self._check_samples()
        _check_choice("precision", self.precision, PRECISIONS)
        _check_choice("math", self.math, MATH)
        if not isinstance(self.fuse, bool):
            raise SceneError(f"fuse is True or False, not {self.fuse!r}")
        if self.fuse and self.math not in REPRODUCIBLE:
            raise SceneError(f'math={self.math!r} contracts by itself: fuse=True is for "strict" and "portable"')
        check(self.structure, INSTANCES)
        if self.structure == INSTANCES and self.precision != "f32":
            raise SceneError(f'accel="instances" works at precision="f32", not {self.precision!r}')
        if self.grid is None:
            return
        if not is_whole(self.grid, 1, MAX_PER_SIDE):
            raise SceneError(f"a grid has from 1 to {MAX_PER_SIDE} cells along each axis, not {self.grid!r}")
        if self.structure != "grid":
            raise SceneError(f'grid={self.grid} is for accel="grid", not {self.structure!r}')

    def _check_samples(self) -> None:
        if not is_whole(self.samples, 1, 64) or isqrt(self.samples) ** 2 != self.samples:
            raise SceneError(f"samples is a square number from 1 to 64, not {self.samples!r}")

    @property
    def arithmetic(self) -> dict[str, Any]:
        """The keywords of `Program.compile` that say how kernels compute."""
        return {"precision": self.precision, "math": self.math, "fuse": self.fuse}

    @property
    def structure(self) -> str:
        """The accelerator of the eye rays."""
        return self._structure if self.accel is None or is_layered(self.accel) else self.accel


@dataclass(frozen=True, kw_only=True)
class Whitted(Integrator):
    """Light that comes from lights directly, in mirrors and through glass; one kernel follows a ray to its end.

    A ray is mirrored or refracted at most `bounces` times. A pixel is the mean of `samples` eye rays, a square number,
    on a regular grid; layers other than the colour come from the middle ray. `secondary`, a `LayeredCube`, finds
    the hits of all rays but the eye's; `accel="ldc[:resolution[:hit]]"` makes one.

    A mirrored or refracted ray is followed if its share of the pixel, in the brightest channel, is above
    `min_contribution`, from 0 to 1. The default, 2**-17, counts in scenes with glass alone, where each ray has two
    successors: without glass all `bounces` are followed, unless another number says otherwise. Sources: Whitted 1980;
    Christen 2005, section 2.2.
    """

    bounces: int = 3
    samples: int = 1
    secondary: LayeredCube | None = None
    min_contribution: float = MIN_CONTRIBUTION

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_cube(self)
        _check_share("min_contribution", self.min_contribution)

    @property
    def is_plain(self) -> bool:
        """Return True if the user chose no accelerator, grid, secondary accelerator or least contribution."""
        chosen = self.accel, self.grid, self.secondary, self.min_contribution
        return chosen == (None, None, None, MIN_CONTRIBUTION)


@dataclass(frozen=True, kw_only=True)
class Staged(Integrator):
    """The pictures of `Whitted`, bit for bit, by kernels over streams of rays, for scenes without glass.

    Rays walk through a grid or try every triangle. The intersector runs once the share `threshold` of the rays on
    their way, from 0 to 1, waits for it. In one call a ray goes through up to `at_once` cells or triangles; the thesis
    has 1. With `early_z` each call goes over all rays, after a pass that masks those in other states, as in the thesis:
    on GLSL by the depth test, elsewhere as `Kernel.run(where=)` does there. Without it, rays that have become few are
    copied to streams of their own. No option changes a bit of the pictures. Source: Christen 2005, sections 5.4 to 5.6.
    """

    bounces: int = 3
    samples: int = 1
    threshold: float = THRESHOLD
    at_once: int = AT_ONCE
    early_z: bool = False

    _structure: ClassVar[str] = "grid"

    def __post_init__(self) -> None:
        if self.accel is not None and is_layered(self.accel):
            raise SceneError(_NO_CUBE)
        super().__post_init__()
        if self.structure in ("bvh", INSTANCES):
            raise SceneError(
                f'the staged tracer goes through cells of a grid: accel="grid" or "brute", not "{self.structure}"'
            )
        _check_share("a threshold", self.threshold)
        if not is_whole(self.at_once, 1, MOST_AT_ONCE):
            raise SceneError(
                f"at_once is a number of cells or triangles from 1 to {MOST_AT_ONCE:,}, not {self.at_once!r}"
            )
        if not isinstance(self.early_z, bool):
            raise SceneError(f"early_z is True or False, not {self.early_z!r}")


@dataclass(frozen=True, kw_only=True)
class Path(Integrator):
    """An unbiased estimate of all light that surfaces scatter at most `bounces` times, from `samples` paths a pixel.

    Random numbers are points of Sobol', ordered and shifted by hashes of `seed`, from 0 to 2**32 - 1, the pixel and the
    dimension; a power of 2 as `samples` spreads them best. Layers other than the colour are those of the first sample.
    `secondary` is that of `Whitted`. Sources: Kajiya 1986; Kollig and Keller 2002.

    With `clamp` a sample's light that more than one surface has scattered is at most so bright, in its brightest
    channel, from each surface of the path: fewer bright dots, in a picture that is biased, as it is too dark.
    """

    bounces: int = 8
    samples: int = 64
    secondary: LayeredCube | None = None
    seed: int = 0
    clamp: float | None = None

    def __post_init__(self) -> None:
        if self.precision != "f32":
            raise SceneError(f'integrator="path" works at precision="f32", not {self.precision!r}')
        super().__post_init__()
        _check_seed(self.seed)
        _check_cube(self)
        if self.clamp is not None:
            _check_clamp(self.clamp)

    def _check_samples(self) -> None:
        if not is_whole(self.samples, 1, MOST_SAMPLES):
            raise SceneError(f"samples is a number from 1 to {MOST_SAMPLES:,}, not {self.samples!r}")


TRACERS: Final[Mapping[str, type[Integrator]]] = {"unified": Whitted, "staged": Staged}
INTEGRATORS: Final = ("whitted", "path")
Choice = Integrator | str
_NO_CUBE: Final = 'secondary rays go through a layered depth cube with tracer="unified" alone'


class Options(TypedDict, total=False):
    """The keywords that name an integrator and its options one by one; None stands for the default."""

    tracer: str
    bounces: int | None
    samples: int | None
    precision: str
    math: str
    fuse: bool
    accel: str | None
    threshold: float
    grid: int | None
    seed: int
    clamp: float | None
    secondary: LayeredCube | None
    min_contribution: float
    at_once: int
    early_z: bool


def chosen(integrator: Choice, options: Mapping[str, Any]) -> Integrator:
    """Return an integrator unchanged, or make it from a name, "whitted" or "path", and `Options`.

    A `threshold` and a `seed` may be given to integrators that have none. Raises SceneError for an unknown name, and
    for options that do not go together; TypeError for unknown options.
    """
    arguments = {name: value for name, value in options.items() if value is not None}
    if isinstance(integrator, Integrator):
        if arguments:
            name = next(iter(arguments))
            raise SceneError(
                f"{name} belongs to the integrator: {type(integrator).__name__}({name}={arguments[name]!r})"
            )
        return integrator
    if integrator not in INTEGRATORS:
        raise SceneError(f"the integrator is one of {', '.join(map(repr, INTEGRATORS))}, not {integrator!r}")
    tracer = arguments.pop("tracer", "unified")
    if integrator == "path" and tracer != "unified":
        raise SceneError(f'tracer={tracer!r} is for integrator="whitted": leave it out')
    if tracer not in TRACERS:
        raise SceneError(f"the tracer is one of {', '.join(map(repr, TRACERS))}, not {tracer!r}")
    kind = Path if integrator == "path" else TRACERS[tracer]
    if kind is Staged and arguments.pop("secondary", None) is not None:
        raise SceneError(_NO_CUBE)
    if kind is not Staged:
        _check_share("a threshold", arguments.pop("threshold", THRESHOLD))
    if kind is not Path:
        _check_seed(arguments.pop("seed", 0))
        if "clamp" in arguments:
            raise SceneError('clamp bounds the samples of integrator="path": choose it, or leave clamp out')
    option_names = [field.name for field in fields(kind)]
    for name in arguments:
        if name not in option_names:
            raise TypeError(f"{kind.__name__} has no option {name!r}: its options are {', '.join(option_names)}")
    return kind(**arguments)


def structure_of(integrator: Integrator, scene: Scene) -> str:
    """Return the accelerator of the eye rays in a scene: two levels of many instances, unless the user chose one."""
    suits = not isinstance(integrator, Staged) and integrator.accel is None and integrator.precision == "f32"
    if suits and getattr(integrator, "secondary", None) is None and shares_many(scene):
        return INSTANCES
    return integrator.structure


def check_scene(scene: Scene) -> None:
    """Raise SceneError unless this is a Scene that can be shown."""
    if not isinstance(scene, Scene):
        raise SceneError(f"pictures show a Scene, such as Scene.framed(mesh), not {scene!r:.60}")
    if not scene.triangles and not isinstance(scene.background, tuple):
        raise SceneError(
            "a scene without triangles shows a colour: a Texture or program as its background needs a mesh beside it"
        )
    if scene.environment is not None and not scene.triangles:
        raise SceneError("a scene without triangles shows its background: an EnvironmentLight needs something to light")


def _check_choice(option: str, value: Any, choices: tuple[str, ...]) -> None:
    if not (isinstance(value, str) and value in choices):
        raise SceneError(f"{option} is one of {', '.join(map(repr, choices))}, not {value!r}")


def _check_share(what: str, share: Any) -> None:
    if isinstance(share, bool) or not isinstance(share, int | float) or not 0 <= share <= 1:
        raise SceneError(f"{what} is a share from 0 to 1, not {share!r}")


def _check_seed(seed: Any) -> None:
    if not is_whole(seed, 0, 2**32 - 1):
        raise SceneError(f"a seed is a whole number from 0 to 2**32 - 1, not {seed!r}")


def _check_clamp(clamp: Any) -> None:
    brightness = None if isinstance(clamp, bool) else one_float(clamp)
    if brightness is None or not 0 < brightness < inf:
        raise SceneError(f"clamp is a brightness above 0, or None for no bound, not {clamp!r}")


def _check_cube(integrator: Whitted | Path) -> None:
    secondary, accel = integrator.secondary, integrator.accel
    if secondary is not None and not isinstance(secondary, LayeredCube):
        raise SceneError(f"secondary is a LayeredCube, not {type(secondary).__name__}")
    if integrator.precision != "f32" and (secondary is not None or (accel is not None and is_layered(accel))):
        raise SceneError(f'a layered depth cube works at precision="f32", not {integrator.precision!r}')
