"""Builds shaders and runs them: a draw for a band of elements, textures in, framebuffer out.

Stage: compile, run. n elements fill a texture row by row, a row being the last axis where that has a fair length, so
that elements that are near lie near. What takes long is drawn in several strips (see `pace`), more than `BAND` elements
with several framebuffers; more outputs than the device has draw buffers take several programs, each of which computes
its share of the outputs anew.
"""

from __future__ import annotations

import math
import re
import weakref
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from shpy.backend.base import Array, Call, DeviceCall, TableMemory
from shpy.backend.device.pace import Pace
from shpy.backend.device.pool import Kind
from shpy.backend.glsl.device.collective import collectives
from shpy.backend.glsl.device.context import Context, check
from shpy.backend.glsl.device.memory import GlslMemory, GlslSpace, own
from shpy.backend.glsl.device.textures import FORMATS, Form, Framebuffer, Store, output_form, read
from shpy.backend.glsl.text.interface import FIRST, FOLD, GRID_SHAPE, LAST, RUNNING, WIDTH, Shader, TableTexture
from shpy.errors import CompileError
from shpy.ir.nodes import Loc, Status
from shpy.ir.tabledata import TableData
from shpy.ir.types import Base, Type, vec

Inputs = dict[int, tuple[Any, bool]]
"""The textures of inputs by index, each with whether it has a texel for each element."""

BAND: Final = 1 << 22
"""Elements that are on the device at a time, at most."""

_ROW: Final = 1024
_ERROR: Final = re.compile(r"^(?:ERROR: )?0[:(](\d+)(?:\(\d+\)|\))?\s*:\s*(?:error\b)?[\s:]*(.*)$", re.MULTILINE)
_USER_LINE: Final = re.compile(r"// (.+):(\d+)$")


@dataclass(slots=True, weakref_slot=True, eq=False)
class Program:
    """A linked program with its shader, the draw that runs it, and the texture unit of each sampler that it reads.

    `forms` has those of the outputs, `uniforms` those that the driver has kept, and `values` the last ones that were
    set. `pace` is how much of a call one draw does.
    """

    shader: Shader
    forms: tuple[Form, ...]
    uniforms: dict[str, Any]
    vertices: Any
    units: dict[str, int]
    pace: Pace
    values: dict[str, Any] = field(default_factory=dict)

    def set(self, name: str, value: Any) -> None:
        """Set a uniform, if the driver has kept it and it has another value."""
        if name in self.uniforms and self.values.get(name) != value:
            self.uniforms[name].value = value
            self.values[name] = value


class Runtime:
    """The objects that one context keeps: programs by their text, textures and tables."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.store = Store(context)
        self.space = GlslSpace(self.store, collectives)
        self._programs: weakref.WeakValueDictionary[tuple[Any, ...], Program] = weakref.WeakValueDictionary()

    def build(self, shader: Shader, loc: Loc | None, *, steady: bool = True) -> Program:
        """Return the program of this text; CompileError if the device refuses it, or it reads too many textures.

        `steady`: no data makes an element take more than a few thousand iterations.
        """
        # Two texts may be the same where the names behind them, by which data come, are not.
        key = (shader.source, shader.inputs, shader.tables, *shader.params.items())
        return self._programs.get(key) or self.context.call(lambda: self._linked(key, shader, loc, steady))

    def _linked(self, key: tuple[Any, ...], shader: Shader, loc: Loc | None, steady: bool) -> Program:
        result = self._programs.get(key)
        if result is not None:  # another thread has linked it since
            return result
        samplers = [i.sampler for i in shader.inputs] + [t.sampler for t in shader.tables]
        limit = self.context.limits.textures
        try:
            program = self.context.program(shader.source)
        except self.context.moderngl.Error as e:
            if len(samplers) > limit:
                raise _too_many(len(samplers), limit, loc) from e
            raise refused(shader.source, str(e), loc) from e
        uniforms = {name: program[name] for name in program}
        units = {sampler: unit for unit, sampler in enumerate(s for s in samplers if s in uniforms)}
        if len(units) > limit:  # some drivers link such a program nevertheless
            program.release()
            raise _too_many(len(units), limit, loc)
        vertices = self.context.gl.vertex_array(program, [])
        check(self.context.gl, "prepare a program")
        for sampler, unit in units.items():
            uniforms[sampler].value = unit
        forms, pace = tuple(map(output_form, shader.outputs)), Pace(steady=steady, bounded=steady)
        result = self._programs[key] = Program(shader, forms, uniforms, vertices, units, pace)
        doomed = self.context.doomed
        weakref.finalize(result, lambda: doomed.extend((program, vertices))).atexit = False
        return result

    def run(self, programs: tuple[Program, ...], groups: tuple[tuple[int, ...], ...], call: Call) -> Array | None:
        """Run `programs`, whose outputs are those of `groups`, over all elements; return the status if one is made.

        The status is the output after the last of `call.outputs`. It has to be called on the context's thread.
        """
        last, count = len(call.outputs), call.count
        # The program that makes the status comes first: the others' outputs are written where it says so.
        draws = sorted(zip(programs, groups, strict=True), key=lambda draw: last not in draw[1])
        status = np.ones(count, np.int32) if last in draws[0][1] else None
        width = row_length(call.shape, self.context.limits.width)
        band = max(1, min(self.context.limits.width, BAND // width)) * width
        for first in range(0, count, band):
            part = slice(first, min(first + band, count))
            lent: list[tuple[Kind, Any]] = []
            inputs: Inputs = {}
            try:
                for program, group in draws:
                    target = self._draw(program, call, part, width, lent, inputs)
                    _collect(target, program.shader.outputs, group, call, status, part, width)
            finally:
                self.context.resting.use()
                for kind, thing in lent:
                    self.store.pool.give_back(kind, thing)
            check(self.context.gl, "run the program")
        return status

    def _draw(
        self, program: Program, call: Call, part: slice, width: int, lent: list[tuple[Kind, Any]], inputs: Inputs
    ) -> Framebuffer:
        shader, count = program.shader, part.stop - part.start
        kind, target = self.store.target(program.forms, width, -(-count // width))
        lent.append((kind, target))
        for port in shader.inputs:
            if port.sampler in program.units and port.index not in inputs:
                array, form = call.inputs[port.index], (port.type.size, FORMATS[port.type.base.value])
                alone = len(array) == 1
                lent.append(self.store.filled(array if alone else array[part], form, 1 if alone else width))
                inputs[port.index] = lent[-1][1], not alone
        self.bind(program, call, inputs)
        target.framebuffer.use()
        self.render(program, call.shape, part.start, count, width, reads=True)
        return target

    def render(
        self, program: Program, shape: tuple[int, ...], start: int, count: int, width: int, *, reads: bool
    ) -> None:
        """Run the cells of `count` elements, of which the first is `start`, in rows of `width`: see `Pace.driver`."""
        program.set(FIRST, start)
        program.set(WIDTH, width)
        program.set(GRID_SHAPE, (*shape, 1, 1, 1, 1)[:4])
        program.set(RUNNING, True)
        rows, rest = divmod(count, width)

        def draw(first: int, height: int) -> None:
            full = min(height, rows - first)
            if full:
                self._dispatch(program, width, first, full)
            if full < height:
                self._dispatch(program, rest, rows, 1)

        program.pace.driver(-(-count // width), draw, lambda _: self.context.gl.finish(), width, reads=reads)()

    def _dispatch(self, program: Program, across: int, first: int, height: int) -> None:
        """Run some rows."""
        self.context.go_on()
        program.set(LAST, (across - 1, first + height - 1))
        self.context.gl.viewport = (0, first, across, height)
        program.vertices.render(self.context.moderngl.TRIANGLES, 3)

    def bind(self, program: Program, call: Call | DeviceCall, inputs: Inputs) -> None:
        """Let a program read the inputs, tables and params of a call."""
        for port in program.shader.inputs:
            if port.sampler in program.units:
                texture, each = inputs[port.index]
                texture.use(program.units[port.sampler])
                program.set(port.each, int(each))
        for table in program.shader.tables:
            self._bind_table(program, table, call.tables[table.name])
        for name, (uniform, type) in program.shader.params.items():
            if uniform in program.uniforms:
                program.uniforms[uniform].write(uniform_bytes(call.params[name], type))

    def _bind_table(self, program: Program, table: TableTexture, data: TableData | TableMemory) -> None:
        """Let a sampler read a table, and tell the program its shape, for which it may ask without reading it."""
        if isinstance(data, TableMemory):
            shape, texture = data.shape, own(data.memory).texture
        else:
            shape = data.array.shape if table.type.size == 1 else data.array.shape[:-1]
            texture = self.store.table(data, table.type) if table.sampler in program.units else None
        if table.sampler in program.units:
            texture.use(program.units[table.sampler])
        program.set(table.shape, shape if len(shape) > 1 else shape[0])


class DeviceRun:
    """A run over textures, made and started on the context's thread; `programs` make the outputs of `groups`.

    Where a program discards elements at the start, a first draw of `rejection` computes which and writes that as a
    depth. The depth test then keeps their fragments from running: early-z culling (Christen 2005, chapter 4).
    """

    def __init__(
        self,
        runtime: Runtime,
        programs: tuple[Program, ...],
        groups: tuple[tuple[int, ...], ...],
        call: DeviceCall,
        rejection: Program | None,
    ) -> None:
        self._runtime = runtime
        context = runtime.context
        outputs = [own(m) for m in (*call.outputs, call.status) if m is not None]
        self._count = math.prod(call.shape)
        self._width = min(self._count, FOLD, context.limits.width)
        draws = list(zip(programs, groups, strict=True))
        depth = None
        if rejection is not None and call.status is not None:
            depth = runtime.space.depth(outputs[-1].texture.size)
            draws.insert(0, (rejection, (len(outputs) - 1,)))
        self._draws = [
            (program, context.gl.framebuffer([outputs[k].texture for k in group], depth)) for program, group in draws
        ]
        for _, framebuffer in self._draws[1:]:
            framebuffer.depth_mask = False
        self._rejects = depth is not None
        check(context.gl, "make a framebuffer")
        framebuffers = [framebuffer for _, framebuffer in self._draws]
        weakref.finalize(self, context.doomed.extend, framebuffers).atexit = False
        self._refolded: list[tuple[GlslMemory, GlslMemory]] = []
        inputs = [self._folded(own(m)) for m in call.inputs]
        self._inputs = {k: (memory.texture, memory.count == self._count) for k, memory in enumerate(inputs)}
        tables: dict[str, TableData | TableMemory] = {
            name: TableMemory(self._folded(own(data.memory)), data.shape) if isinstance(data, TableMemory) else data
            for name, data in call.tables.items()
        }
        self._call = replace(call, tables=tables)

    def _folded(self, memory: GlslMemory) -> GlslMemory:
        """Memory in rows of FOLD with the elements of this one, which are copied before each run if need be."""
        folded = self._runtime.space.folded(memory)
        if folded is not memory:
            self._refolded.append((memory, folded))
        return folded

    def __call__(self) -> None:
        """Start it."""
        call, runtime = self._call, self._runtime
        for source, folded in self._refolded:
            runtime.space.copy(source, folded)
        gl = runtime.context.gl
        if self._rejects:
            gl.enable(runtime.context.moderngl.DEPTH_TEST)
        for number, (program, framebuffer) in enumerate(self._draws):
            if self._rejects:
                gl.depth_func = "<" if number else "1"
            runtime.bind(program, call, self._inputs)
            framebuffer.use()
            runtime.render(program, call.shape, 0, self._count, self._width, reads=False)
        if self._rejects:
            gl.disable(runtime.context.moderngl.DEPTH_TEST)


def row_length(shape: tuple[int, ...], limit: int) -> int:
    """Return the number of elements in a row of the texture."""
    if len(shape) > 1 and 64 <= shape[-1] <= limit:
        return shape[-1]
    return min(math.prod(shape), _ROW)


def uniform_bytes(value: Array, type: Type) -> bytes:
    """Return a param as GL takes it: floats as binary32, bools as ints."""
    dtype: Any = {Base.F: np.float32, Base.U: np.uint32}.get(type.base, np.int32)
    return np.ascontiguousarray(value).astype(dtype).tobytes()


def _collect(
    target: Framebuffer,
    types: tuple[Type, ...],
    group: tuple[int, ...],
    call: Call,
    status: Array | None,
    part: slice,
    width: int,
) -> None:
    """Read a framebuffer into the call's outputs, the status first."""
    if status is not None and len(call.outputs) in group:
        read(target, group.index(len(call.outputs)), vec(Base.I), status[part].reshape(-1, 1), width)
    written = None if status is None else status[part] == Status.WRITTEN
    for attachment, (output, type) in enumerate(zip(group, types, strict=True)):
        if output == len(call.outputs):
            continue
        out = call.outputs[output][part].reshape(-1, type.size)
        dtype = np.dtype(FORMATS[type.base.value])
        view = out.view(np.uint8) if out.dtype.char == "?" else out
        if written is None and view.dtype is dtype:
            read(target, attachment, type, view, width)
            continue
        values = np.empty(out.shape, dtype)
        read(target, attachment, type, values, width)
        np.copyto(view, values, casting="same_kind", where=True if written is None else written[:, None])


def _too_many(textures: int, limit: int, loc: Loc | None) -> CompileError:
    return CompileError(f"{textures} inputs and tables: a program of this device reads {limit} at most", loc=loc)


def refused(source: str, log: str, loc: Loc | None) -> CompileError:
    """Return the driver's log as an error, at the user's line where the text's comments give it."""
    match = _ERROR.search(log)
    if match is None:
        return CompileError(f"the driver refused the shader:\n{log.strip()}", loc=loc)
    lines = source.splitlines()
    at = int(match[1])
    for line in reversed(lines[:at]):
        user = _USER_LINE.search(line)
        if user is not None:
            loc = Loc(user[1], int(user[2]))
            break
    text = lines[at - 1].strip() if 0 < at <= len(lines) else ""
    return CompileError(f"the driver refused this line of the shader: {match[2].strip()}\n  {at}: {text}", loc=loc)
