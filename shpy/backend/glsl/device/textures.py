"""Arrays as textures, and textures as arrays: what a full-screen pass reads and writes.

Stage: run. A flat array of elements becomes rows of a 2-D texture, 32-bit integers as integer textures, so that they
stay exact, bools as bytes, in one to four components. Textures and framebuffers come from a pool; the copy of a
table is kept as long as its `TableData` lives and its version does not change.

    store = Store(context)
    texture = store.table(data, vec("f", 3))   # the device's copy, sent only when it has changed
    kind, source = store.filled(array, (1, "f4"), 1024)
    store.pool.give_back(kind, source)
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any, Final

import numpy as np

from shpy.backend.base import Array
from shpy.backend.device.pool import Kind, Pool, rounded
from shpy.backend.glsl.device.context import Context, check
from shpy.backend.glsl.text.interface import FOLD
from shpy.errors import ShpyError
from shpy.ir.tabledata import TableData
from shpy.ir.types import Type

FORMATS: Final = {"f": "f4", "h": "f4", "i": "i4", "u": "u4", "b": "u1"}
"""The components of a texture by the base of what it holds."""

Form = tuple[int, str]
"""The number and the format of a texel's components."""


@dataclass(frozen=True, slots=True)
class Framebuffer:
    """A framebuffer with one texture an output."""

    framebuffer: Any
    textures: tuple[Any, ...]

    def release(self) -> None:
        """Give it back to GL."""
        self.framebuffer.release()
        for texture in self.textures:
            texture.release()


def shown_texture(texture: Any, check_thread: Callable[[], None]) -> Any:
    """Return a moderngl.Texture of the same memory for users, which calls `check_thread` whenever it uses GL."""
    base: Any = type(texture)
    cls = _shown_class(base)
    view = cls.__new__(cls)
    view.__dict__.update(texture.__dict__, check_thread=check_thread)
    return view


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
    code = array.dtype.char
    if code == "d":
        raise ShpyError("GLSL 3.30 has no f64")
    if code == "e":
        return array.astype(np.float32)
    return np.ascontiguousarray(array).view(np.uint8) if code == "?" else np.ascontiguousarray(array)


class Store:
    """The textures of one context. Everything here runs on the context's thread."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.tables: weakref.WeakKeyDictionary[TableData, tuple[Any, int]] = weakref.WeakKeyDictionary()
        self.uploads = 0
        """Return the number of tables that were sent so far."""
        self.pool = Pool(lambda thing: thing.release())

    def table(self, data: TableData, type: Type) -> Any:
        """Return the texture that holds the table's elements in C order, folded."""
        entry = self.tables.get(data)
        if entry is not None and entry[1] == data.version:
            return entry[0]
        if entry is not None:
            texture = entry[0]
            changed = data.changed_since(entry[1])
            for start, stop in [(0, len(data.array))] if changed is None else changed:
                _write_part(texture, data.array, type.size, start, stop)
        else:
            texels = _padded(data.array, type.size)
            rows = -(-len(texels) // FOLD)
            texture = self._texture((min(len(texels), FOLD), rows), (texels.shape[1], FORMATS[type.base.value]))
            weakref.finalize(data, self.context.doomed.append, texture).atexit = False
            write(texture, texels, texture.width)
        check(self.context.gl, "send a table")
        self.tables[data] = (texture, data.version)
        self.uploads += 1
        return texture

    def _texture(self, size: tuple[int, int], form: Form) -> Any:
        limit = self.context.limits.width
        if max(size) > limit:
            raise ShpyError(f"a table of {size[0] * size[1]} elements: this device's textures hold {FOLD * limit}")
        texture = self.context.gl.texture(size, form[0], dtype=form[1], alignment=1)
        check(self.context.gl, f"make a texture of {size[0]} x {size[1]}")
        nearest = self.context.moderngl.NEAREST
        texture.filter = (nearest, nearest)
        return texture

    def filled(self, array: Array, form: Form, width: int) -> tuple[Kind, Any]:
        """Take a texture and fill it with the elements of `array`, (n, components) or (n,), in rows of `width`."""
        texels = as_texels(array)
        kind, size = _kind(self.context.limits.width, width, -(-len(texels) // width), (form,), drawn=False)
        texture = self.pool.take(kind, lambda: self._texture(size, form))
        write(texture, texels, width)
        check(self.context.gl, "send an input")
        return kind, texture

    def target(self, forms: tuple[Form, ...], width: int, height: int) -> tuple[Kind, Framebuffer]:
        """Take a framebuffer of at least `width` x `height` with an output of each form."""
        kind, size = _kind(self.context.limits.width, width, height, forms, drawn=True)
        return kind, self.pool.take(kind, lambda: self._new_target(size, forms))

    def _new_target(self, size: tuple[int, int], forms: tuple[Form, ...]) -> Framebuffer:
        """Return a new framebuffer of this size with a texture of each form."""
        gl = self.context.gl
        textures = []
        for components, dtype in forms:
            textures.append(gl.texture(size, components, dtype=dtype, alignment=1))
            check(gl, f"make an output of {size[0]} x {size[1]}")
        framebuffer = gl.framebuffer(textures)
        check(gl, f"make a framebuffer of {len(forms)} outputs")
        return Framebuffer(framebuffer, tuple(textures))


def output_form(type: Type) -> Form:
    """Return the form of an output: only one, two and four components must be renderable (OpenGL 3.3 section 3.8.1)."""
    return 4 if type.size == 3 else type.size, FORMATS[type.base.value]


@lru_cache(maxsize=256)
def _kind(limit: int, width: int, height: int, forms: tuple[Form, ...], *, drawn: bool) -> tuple[Kind, tuple[int, int]]:
    """Return the kind of a texture, or of a framebuffer that is drawn to, and its size: one of few with enough room."""
    size = min(rounded(width), limit), min(rounded(height), limit)
    each = sum(components * int(format[1]) for components, format in forms)
    return Kind(size[0] * size[1] * each, (size, forms, drawn)), size


def write(texture: Any, texels: Array, width: int, row: int = 0) -> None:
    """Put (n, components) texels into rows of `width` from `row` on: the whole rows at once, then the rest."""
    rows, rest = divmod(len(texels), width)
    if rows:
        texture.write(texels[: rows * width], viewport=(0, row, width, rows))
    if rest:
        texture.write(texels[rows * width :], viewport=(0, row + rows, rest, 1))


def _write_part(texture: Any, array: Array, size: int, start: int, stop: int) -> None:
    """Put elements `start` to `stop` along the first axis of a table's array to their places, by whole rows."""
    each = array[0].size // size
    row = start * each // texture.width
    first = row * texture.width
    past = min(-(-stop * each // texture.width) * texture.width, len(array) * each)
    write(texture, _padded(array.reshape(-1, size)[first:past], size), texture.width, row)


def _padded(array: Array, size: int) -> Array:
    """Return elements of `size` components as texels (n, components): four for three, which are read a third faster."""
    texels = as_texels(array).reshape(-1, size)
    return np.pad(texels, ((0, 0), (0, 1))) if size == 3 else texels


def read(target: Framebuffer, attachment: int, type: Type, out: Array, width: int, row: int = 0) -> None:
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
