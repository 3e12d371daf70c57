"""Memory of a GL device: textures that stay there from run to run.

Stage: run. Element i of a stream stands at (i % FOLD, i / FOLD), as those of tables do, so a Table of a stream is read
where it is. OpenGL leaves open what a fragment reads from a texture that the draw writes, so an output is always
another texture than every input. All that touches GL runs on the context's thread.

    space = GlslSpace(store, collectives)
    memory = space.allocate(4, vec(Base.F, 3), np.dtype(np.float32))
    space.start([executable.ready(call)])
    memory.read()
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from shpy.backend.base import Array, Collectives, Counts
from shpy.backend.device.pool import Recent
from shpy.backend.glsl.device.context import VERTEX, Context, check
from shpy.backend.glsl.device.textures import (
    FORMATS,
    Framebuffer,
    Store,
    as_texels,
    output_form,
    read,
    shown_texture,
    write,
)
from shpy.backend.glsl.text.interface import FOLD
from shpy.backend.glsl.text.prologue import KINDS
from shpy.errors import ShpyError, ShpyTypeError
from shpy.ir.nodes import Status
from shpy.ir.types import Base, Type, vec

PROGRAMS: Final = 256
"""The most programs that the space keeps; the one used longest ago is dropped."""
DEPTHS: Final = 16
"""Sizes of which a depth buffer is kept. A run holds its own as an attachment of its framebuffer."""
_AHEAD: Final = 64
"""Draws that are started before the host waits for them."""
_BLOCK: Final = 32
"""Texels on each side of the square whose statuses one fragment counts."""

_KEEP: Final = """\
#version 330 core
// The elements of `new` that were written, and the others of `old`.
uniform KINDsampler2D new;
uniform KINDsampler2D old;
uniform isampler2D status;
uniform int has_status, has_old, new_width, old_width, width;
layout(location = 0) out KINDvec4 kept;

ivec2 at(int i, int width) {
    return ivec2(i % width, i / width);
}

void main() {
    int i = int(gl_FragCoord.y) * width + int(gl_FragCoord.x);
    if (has_status == 0 || texelFetch(status, at(i, width), 0).x == WRITTEN)
        kept = texelFetch(new, at(i, new_width), 0);
    else
        kept = has_old == 1 ? texelFetch(old, at(i, old_width), 0) : KINDvec4(0);
}
"""

_COUNT: Final = """\
#version 330 core
// Elements written, elements stopped in loops, and the least status of these, in a square of texels.
uniform isampler2D source;
uniform ivec2 size;
uniform int count, is_status;
layout(location = 0) out ivec4 counts;

void main() {
    ivec2 first = ivec2(gl_FragCoord.xy) * BLOCK;
    ivec2 last = min(first + BLOCK, size);
    counts = ivec4(0, 0, 2147483647, 0);
    for (int y = first.y; y < last.y; ++y)
        for (int x = first.x; x < last.x; ++x) {
            ivec4 found = texelFetch(source, ivec2(x, y), 0);
            if (is_status == 1) {
                int s = found.x;
                bool limited = s >= FIRST_LOOP, here = y * size.x + x < count;
                found = ivec4(s == WRITTEN, limited || s == DEVICE_STOPPED, limited ? s : 2147483647, 0);
                if (!here)
                    found = ivec4(0, 0, 2147483647, 0);
            }
            counts = ivec4(counts.xy + found.xy, min(counts.z, found.z), 0);
        }
}
"""


@dataclass(slots=True, eq=False, weakref_slot=True)
class GlslMemory:
    """A texture with `count` elements in rows of `width`: see `base.Memory`."""

    space: GlslSpace
    target: Framebuffer
    width: int
    count: int
    type: Type
    dtype: np.dtype[Any]
    loan: Any = None
    """The loan by which the texture returns to the pool; None for a texture that the user made."""
    shown: Any = None
    """The texture that users get."""

    @property
    def texture(self) -> Any:
        """The texture, of one, two or four components: vectors of three have one more."""
        return self.target.textures[0]

    @property
    def native(self) -> Any:
        """A moderngl.Texture, which is released with its last holder; only the context's thread may use it."""
        if self.loan is None:  # the user owns the texture
            return self.texture
        if self.shown is None:
            self.space.call(self._show)
        return self.shown

    def _show(self) -> None:
        """Take the texture out of the pool for good, since the user now holds it."""
        if self.shown is None and self.loan.detach():
            doomed = self.space._context.doomed
            self.shown = shown_texture(self.texture, self.space.check_thread)
            weakref.finalize(self, doomed.append, self.target.framebuffer).atexit = False
            weakref.finalize(self.shown, doomed.append, self.texture.mglo).atexit = False

    @property
    def extent(self) -> tuple[Any, int, int]:
        """The texture: on this target memory is always a whole texture."""
        return self.texture.glo, 0, self.count

    @property
    def height(self) -> int:
        """The rows that hold elements."""
        return -(-self.count // self.width)

    def write(self, array: Array) -> None:
        """Copy a host array to the device."""
        if self.count:
            texels = as_texels(array).reshape(self.count, -1)
            if self.type.size == 3:
                texels = np.pad(texels, ((0, 0), (0, 1)))
            self.space.call(lambda: write(self.texture, texels, self.width))

    def read(self, begin: int = 0, end: int | None = None) -> Array:
        """Copy the elements to the host: from the row in which the first of them lies."""
        row, skipped = divmod(begin, self.width)
        count = (self.count if end is None else end) - row * self.width
        elements = np.empty((count, self.type.size), FORMATS[self.type.base.value])
        if len(elements) > skipped:
            self.space.call(lambda: read(self.target, 0, self.type, elements, self.width, row))
        numbers = elements[skipped:] if self.type.size > 1 else elements[skipped:, 0]
        return numbers.astype(self.dtype, copy=False)


class GlslSpace:
    """The memory of one device: see `base.Space`."""

    overwrites = False
    on_host = False

    def __init__(self, store: Store, collectives: Callable[[GlslSpace, Context], Collectives]) -> None:
        """Take textures from a store; `collectives` makes the operations that the device does itself."""
        self._store = store
        self._context = store.context
        self.collectives = collectives(self, self._context)
        self._programs = Recent[tuple[str, str], tuple[Any, Any]](PROGRAMS, _release_all)
        self._depths = Recent[tuple[int, int], Any](DEPTHS, lambda depth: depth.release())
        self._started = 0

    @property
    def flushes(self) -> bool:
        """Return whether the device takes denormals of binary32 for zeros."""
        return not self._context.limits.keeps_denormals

    def call(self, job: Callable[[], Any]) -> Any:
        """Run a job on the context's thread."""
        return self._context.call(job)

    def on_device(self, function: Callable[..., Any], natives: list[Any]) -> Any:
        """Call a function with textures on the context's thread, and restore the GL state that it changes."""
        context = self._context

        def job() -> Any:
            try:
                return function(*natives)
            finally:
                context.restore()

        return context.call(job)

    def check_thread(self) -> None:
        """Raise ShpyTypeError on another thread than the context's: GL would read or change another context."""
        if not self._context.is_here():
            raise ShpyTypeError(
                "a texture of a stream belongs to the thread of shpy's GL context, and this is another thread",
                cure="stream.on_device(lambda texture: texture.read())",
            )

    def allocate(self, count: int, type: Type, dtype: np.dtype[Any]) -> GlslMemory:
        """Return a texture for `count` elements, not initialised; ShpyError if the device has no texture that large."""
        if dtype == np.float64:
            raise ShpyTypeError("GLSL 3.30 has no f64", cure='precision="f32", or another backend')
        limit = self._context.limits.width
        width = min(max(count, 1), FOLD, limit)
        height = max(1, -(-count // width))
        if height > limit:
            raise ShpyError(
                f"a stream of {count:,} elements: the textures of this device hold {width * limit:,}",
                cure="several streams, or another backend",
            )
        memory: GlslMemory = self.call(lambda: self._take(width, height, count, type, dtype))
        return memory

    def _take(self, width: int, height: int, count: int, type: Type, dtype: np.dtype[Any]) -> GlslMemory:
        kind, target = self._store.target((output_form(type),), width, height)
        memory = GlslMemory(self, target, width, count, type, dtype)
        memory.loan = self._store.pool.lend(kind, target)
        return memory

    def owns(self, native: Any) -> bool:
        """Return whether a moderngl.Texture belongs to this context."""
        return getattr(native, "ctx", None) is self._context.gl

    def wrap(self, native: Any, type: Type, dtype: np.dtype[Any]) -> GlslMemory:
        """Return a texture of this context, of one, two or four components of 32 bits."""
        context = self._context
        if not self.owns(native):
            raise ShpyTypeError(
                "this texture belongs to another context",
                cure="a texture of stream.native().ctx, or sh.Stream(array, type)",
            )
        expected = FORMATS[type.base.value]
        if native.dtype != expected or native.components != type.size or type.size == 3:
            raise ShpyTypeError(f"a stream of {type!r} takes a texture of {type.size} components {expected!r}")
        width, height = native.size
        target = self.call(lambda: Framebuffer(context.gl.framebuffer([native]), (native,)))
        return GlslMemory(self, target, width, width * height, type, dtype)

    def view(self, memory: GlslMemory, type: Type, count: int) -> None:
        """Return None: a texel has as many components as an element."""
        return

    def copy(self, source: GlslMemory, target: GlslMemory) -> None:
        """Copy all elements."""
        if source.count:
            self.call(lambda: self._merge(None, source, None, target))

    def merge(self, status: GlslMemory, new: GlslMemory, old: GlslMemory | None) -> GlslMemory:
        """Other memory with the elements of `new` where the status is WRITTEN, else of `old`, or zeros."""
        kept = self.allocate(new.count, new.type, new.dtype)
        if new.count:
            self.call(lambda: self._merge(status, new, old, kept))
        return kept

    def depth(self, size: tuple[int, int]) -> Any:
        """Return the depth buffer of a size. Every run that tests depths writes them first, so all runs share it."""
        return self._depths.get(size, lambda: self._context.gl.depth_renderbuffer(size))

    def folded(self, memory: GlslMemory) -> GlslMemory:
        """Return the memory itself, or a copy in rows of FOLD where its rows have another length."""
        if memory.width in (FOLD, memory.count) and memory.width <= FOLD:
            return memory
        duplicate = self.allocate(memory.count, memory.type, memory.dtype)
        self.copy(memory, duplicate)
        return duplicate

    def _merge(self, status: GlslMemory | None, new: GlslMemory, old: GlslMemory | None, kept: GlslMemory) -> None:
        text = _KEEP.replace("KIND", KINDS[new.type.base]).replace("WRITTEN", str(Status.WRITTEN))
        sources = {"new": new, "old": old or new, "status": status}
        numbers = {
            "has_status": int(status is not None),
            "has_old": int(old is not None),
            "new_width": new.width,
            "old_width": (old or new).width,
            "width": kept.width,
        }
        self.draw(text, sources, numbers, kept, (kept.width, kept.height))

    def count(self, status: GlslMemory) -> Counts:
        """Count the statuses."""
        if not status.count:
            return Counts(0)
        counts: Counts = self.call(lambda: self._count(status))
        return counts

    def _count(self, status: GlslMemory) -> Counts:
        text = _COUNT.replace("BLOCK", str(_BLOCK))
        for name in ("WRITTEN", "FIRST_LOOP", "DEVICE_STOPPED"):
            text = text.replace(name, str(getattr(Status, name)))
        source, size = status, (status.width, status.height)
        while True:
            blocks = (-(-size[0] // _BLOCK), -(-size[1] // _BLOCK))
            counts = self._take(*blocks, blocks[0] * blocks[1], vec(Base.I, 4), np.dtype(np.int32))
            numbers = {"size": size, "count": status.count, "is_status": int(source is status)}
            self.draw(text, {"source": source}, numbers, counts, blocks)
            if blocks == (1, 1):
                break
            source, size = counts, blocks
        out = np.empty((1, 4), np.int32)
        read(counts.target, 0, counts.type, out, 1)
        written, stopped, first, _ = map(int, out[0])
        return Counts(written, stopped, first if first < 2**31 - 1 else 0)

    def draw(
        self,
        text: str,
        sources: Mapping[str, GlslMemory | None],
        numbers: Mapping[str, Any],
        to: GlslMemory,
        size: tuple[int, int],
        points: tuple[str, int] | None = None,
    ) -> None:
        """Run a shader over the cells of a memory, or over a number of points, which a vertex shader places there.

        It has to be called on the context's thread.
        """
        gl, moderngl = self._context.gl, self._context.moderngl
        vertex, count = points or (VERTEX, 3)

        def make() -> tuple[Any, Any]:
            program = self._context.program(text, vertex)
            return program, gl.vertex_array(program, [])

        program, vertices = self._programs.get((vertex, text), make)
        for unit, (name, memory) in enumerate(sources.items()):
            if name in program:
                program[name].value = unit
                if memory is not None:
                    memory.texture.use(unit)
        for name, number in numbers.items():
            if name in program:
                program[name].value = number
        to.target.framebuffer.use()
        gl.viewport = (0, 0, *size)
        vertices.render(moderngl.POINTS if points else moderngl.TRIANGLES, count)
        self._context.resting.use()
        check(gl, "move or count elements")

    def start(self, runs: Iterable[Callable[[], None]]) -> None:
        """Start one after the other, all on the context's thread."""
        self.call(lambda: self._start(runs))

    def _start(self, runs: Iterable[Callable[[], None]]) -> None:
        for run in runs:
            run()
            self._started += 1
            if self._started % _AHEAD == 0:
                self._context.gl.finish()
                self._context.go_on()
        self._context.resting.use()
        check(self._context.gl, "run the program")

    def finish(self) -> None:
        """Wait until everything that was started has ended."""
        self.call(self._context.gl.finish)


def _release_all(things: tuple[Any, ...]) -> None:
    for thing in things:
        thing.release()


def own(memory: Any) -> GlslMemory:
    """Return the memory, which is one of this backend."""
    assert isinstance(memory, GlslMemory)
    return memory
