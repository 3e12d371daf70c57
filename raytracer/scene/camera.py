"""The camera: its position, its target, and its eye rays for a picture of a given size.

Stage: scene description. `view` gives the few vectors from which the kernel makes the ray of each pixel.

>>> Camera(position=(0, 0, 5), target=(0, 0, 0), fov=90).view(2, 2).across.round(9).tolist()
[1.0, -0.0, 0.0]
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raytracer.accel.space import placed
from raytracer.appearance.materials import Triple
from raytracer.arrays import finite_triple, numbers, one_float
from raytracer.errors import SceneError

Vector = NDArray[np.float64]
_DOUBLE: np.dtype[Any] = np.dtype(np.float64)
Projection = Literal["perspective", "orthographic", "panorama"]
ALONG = 1e-9
"""The largest sine of the angle between two directions that are taken for one."""


class View(NamedTuple):
    """The eye ray through pixel (row, column) runs along `corner + (column + 1/2) across + (row + 1/2) down`."""

    eye: Vector
    corner: Vector
    across: Vector
    down: Vector


def radius_of(low: Vector, high: Vector) -> float:
    """Return half the diagonal of a box; for a single point, a length that does not vanish beside its coordinates."""
    radius = _direction(np.subtract(high, low))[0] / 2
    return radius or 1e-6 * max(float(np.abs(low).max()), 1.0)


def _direction(vector: ArrayLike) -> tuple[float, Vector]:
    """Return the length of a vector and the unit vector along it; zero stays zero.

    A power of two, which rounds nothing, brings large and small components to where binary64 holds their squares.
    """
    _, exponent = np.frexp(np.abs(vector).max())
    near = np.ldexp(vector, -exponent)
    size = np.linalg.norm(near)
    return float(np.ldexp(size, exponent)), near / (size or 1)


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A calibrated camera: `matrix`, 9 numbers by rows, maps a pixel (x, y, 1) to the direction of its eye ray."""

    matrix: tuple[float, ...]
    size: tuple[int, int]

    def view(self, eye: Vector, width: int, height: int) -> View:
        """Return the vectors that give the eye rays of a picture of `width` by `height` pixels."""
        across, down, corner = np.reshape(self.matrix, (3, 3)).T
        return View(eye, corner, across * (self.size[0] / width), down * (self.size[1] / height))


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera at `position` looking at `target`.

    `up` may be any direction except along the line of sight. In a "perspective" picture `fov` is the angle, in degrees,
    across its shorter side. In an "orthographic" one eye rays are parallel, and `span` is the extent of the scene, in
    the scene's units, that the shorter side shows. A "panorama" shows all directions, 360 degrees wide and 180 high,
    the target in its middle (an equirectangular projection).

    A camera with an `aspect` other than 1, width by height, has a frame of this shape, as cameras of files do: `fov`
    and `span` are those across the frame's shorter side. A picture of any shape shows the whole frame in its middle.

    A perspective camera has a thin lens where `aperture`, the lens's diameter in the scene's units, is not 0. Points at
    the distance `focus` along the line of sight are sharp; None focuses on the target. Each sample of a pixel passes
    through another point of the lens, which depends only on the pixel and the sample (Cook, Porter and Carpenter 1984).

    Raises SceneError for numbers out of range, and where position, target and up give no direction of view.
    """

    position: Triple
    target: Triple = (0.0, 0.0, 0.0)
    up: Triple = (0.0, 1.0, 0.0)
    fov: float = 40.0
    projection: Projection = "perspective"
    span: float = 2.0
    aperture: float = 0.0
    focus: float | None = None
    intrinsics: Intrinsics | None = None
    aspect: float = 1.0

    def __post_init__(self) -> None:
        for name in ("position", "target", "up"):
            object.__setattr__(self, name, finite_triple(f"a camera's {name}", getattr(self, name)))
        for name in ("fov", "span", "aperture", "focus", "aspect"):
            object.__setattr__(self, name, self._number(name))
        if not 0 < self.fov < 180:
            raise SceneError(f"a camera's fov lies between 0 and 180 degrees, not {self.fov}")
        if self.position == self.target:
            raise SceneError("a camera cannot look at its own position")
        distance, forward = self._sight
        if not math.isfinite(distance):
            raise SceneError("a camera's position and target are too far from each other: the distance leaves binary64")
        if np.linalg.norm(np.cross(forward, _direction(self.up)[1])) <= ALONG:
            raise SceneError("a camera's up must not be along its line of sight")
        if self.projection not in get_args(Projection):
            raise SceneError(
                f"a camera's projection is one of {', '.join(get_args(Projection))}, not {self.projection!r}"
            )
        if not 0 < self.span < math.inf:
            raise SceneError(f"a camera's span is a length above 0, not {self.span}")
        if not 0 <= self.aperture < math.inf:
            raise SceneError(f"a camera's aperture is a length, 0 for a pinhole, not {self.aperture}")
        if not 0 < self.aspect < math.inf:
            raise SceneError(f"a camera's aspect is the width of its frame by the height, above 0, not {self.aspect}")
        if self.focus is not None and not 0 < self.focus < math.inf:
            raise SceneError(f"a camera's focus is a distance above 0, not {self.focus}")
        if self.aperture and self.projection != "perspective":
            raise SceneError(f"an aperture is for a perspective camera, not for projection='{self.projection}'")

    def _number(self, name: str) -> float | None:
        """Return a number of the camera as a float; None for the `focus` that the target has."""
        value = getattr(self, name)
        if value is None and name == "focus":
            return None
        number = one_float(value)
        if number is None:
            raise SceneError(f"a camera's {name} is a number, not {value!r}")
        return number

    @property
    def _sight(self) -> tuple[float, Vector]:
        """The distance of the target, infinite beyond binary64, and the unit vector to it."""
        with np.errstate(over="ignore", invalid="ignore"):
            return _direction(np.subtract(self.target, self.position))

    @property
    def axes(self) -> tuple[Vector, Vector, Vector]:
        """Unit vectors to the right, up, and along the line of sight."""
        _, forward = self._sight
        _, right = _direction(np.cross(forward, _direction(self.up)[1]))
        return right, np.cross(right, forward), forward

    def view(self, width: int, height: int) -> View:
        """Return the vectors of a perspective picture's eye rays, `width` by `height` pixels; row 0 is the top one."""
        if self.intrinsics is not None:
            return self.intrinsics.view(np.asarray(self.position, dtype=np.float64), width, height)
        right, above, forward = self.axes
        pixel = self._pixel(2 * math.tan(math.radians(self.fov) / 2), width, height)
        across, down = right * pixel, -above * pixel
        corner = forward - across * (width / 2) - down * (height / 2)
        return View(np.asarray(self.position, dtype=np.float64), corner, across, down)

    def _pixel(self, shorter: float, width: int, height: int) -> float:
        """Return the side of a pixel where the whole frame is shown, whose shorter side is `shorter` long."""
        return max(shorter * max(self.aspect, 1.0) / width, shorter * max(1 / self.aspect, 1.0) / height)

    def uniforms(
        self, width: int, height: int, origin: Vector, scale: float, dtype: np.dtype[Any] = _DOUBLE
    ) -> dict[str, Any]:
        """Return the params of `kernels.eye_rays`, where positions are from `origin`, times `scale`.

        Raises SceneError for numbers that `dtype`, the kernel's working precision, or a Param does not hold.
        """
        dtype_of_params = min(
            dtype, np.dtype(np.float32), key=lambda floats: floats.itemsize
        )  # Params are no wider than f32
        place = placed("the camera", self.position, origin, scale, dtype_of_params)
        with np.errstate(over="ignore", invalid="ignore"):
            uniforms = self._uniforms(place, width, height, scale)
        if not all(np.all(np.abs(value) <= np.finfo(dtype_of_params).max) for value in uniforms.values()):
            raise SceneError(
                f"the span, aperture or focus of the camera is too large for a scene of this size, in floats of "
                f"{8 * dtype_of_params.itemsize} bits: scale the scene, or choose a smaller one"
            )
        return uniforms

    def _uniforms(self, place: Vector, width: int, height: int, scale: float) -> dict[str, Any]:
        """Return the params of a camera at `place`, in the kernel's coordinates."""
        right, above, forward = self.axes
        if self.projection == "panorama":
            return {"eye": place, "right": right, "above": above, "forward": forward, "size": (width, height)}
        if self.projection == "orthographic":
            pixel = self._pixel(self.span * scale, width, height)
            across, down = right * pixel, -above * pixel
            corner = place - across * (width / 2) - down * (height / 2)
            return {"eye": corner, "corner": forward, "across": across, "down": down}
        view = self.view(width, height)
        uniforms: dict[str, Any] = view._replace(eye=place)._asdict()
        if self.aperture:
            focus = self._sight[0] if self.focus is None else self.focus
            uniforms["focus"] = focus * scale
            uniforms |= {
                "lens_right": right * (self.aperture * scale / 2),
                "lens_above": above * (self.aperture * scale / 2),
            }
        return uniforms

    def origins(self, uniforms: dict[str, Any], width: int, height: int) -> tuple[Vector, Vector]:
        """Return the middle of the box in which a picture's eye rays start, and half its size, by its `uniforms`."""
        if self.projection == "orthographic":
            across, down = uniforms["across"] * (width / 2), uniforms["down"] * (height / 2)
            return uniforms["eye"] + across + down, abs(across) + abs(down)
        if self.projection == "perspective" and self.aperture:
            return uniforms["eye"], abs(uniforms["lens_right"]) + abs(uniforms["lens_above"])
        return uniforms["eye"], np.zeros(3)

    @classmethod
    def from_intrinsics(
        cls, K: ArrayLike, pose: ArrayLike, size: tuple[int, int], *, aperture: float = 0.0, focus: float | None = None
    ) -> Camera:
        """Make the pinhole camera of a calibration.

        `K` (3, 3) is the matrix of the intrinsics in pixels, [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], of pictures of
        `size` (width, height); the top left pixel reaches from (0, 0) to (1, 1), so that its centre is (0.5, 0.5): add
        0.5 to the cx and cy of OpenCV. `pose` (4, 4) or (3, 4) takes points of the camera to the scene, the camera's x
        to the right, y down and z forward (Hartley and Zisserman 2004, section 6.1). A picture of another size shows
        the same part of the scene. Raises SceneError for other shapes and matrices that are no calibration or pose.
        """
        matrix, place = numbers("the numbers of K", K), numbers("the numbers of a pose", pose)
        matrix, place = matrix.astype(np.float64), place.astype(np.float64)
        if matrix.shape != (3, 3) or place.shape not in ((4, 4), (3, 4)):
            raise SceneError(f"K is (3, 3) and a pose (4, 4) or (3, 4), not {matrix.shape} and {place.shape}")
        if not (np.all(np.isfinite(matrix)) and np.all(np.isfinite(place))):
            raise SceneError("K and pose are finite numbers")
        if not (matrix[0, 0] > 0 and matrix[1, 1] > 0) or np.any(matrix[[1, 2, 2, 2], [0, 0, 1, 2]] != (0, 0, 0, 1)):
            raise SceneError(
                f"K is [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] with positive fx and fy, not {matrix.tolist()}"
            )
        turn = place[:3, :3]
        if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-4 or np.linalg.det(turn) < 0:
            raise SceneError("the first three columns of a pose are a rotation: orthogonal, of determinant 1")
        try:
            width, height = (int(n) for n in size if int(n) == n)
        except (TypeError, ValueError, OverflowError):
            width = height = 0
        if not (0 < width < 1 << 31 and 0 < height < 1 << 31):
            raise SceneError(f"a size is (width, height) in whole pixels, not {size!r}")
        x, y, z = place[:3, 3].tolist()
        forward, up = place[:3, 2].tolist(), (-place[:3, 1]).tolist()
        fov = math.degrees(2 * math.atan(min(width / matrix[0, 0], height / matrix[1, 1]) / 2))
        intrinsics = Intrinsics(tuple((turn @ np.linalg.inv(matrix)).reshape(-1).tolist()), (width, height))
        return cls(
            (x, y, z), (x + forward[0], y + forward[1], z + forward[2]), tuple(up), fov,
            aperture=aperture, focus=focus, intrinsics=intrinsics,
        )  # fmt: skip

    @classmethod
    def framing(cls, low: Vector, high: Vector, *, toward: Triple = (0.42, 0.42, 1.0), fov: float = 32.0) -> Camera:
        """Return a camera in the direction `toward` of the box from `low` to `high`, as near as it sees all of it."""
        middle = (np.asarray(low) + np.asarray(high)) / 2
        radius = radius_of(low, high)
        direction = np.asarray(toward, dtype=np.float64) / np.linalg.norm(toward)
        position = middle + direction * radius / math.sin(math.radians(fov) / 2)
        x, y, z = position.tolist()
        a, b, c = middle.tolist()
        return cls((x, y, z), (a, b, c), fov=fov)


def checked_camera(camera: Any) -> Camera:
    """Return a camera; SceneError for anything else."""
    if not isinstance(camera, Camera):
        raise SceneError(f"the camera of a scene is a Camera, such as Camera((0, 0, 5)), not {camera!r}")
    return camera
