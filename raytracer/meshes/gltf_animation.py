"""The animations of a glTF file: translation, rotation and scale of nodes, and weights of morph targets, at any time.

Stage: scene description. Section numbers are those of glTF 2.0. `scene.animated_file` makes scenes of the poses.

    clip = Clip(document, names_of(document).index("Walk"))
    clip.pose(0.5)  # {3: {"rotation": [0.0, 0.0, 0.38, 0.92]}}
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.arrays import is_whole
from raytracer.errors import SceneError
from raytracer.meshes.folder import shown
from raytracer.meshes.gltf import Document

Array = NDArray[np.float64]
_PATHS: Final = {"translation": 3, "rotation": 4, "scale": 3}
"""The properties of nodes that channels change, and how many numbers each has; "weights" has one for each target."""
_PARALLEL: Final = 1e-6
"""The sine of the angle between quaternions below which they are interpolated linearly."""


class Track(NamedTuple):
    """The keys of one property of a node.

    `times` (N,) increase. `values` are (N, width); `tangents` (N, 2, width) come into a key and go out of it, of a
    CUBICSPLINE alone.
    """

    node: int
    path: str
    kind: str
    times: Array
    values: Array
    tangents: Array | None = None

    def at(self, time: float) -> list[float]:
        """Return the value at a time: that of the first key before it, and that of the last key after it."""
        after = int(np.searchsorted(self.times, time, side="right"))
        k = max(after - 1, 0)
        if after in (0, len(self.times)) or self.kind == "STEP":
            return _numbers(self.values[k])
        span = self.times[k + 1] - self.times[k]
        part = float((time - self.times[k]) / span)
        start, end = self.values[k], self.values[k + 1]
        if self.tangents is not None:
            return _numbers(_hermite(start, span * self.tangents[k, 1], end, span * self.tangents[k + 1, 0], part))
        if self.path == "rotation":
            return _numbers(slerp(start, end, part))
        return _numbers((1 - part) * start + part * end)


class Clip:
    """An animation of a document, by its number: `start` is its first key and `seconds` the time from it to the last.

    `obstacle` says why it cannot be shown; "" where it can. Raises SceneError, and what numpy and dict raise, for an
    animation that contradicts the format.
    """

    def __init__(self, document: Document, number: int) -> None:
        entry = document.one("animations", number)
        self.name = names_of(document)[number]
        self.tracks: list[Track] = []
        self.obstacle = ""
        seen: set[tuple[int, str]] = set()
        for channel in entry["channels"]:
            target = channel["target"]
            node, path = target.get("node"), str(target["path"])
            if path not in _PATHS and path != "weights":
                self.obstacle = f"changes the property {shown(path)}"
            elif node is not None:  # only an extension could name another target (section 3.11)
                if path in _PATHS and "matrix" in document.one("nodes", node):
                    raise SceneError(f"node {node} has a matrix, so that no animation can move it")
                if (node, path) in seen:
                    raise SceneError(f"two channels of an animation change the {path} of node {node}")
                seen.add((node, path))
                sampler = _one(entry["samplers"], channel["sampler"])
                self.tracks.append(_track(document, node, path, sampler))
        if not self.obstacle and not self.tracks:
            self.obstacle = "moves no nodes"
        self.start = min((float(track.times[0]) for track in self.tracks), default=0.0)
        self.seconds = max((float(track.times[-1]) for track in self.tracks), default=0.0) - self.start

    def pose(self, time: float) -> dict[int, dict[str, list[float]]]:
        """Return the animated properties of each node at a time in seconds after `start`, by node number."""
        pose: dict[int, dict[str, list[float]]] = {}
        for track in self.tracks:
            pose.setdefault(track.node, {})[track.path] = track.at(self.start + time)
        return pose


def names_of(document: Document) -> list[str]:
    """Return the names of the animations; one without a name is called by its number."""
    return [str(entry.get("name") or number) for number, entry in enumerate(document.all("animations"))]


def slerp(start: Array, end: Array, part: float) -> Array:
    """Interpolate unit quaternions (4,) on the shorter way, at a constant angular velocity (appendix C.4)."""
    cosine = float(start @ end)
    if cosine < 0:
        end, cosine = -end, -cosine
    angle = np.arccos(min(cosine, 1.0))
    sine = np.sin(angle)
    if sine < _PARALLEL:
        return np.asarray((1 - part) * start + part * end)
    return np.asarray((np.sin((1 - part) * angle) * start + np.sin(part * angle) * end) / sine)


def _hermite(start: Array, leaving: Array, end: Array, entering: Array, t: float) -> Array:
    """Return the cubic with these ends and derivatives by t at them (appendix C.5)."""
    square, cube = t * t, t * t * t
    ends = (2 * cube - 3 * square + 1) * start + (3 * square - 2 * cube) * end
    return ends + (cube - 2 * square + t) * leaving + (cube - square) * entering


def _track(document: Document, node: int, path: str, sampler: dict[str, Any]) -> Track:
    kind, width = str(sampler.get("interpolation", "LINEAR")), _PATHS.get(path) or _targets(document, node)
    if kind not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise SceneError(f"an animation has the interpolation {shown(kind)}, not LINEAR, STEP or CUBICSPLINE")
    times = document.array(sampler["input"]).astype(np.float64)
    values = document.array(sampler["output"]).astype(np.float64)
    rows = (3 if kind == "CUBICSPLINE" else 1) * len(times)
    if path == "weights" and values.size == rows * width:  # one number a row, target by target (section 3.11)
        values = values.reshape(rows, width)
    if times.shape[1] != 1 or not len(times) or values.shape != (rows, width):
        raise SceneError(f"the {path} of node {node} has keys {times.shape} and values {values.shape}")
    times = times[:, 0]
    if not (np.isfinite(times).all() and np.isfinite(values).all() and (np.diff(times) > 0).all()):
        raise SceneError(f"the keys of the {path} of node {node} do not increase, or are not finite")
    tangents = None
    if kind == "CUBICSPLINE":
        keys = values.reshape(-1, 3, width)
        values, tangents = keys[:, 1], keys[:, ::2]
    elif path == "rotation":
        values = values / (np.linalg.norm(values, axis=1, keepdims=True))
    return Track(node, path, kind, times, values, tangents)


def _one(samplers: list[dict[str, Any]], number: Any) -> dict[str, Any]:
    if not is_whole(number, 0, len(samplers) - 1):
        raise SceneError(f"it names sampler {shown(str(number))} of an animation that has {len(samplers)}")
    return samplers[number]


def _targets(document: Document, node: int) -> int:
    """Return the number of morph targets of a node's mesh."""
    mesh = document.one("meshes", document.one("nodes", node).get("mesh"))
    count = max((len(primitive.get("targets", [])) for primitive in mesh["primitives"]), default=0)
    if not count:
        raise SceneError(f"an animation changes the weights of node {node}, whose mesh has no morph targets")
    return count


def _numbers(values: Any) -> list[float]:
    return [float(value) for value in values]
