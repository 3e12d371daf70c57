"""A picture and its layers, and writing it: PNG, JPEG and WebP for the eye, EXR and NPY for numbers.

Stage: picture. `render` gives an `Image`; `save` chooses the format by the path's ending, writes to a temporary name
beside it and renames, so that an interrupted run leaves no broken file.

    render(scene).save("picture.png")
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.arrays import one_float
from raytracer.errors import SceneError
from raytracer.tone_mapping import Tonemap, checked_curve, mapped

Array = NDArray[Any]

LAYERS: Mapping[str, tuple[Any, tuple[int, ...]]] = {
    "pixels": (np.float32, (3,)),
    "depth": (np.float32, ()),
    "normal": (np.float32, (3,)),
    "object_id": (np.int32, ()),
    "rays": (np.int32, ()),
}
"""The dtype of each layer of a picture, and the shape of its entry for a pixel."""
ALPHA: Final = "alpha"
"""The layer that a transparent picture has besides these, float32 like its depth."""
_ENCODED = 1 << 18
"""Pixels that are encoded at once, in binary64: a large picture needs little memory besides its own."""


def encoded(pixels: Array) -> Array:
    """Convert linear RGB (..., 3), clipped to [0, 1], to sRGB in [0, 1] (IEC 61966-2-1), in binary64."""
    return sh.screen.srgb(pixels.astype(np.float64))


def srgb_bytes(pixels: Array, exposure: float = 0.0, tonemap: str = "none") -> NDArray[np.uint8]:
    """Convert linear RGB (H, W, 3), times 2**exposure, through a curve and clipped to [0, 1], to bytes of sRGB."""
    srgb = np.empty(pixels.shape, dtype=np.uint8)
    rows = max(1, _ENCODED // max(1, pixels.shape[1]))
    for top in range(0, len(srgb), rows):
        srgb[top : top + rows] = np.rint(encoded(mapped(pixels[top : top + rows], tonemap, exposure)) * 255)
    return srgb


@dataclass(frozen=True, slots=True)
class Stats:
    """The cost of a picture: times in seconds, numbers of rays and triangles, and the `features` of its kernel.

    `picked` is the variant that `max_error` chose, if it was given. Of the staged tracer `calls` says how often each
    kernel ran, and `alive` how many rays each round began with. Of a picture in partitions `moved` says how many
    records of rays went from part to part, their bytes, in how many rounds, and how many rays the parts traced.
    """

    backend: str
    seconds: float
    build_seconds: float
    record_seconds: float
    compile_seconds: float
    rays: int
    triangles: int
    features: Mapping[str, bool | int] = field(default_factory=dict)
    picked: str = ""
    calls: Mapping[str, int] = field(default_factory=dict)
    alive: tuple[int, ...] = ()
    moved: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """A picture of height H and width W, row 0 at the top.

    `pixels` (H, W, 3) float32 linear RGB; `depth` (H, W) float32 along the eye ray, infinity where nothing is hit;
    `normal` (H, W, 3) float32 unit shading normals, zero there; `object_id` (H, W) int32 the mesh's place in the
    scene, -1 there; `rays` (H, W) int32 how many rays were traced for the pixel. `samples` is how many eye rays the
    pixels are the means of, and `origin` names what a path traced picture was made from: see `render(resume=...)`.

    `alpha` (H, W) float32 is the share of a pixel's eye rays that meet a surface, for a picture that was rendered with
    `transparent=True`, and None for others. Its `pixels` are premultiplied: the light of these surfaces alone.
    """

    pixels: Array
    depth: Array
    normal: Array
    object_id: Array
    rays: Array
    stats: Stats
    samples: int = 1
    origin: str = ""
    alpha: Array | None = None

    @property
    def layers(self) -> dict[str, Array]:
        """The arrays by name; `alpha` is one of them where the picture has it."""
        layers = {name: getattr(self, name) for name in LAYERS}
        return layers if self.alpha is None else layers | {ALPHA: self.alpha}

    @property
    def straight(self) -> Array:
        """The pixels divided by `alpha`: the colours of the surfaces, 0 where there are none."""
        if self.alpha is None:
            return self.pixels
        alpha = self.alpha[..., None]
        return np.where(alpha > 0, self.pixels / np.where(alpha > 0, alpha, 1), np.float32(0))

    @property
    def srgb(self) -> NDArray[np.uint8]:
        """The pixels as sRGB bytes (IEC 61966-2-1), clipped to [0, 1]."""
        return srgb_bytes(self.pixels)

    def srgb8(self) -> NDArray[np.uint8]:
        """Return the pixels as sRGB bytes (H, W, 3), clipped to [0, 1] (IEC 61966-2-1): `srgb`, as a method."""
        return self.srgb

    def to_pil(self, exposure: float = 0.0, tonemap: Tonemap = "none") -> Any:
        """Return a `PIL.Image.Image` of the mode RGB in sRGB, or RGBA with straight alpha; arguments as of `save`.

        Raises SceneError where Pillow is missing.
        """
        bytes_ = srgb_bytes(self.straight, _checked_stops(exposure), checked_curve(tonemap))
        if self.alpha is not None:
            alpha = np.rint(np.clip(self.alpha, 0, 1) * 255).astype(np.uint8)
            bytes_ = np.concatenate([bytes_, alpha[..., None]], axis=2)
        return _pillow().fromarray(bytes_)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        """Return the pixels, (H, W, 3) linear RGB, for `np.asarray(image)`."""
        return np.array(self.pixels, dtype, copy=copy)

    def save(self, path: str | PathLike[str], exposure: float = 0.0, tonemap: Tonemap = "none") -> Path:
        """Write as `.png`, `.jpg` or `.webp` (sRGB), `.exr` or `.npy` (linear, all layers); return the path.

        JPEG has the quality 95 and a colour for each pixel, WebP loses nothing. Pictures for the eye are brighter by
        2**exposure, and `tonemap` takes light of any brightness to what a screen shows: "reinhard", "aces", "agx" or
        "neutral" (`raytracer.tone_mapping` has their sources); with "none" what exceeds 1 is clipped. A picture with
        `alpha` has it in PNG and WebP files, straight, and in the others, premultiplied.

        The NPY file is a structured array with the fields pixels, depth, normal, object_id and rays; a second array
        after it holds `samples` and `origin`, which are attributes of the EXR file's header.
        Raises SceneError for another ending and where a package is missing, for an exposure or a curve in files of
        numbers, which hold the light as it is, and for alpha in JPEG files; OSError for a path that cannot be written:
        FileNotFoundError where the folder does not exist.
        """
        path = Path(path)
        height, width = self.depth.shape
        write = writer(path, (width, height), alpha=self.alpha is not None)
        if path.suffix.lower() in READING and (_checked_stops(exposure), checked_curve(tonemap)) != (0, "none"):
            raise SceneError(
                f"{path}: exposure and tonemap are for pictures for the eye, such as .png; "
                f"{' and '.join(READING)} hold the light as it is"
            )
        with sh.files.replacing(path) as temporary:
            write(self, str(temporary), exposure, tonemap)
        return path

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Image:
        """Read a picture that `save` wrote as `.exr` or `.npy`; its `stats` are empty.

        Raises FileNotFoundError, and SceneError for another ending and a file that `save` did not write.
        """
        path = Path(path)
        if path.suffix.lower() not in _READERS:
            raise SceneError(
                f"{path}: pictures are read from {' and '.join(_READERS)}, not from {path.suffix or 'this'}"
            )
        if not path.is_file():
            raise FileNotFoundError(f"there is no picture {path}")
        try:
            layers, samples, origin = _READERS[path.suffix.lower()](path)
        except SceneError:
            raise
        # Decoders raise errors of many types. Whichever it is, the user can only repair the file.
        except Exception as error:
            raise SceneError(
                f"{path}: no picture that raytracer saved ({' '.join(str(error).split())[:200]})"
            ) from error
        return cls(**layers, stats=Stats("", 0.0, 0.0, 0.0, 0.0, 0, 0), samples=samples, origin=origin)

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.to_pil().save(buffer, "PNG")
        return buffer.getvalue()


Writer = Callable[[Image, str, float, Tonemap], None]
"""Writes a picture to a file of this name, with an exposure and a curve where it is for the eye."""


def writer(path: Path, size: tuple[int, int], alpha: bool = False) -> Writer:
    """Return the function that writes pictures of this (width, height) to a path, before anything is rendered.

    `alpha` says whether they have it. Raises as `Image.save` does.
    """
    ending = path.suffix.lower()
    if path.is_dir():
        raise SceneError(f"{path} is a folder: name a file in it, such as {path / 'picture.png'}")
    if ending not in _WRITERS:
        raise SceneError(f"{path}: pictures are written as {', '.join(_WRITERS)}, not as {path.suffix or 'this'}")
    most = _LONGEST.get(ending)
    if most is not None and max(size) > most:
        raise SceneError(f"{path}: {ending[1:]} holds at most {most:,} pixels a side, not {max(size):,}: .png")
    if alpha and ending in _OPAQUE:
        raise SceneError(f"{path}: {ending[1:]} holds no alpha: write a transparent picture as .png, .webp or .exr")
    if ending in _PACKAGES:
        _PACKAGES[ending]()
    sh.files.check_writable(path)
    return _WRITERS[ending]


def _pillow() -> Any:
    try:
        from PIL import Image as pillow
    except ImportError as error:
        raise SceneError(f"writing PNG, JPEG and WebP needs Pillow: {sh.packages.install('pillow')}") from error
    return pillow


MOST_STOPS: Final = 64.0
"""The largest exposure, in stops: beyond it a picture is black or white."""


def _checked_stops(exposure: Any) -> float:
    """Return an exposure; SceneError for what is no number of stops."""
    stops = one_float(exposure)
    if stops is None or not abs(stops) <= MOST_STOPS:
        raise SceneError(f"an exposure is a number of stops from -{MOST_STOPS:g} to {MOST_STOPS:g}, not {exposure!r}")
    return stops


def openexr(purpose: str) -> Any:
    """Import OpenEXR. Raises SceneError where it is missing, which `purpose` begins."""
    try:
        import OpenEXR
    except ImportError as error:
        raise SceneError(f"{purpose} needs OpenEXR: {sh.packages.install('OpenEXR')}") from error
    return OpenEXR


def _write_encoded(options: dict[str, Any], image: Image, name: str, exposure: float, tonemap: Tonemap) -> None:
    image.to_pil(exposure, tonemap).save(name, **options)


def _write_exr(image: Image, name: str, *_: Any) -> None:
    exr = openexr("writing EXR")
    channels = {"RGB": np.ascontiguousarray(image.pixels), "depth.Z": np.ascontiguousarray(image.depth)}
    if image.alpha is not None:
        channels = {"RGBA": np.concatenate([channels.pop("RGB"), image.alpha[..., None]], axis=2), **channels}
    channels |= {f"normal.{axis}": np.ascontiguousarray(image.normal[..., k]) for k, axis in enumerate("XYZ")}
    channels |= {"object.id": image.object_id.astype(np.float32), "rays.count": image.rays.astype(np.float32)}
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    header |= {"samples": image.samples, "origin": image.origin}
    with exr.File(header, channels) as file:
        try:
            file.write(name)
        except RuntimeError as error:  # for instance, the disk is full
            raise OSError(f"OpenEXR cannot write: {error}") from error


def _write_npy(image: Image, name: str, *_: Any) -> None:
    kinds = [(key, layer.dtype, layer.shape[2:]) for key, layer in image.layers.items()]
    record = np.empty(image.depth.shape, dtype=kinds)
    for key, layer in image.layers.items():
        record[key] = layer
    state = np.array(
        (image.samples, image.origin), [("samples", np.int64), ("origin", f"U{max(1, len(image.origin))}")]
    )
    with open(name, "wb") as file:
        np.save(file, record)
        np.save(file, state)


def _read_npy(path: Path) -> tuple[dict[str, Array], int, str]:
    with open(path, "rb") as file:
        record, state = np.load(file), np.load(file)
    names = [*LAYERS, *([ALPHA] if ALPHA in (record.dtype.names or ()) else [])]
    return {name: np.ascontiguousarray(record[name], _kind(name)) for name in names}, *state.item()


def _kind(name: str) -> Any:
    return np.float32 if name == ALPHA else LAYERS[name][0]


def _read_exr(path: Path) -> tuple[dict[str, Array], int, str]:
    with openexr("reading EXR").File(str(path), separate_channels=True) as file:
        header = dict(file.header())  # the file empties its own when it is closed
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    parts = {
        "pixels": np.stack([channels[c] for c in "RGB"], axis=-1),
        "depth": channels["depth.Z"],
        "normal": np.stack([channels[f"normal.{axis}"] for axis in "XYZ"], axis=-1),
        "object_id": channels["object.id"],
        "rays": channels["rays.count"],
    }
    parts |= {ALPHA: channels["A"]} if "A" in channels else {}
    layers = {name: np.ascontiguousarray(layer, _kind(name)) for name, layer in parts.items()}
    return layers, int(header["samples"]), str(header["origin"])


_READERS: dict[str, Callable[[Path], tuple[dict[str, Array], int, str]]] = {".exr": _read_exr, ".npy": _read_npy}
READING = tuple(_READERS)
_JPEG: dict[str, Any] = {"format": "JPEG", "quality": 95, "subsampling": 0}
_EYE: dict[str, dict[str, Any]] = {
    ".png": {"format": "PNG", "optimize": True},
    ".jpg": _JPEG,
    ".jpeg": _JPEG,
    ".webp": {"format": "WEBP", "lossless": True},
}
"""The options with which Pillow writes pictures for the eye."""
_OPAQUE: Final = (".jpg", ".jpeg")
_LONGEST = {".jpg": 65_500, ".jpeg": 65_500, ".webp": 16_383}
"""The longest side of a picture in pixels."""
_WRITERS: dict[str, Writer] = {
    **{ending: partial(_write_encoded, options) for ending, options in _EYE.items()},
    ".exr": _write_exr,
    ".npy": _write_npy,
}
SAVING: Mapping[str, int] = {**dict.fromkeys(_EYE, 10), ".exr": 56, ".npy": 36}
"""Bytes of a pixel that saving needs besides the layers: the file's own copies of them."""
_PACKAGES: dict[str, Callable[[], Any]] = {**dict.fromkeys(_EYE, _pillow), ".exr": lambda: openexr("writing EXR")}
