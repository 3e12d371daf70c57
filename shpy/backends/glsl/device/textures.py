"""Arrays as textures, and textures as arrays: what a full-screen pass reads and writes.

Stage: run. A flat array of elements becomes rows of a 2-D texture, 32-bit integers as integer textures, so that they
stay exact, bools as bytes, in one to four components. Textures and framebuffers are lent and given back; the copy of
a table is kept as long as its `TableData` lives and its version does not change.

    store = Store(context)
    texture = store.table(data, vec("f", 3))   # the device's copy, sent only when it has changed
    with store.lent() as lent:               # what is borrowed here goes back to the store afterwards
        source = lent.filled(array, 1024)
        target = lent.target([vec("f", 3), vec("i")], 1024, 8)
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np

from shpy.backends.base import Array, TableData
from shpy.backends.glsl.device.context import Context, check
from shpy.errors import ShpyError
from shpy.ir.types import Type

FOLD: Final = 4096
"""Texels in a row of a table: element i stands at (i % FOLD, i / FOLD)."""

KEPT_BYTES: Final = 256 << 20
"""How much a store keeps of what is not lent out."""

FORMATS: Final = {"f": "f4", "i": "i4", "u": "u4", "b": "u1"}
"""The components of a texture by the base of what it holds."""


@dataclass(frozen=True, slots=True)
class Target:
    """A framebuffer with one texture an output."""

    framebuffer: Any
    textures: tuple[Any, ...]
    bytes: int

    def release(self) -> None:
        """Give it back to GL."""
        self.framebuffer.release()
        for texture in self.textures:
            texture.release()


def shown_texture(texture: Any, check_thread: Callable[[], None]) -> Any:
    """Return a moderngl.Texture of the same memory for users, which calls `check_thread` whenever it uses GL."""
    given: Any = type(texture)
    cls = _shown_class(given)
    made = cls.__new__(cls)
    made.__dict__.update(texture.__dict__, check_thread=check_thread)
    return made


@cache
def _shown_class(texture: Any) -> Any:
    """Return the class: every method of moderngl's asks the texture for its object of GL, `mglo`."""

    class Texture(texture):  # type: ignore[misc]
        @property
        def mglo(self) -> Any:
            self.check_thread()
            return self.__dict__["mglo"]

        @mglo.setter
        def mglo(self, value: Any) -> None:  # when it is released
            self.__dict__["mglo"] = value

    return Texture


def as_texels(array: Array) -> Array:
    """Return the array as GL takes it: float16 as float32, bools as bytes; float64 is refused."""
    if array.dtype == np.float64:
        raise ShpyError("GLSL 3.30 has no f64")
    if array.dtype == np.float16:
        return array.astype(np.float32)
    return np.ascontiguousarray(array).view(np.uint8) if array.dtype == np.bool_ else np.ascontiguousarray(array)


def rounded(extent: int, limit: int) -> int:
    """Return the next power of two: textures of few sizes are found again more often."""
    return min(1 << max(extent - 1, 0).bit_length(), limit)


class Store:
    """The textures of one context. Everything here runs on the context's thread."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.tables: weakref.WeakKeyDictionary[TableData, tuple[Any, int]] = weakref.WeakKeyDictionary()
        self.uploads = 0
        """How many tables were sent so far."""
        self._free: dict[tuple[Any, ...], list[Any]] = {}
        self._kept = 0

    def table(self, data: TableData, type: Type) -> Any:
        """Return the texture that holds the table's elements in C order, folded."""
        known = self.tables.get(data)
        if known is not None and known[1] == data.version:
            return known[0]
        texels = as_texels(data.array).reshape(-1, type.size)
        if type.size == 3:  # texels of four components are read a third faster
            texels = np.pad(texels, ((0, 0), (0, 1)))
        if known is not None:
            texture = known[0]
        else:
            rows = -(-len(texels) // FOLD)
            texture = self._texture((min(len(texels), FOLD), rows), texels.shape[1], texels.dtype)
            weakref.finalize(data, self.context.doomed.append, texture).atexit = False
        write(texture, texels, texture.width)
        check(self.context.gl, "send a table")
        self.tables[data] = (texture, data.version)
        self.uploads += 1
        return texture

    def _texture(self, size: tuple[int, int], components: int, dtype: np.dtype[Any]) -> Any:
        limit = self.context.limits.width
        if max(size) > limit:
            raise ShpyError(f"a table of {size[0] * size[1]} elements: this device's textures hold {FOLD * limit}")
        texture = self.context.gl.texture(size, components, dtype=_format(dtype), alignment=1)
        check(self.context.gl, f"make a texture of {size[0]} x {size[1]}")
        nearest = self.context.moderngl.NEAREST
        texture.filter = (nearest, nearest)
        return texture

    @contextmanager
    def lent(self) -> Iterator[Lent]:
        """Lend what is borrowed through the result until the block ends."""
        lent = Lent(self)
        try:
            yield lent
        finally:
            self.context.resting.use()
            for key, thing, size in lent.things:
                self.give_back(key, thing, size)

    def take(self, key: tuple[Any, ...], size: int) -> Any | None:
        """Return a free thing of this kind, or None."""
        free = self._free.get(key)
        if not free:
            return None
        self._kept -= size
        return free.pop()

    def make_target(self, size: tuple[int, int], kinds: tuple[tuple[int, str], ...], cells: int) -> Target:
        """Return a framebuffer of this size with a texture of each kind, (components, format), `cells` bytes a cell."""
        gl = self.context.gl
        textures = []
        for components, dtype in kinds:
            textures.append(gl.texture(size, components, dtype=dtype, alignment=1))
            check(gl, f"make an output of {size[0]} x {size[1]}")
        framebuffer = gl.framebuffer(textures)
        check(gl, f"make a framebuffer of {len(kinds)} outputs")
        return Target(framebuffer, tuple(textures), size[0] * size[1] * cells)

    def give_back(self, key: tuple[Any, ...], thing: Any, size: int) -> None:
        """Keep a thing that nobody uses any longer, or release it where much is kept."""
        if self._kept + size > KEPT_BYTES:
            thing.release()
            return
        self._kept += size
        self._free.setdefault(key, []).append(thing)


class Lent:
    """What one run has borrowed."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self.things: list[tuple[tuple[Any, ...], Any, int]] = []

    def _borrow(self, key: tuple[Any, ...], size: int, make: Any) -> Any:
        thing = self.store.take(key, size) or make()
        self.things.append((key, thing, size))
        return thing

    def filled(self, array: Array, width: int) -> Any:
        """Return a texture with the elements of `array`, (n, components) or (n,), in rows of `width`."""
        texels = as_texels(array).reshape(len(array), -1)
        limit = self.store.context.limits.width
        size = (rounded(width, limit), rounded(-(-len(texels) // width), limit))
        components = texels.shape[1]
        key = ("texture", size, components, texels.dtype.str)
        texture = self._borrow(
            key,
            size[0] * size[1] * components * texels.itemsize,
            lambda: self.store._texture(size, components, texels.dtype),
        )
        write(texture, texels, width)
        check(self.store.context.gl, "send an input")
        return texture

    def target(self, types: list[Type], width: int, height: int) -> Target:
        """Return a framebuffer of at least `width` x `height` with an output of each type."""
        limit = self.store.context.limits.width
        size = (rounded(width, limit), rounded(height, limit))
        # Only one, two and four components must be renderable (OpenGL 3.3 section 3.8.1).
        kinds = tuple((4 if t.size == 3 else t.size, FORMATS[t.base.value]) for t in types)
        cells = sum(components * int(dtype[1]) for components, dtype in kinds)
        made: Target = self._borrow(
            ("target", size, kinds), size[0] * size[1] * cells, lambda: self.store.make_target(size, kinds, cells)
        )
        return made


def _format(dtype: np.dtype[Any]) -> str:
    return f"{dtype.kind}{dtype.itemsize}"


def write(texture: Any, texels: Array, width: int) -> None:
    """Put (n, components) texels into the first rows of `width`: the whole rows at once, then the rest."""
    rows, rest = divmod(len(texels), width)
    if rows:
        texture.write(texels[: rows * width], viewport=(0, 0, width, rows))
    if rest:
        texture.write(texels[rows * width :], viewport=(0, rows, rest, 1))


def read(target: Target, attachment: int, type: Type, out: Array, width: int, row: int = 0) -> None:
    """Fill `out`, (count, size) contiguous texels, with the elements of an output from a row on, bools as bytes."""
    rows, rest = divmod(len(out), width)
    for first, height, across in ((0, rows, width), (rows, min(rest, 1), rest)):
        if height:
            target.framebuffer.read_into(
                out[first * width : first * width + height * across],
                viewport=(0, row + first, across, height),
                components=type.size,
                attachment=attachment,
                alignment=1,
                dtype=FORMATS[type.base.value],
            )
