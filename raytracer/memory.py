"""A check that a picture fits into memory, made before anything runs: Linux overcommits memory, and kills later.

check_fits(32768, 32768)          # SceneError: ... takes 38,654,705,664 bytes of memory, and ... are free
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from raytracer.errors import SceneError

PIXEL = 36
"""Bytes of a pixel in all layers of an `Image`."""

TRIANGLE = 500
"""Bytes that a triangle takes at least in a scene and its tables: corners, normals and a part of the accelerator."""
INSTANCE = 4
"""Triangles whose memory an instance takes at least, in a scene and its tables."""

_GROUPS = (
    ("/sys/fs/cgroup", "memory.max", "memory.current", "inactive_file"),
    ("/sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
)
"""Files in which versions 2 and 1 of Linux's control groups give a container's limit, its use, and how much of that is
contents of files, which Linux gives up first."""


class OutOfMemory(SceneError):
    """Triangles exceed the free memory."""


def check_fits(width: int, height: int, saving: int = 0, layer_bytes: int = PIXEL) -> None:
    """Raise SceneError if a picture of this size, with `saving` bytes more a pixel for its file, exceeds free memory.

    `layer_bytes` is how many bytes a pixel's layers take of it.

    Where the system does not tell how much memory is free, nothing is raised.
    """
    needed, free = width * height * (layer_bytes + saving), free_bytes()
    if free is not None and needed > free:
        raise SceneError(
            f"a picture of {width} x {height} pixels takes {needed:,} bytes of memory, and {free:,} are free: "
            "choose a smaller size"
        )


def check_triangles(count: int) -> None:
    """Raise OutOfMemory if a scene with this number of triangles exceeds free memory."""
    needed = count * TRIANGLE
    free = free_bytes() if needed > 1 << 26 else None
    if free is not None and needed > free:
        raise OutOfMemory(f"{count:,} triangles take {needed:,} bytes of memory or more, and {free:,} are free")


def free_bytes() -> int | None:
    """Return the bytes that this process can still get, swap included; None where the system does not tell."""
    amounts = [free for free in (_free_in_system(), *(_free_in_group(*group) for group in _GROUPS)) if free is not None]
    return min(amounts, default=None)


def _free_in_system() -> int | None:
    with suppress(OSError, ValueError, KeyError):
        lines = (line.split() for line in Path("/proc/meminfo").read_text().splitlines())
        kibibytes = {words[0]: int(words[1]) for words in lines}
        return 1024 * (kibibytes["MemAvailable:"] + kibibytes["SwapFree:"])
    return None


def _free_in_group(folder: str, most: str, used: str, files: str) -> int | None:
    with suppress(OSError, ValueError, KeyError):  # a group without a limit says "max", which is no number
        limit, usage = (int(Path(folder, name).read_text()) for name in (most, used))
        parts = dict(line.split() for line in Path(folder, "memory.stat").read_text().splitlines())
        return max(0, limit - usage + int(parts[files]))
    return None
