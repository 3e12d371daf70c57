"""The OpenCL backend: prepares, prints and builds a module, and chooses the packets and the work group of its kernel.

Stage: compile. A value of a packet lies in one or several vector registers of the processor. In several, operations do
not wait for each other; in too many, values leave the registers. A processor's driver puts the local arrays of a group
on a thread's stack: over the bound packets become narrower first, then groups smaller. A kernel of which not even one
work item fits is refused before the driver sees it, since the driver would build it, and end the process in a later
run. `run` runs the kernel.

PoCL takes half the time for a large program that it does not optimize, with the same bits. So it does not at first, and
once the runs, of earlier processes too, have taken as long as an optimized build does, that follows: a first picture is
there sooner. Bits may differ in relaxed and fast mode, which are optimized at once, as are texts that an earlier
process optimized.

    executable = backend.compile(module, Options())
    status = executable.run(call)
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

from shpy.backend.base import Device, Executable, Options
from shpy.backend.device import store
from shpy.backend.device.once import once
from shpy.backend.device.pace import QUARTERS, SECONDS, Pace, Watch
from shpy.backend.device.probe import EMULATED, emulates_fma, refuse_wrong, uncorrected
from shpy.backend.opencl.device.collective import collectives
from shpy.backend.opencl.device.compiler_trials import thread_stack
from shpy.backend.opencl.device.driver import LOCAL_SIZE, Machine, devices, machine_of
from shpy.backend.opencl.device.memory import OpenCLSpace
from shpy.backend.opencl.device.run import OpenCLExecutable
from shpy.backend.opencl.packets.kernel import print_packets
from shpy.backend.opencl.packets.widen import WIDER, WIDTHS
from shpy.backend.opencl.text.kernel import KernelText, print_kernel
from shpy.backend.opencl.text.operations import ELEMENTWISE
from shpy.backend.slow import announced
from shpy.errors import CompileError, ShpyTypeError, warn
from shpy.ir.nodes import Function, Let, Loc, Loop, Module, Store
from shpy.ir.traverse import variables_of, walk
from shpy.passes.exits import few_turns
from shpy.passes.library import SELDOM
from shpy.passes.modes import REPRODUCIBLE, Precision
from shpy.passes.pipeline import PreparedModule, prepare
from shpy.passes.private import check_private, private_memory
from shpy.passes.size import check_growth, check_size

_CPU_SECONDS = 0.5
"""The intended seconds of a dispatch on a CPU, which has no watchdog: long dispatches keep its cores busy, and only
Ctrl-C has to wait for their end."""
_PACKETS: Final = 16
"""Packets of a group; fewer than LOCAL_SIZE, since a packet computes several elements."""
_LINES: Final = 4
"""Work items of a group where each computes the packets of a line: 64 take 1.0 to 1.15 of the time."""
_MOST_STATEMENTS: Final = 1 << 26
"""The most statements with all calls expanded. PoCL visits every path of calls, so its time doubles with each level."""
_FLUSHED: Final = "in {} mode this device flushes denormals to zero"
"""The note for a driver that does not promise denormals: its functions flush them, even if its products do not."""
_GROUPED: Final = "local arrays of {:,} bytes: groups of {}, not {}"
_LANES_OF_AVX512: Final = 16
_REGISTERS: Final = 32
"""The vector registers that the numbers which a loop carries may fill; half as many where registers are shorter.

CPU milliseconds at 16, 32 and 64 lanes on AVX-512, whose registers hold 16 (PoCL 3.1, least of 8 rounds in
alternation): a polynomial, which has no loop, 7.4, 5.7, 4.2, and a shader 18.9, 14.6, 11.6; mandelbrot, whose loop
carries 5 numbers, 20.7, 16.3, 15.8; spheres, with 14 numbers, 11.7, 11.9, 13.3. At 16 and 32 lanes, pictures whose
loops carry 56 numbers and more: `mixed` 68 and 91, `glass` 169 and 180, `cornell`, path traced, 97 and 104.
On AVX2, which has 16 registers, mandelbrot takes 23.8 at 16 lanes and 26.5 at 32, and spheres 26.4 at 8 and 28.3 at 16.
"""
_MOST_EACH: Final = 4
"""The most registers of a value."""
_MOST_OF_LARGE: Final = 2
"""The most registers of a value in a program that gathers or has more than `_LARGE` statements.

Wider packets take 1.6 times as long to compile. As above: primary rays 22.4, 21.5, 23.9.
"""
_NEIGHBOURS: Final = 32
"""The numbers of binary32 in a packet where neighbours in a grid are read, if these are at most `_MOST_EACH` registers.

As above: blur 6.3, 5.0, 5.2; Gray-Scott of 256 columns, of whose packets of 64 half stand at a border, 44.9, 41.2,
44.2; the game of life and Jacobi's iteration take as long at 64 as at 32 (1.00 and 0.98). On AVX2, whose registers hold
8, packets of 32 take the part of those of 16: Jacobi 0.71, life 0.80, blur 0.94, Gray-Scott 1.01.
"""
_LARGE: Final = 400
"""The most statements of a program whose packets may be as wide as `_MOST_EACH` allows, without those that run seldom.

Above it, packets of 64 take .88 (voronoi, 544 statements), 1.00 (contours, 429) and 1.16 (bumps, 1,966) of the time of
those of 32 on AVX-512, and 1.5 to 1.6 of the time to compile. A shader in relaxed mode, with 283 and the 205 of a far
angle, takes .72.
"""
_GATHERED: Final = 16
"""The least reads from Tables, at places of its own, for which a program without a loop gathers.

Each lane reads by itself, so wider packets save little. At 16, 32 and 64 lanes, along an axis of 1,024 x 1,024 on a
busy machine, `any` takes 0.6, 1.1 and 2.5 s of CPU to compile, and then 5.9, 5.5 and 5.3 ms a call; sums take 3.7, 2.9
and 2.8 ms. On another such processor the calls at 64 took twice those at 16.
"""
LARGE: Final = 800
"""Statements of a prepared program from which on its first build is not optimized.

CPU seconds of PoCL 3.1, optimized and not, and CPU milliseconds of a picture of 64 x 48 (a busy machine, least of 2 to
5 rounds): boxes (1,105 statements) 0.68 and 0.35, 1.9 and 2.8; path-traced `mixed` (2,218) 1.10 and 0.48, four samples
27 and 52. Small programs gain less and lose more: a shader runs for 16 and 107 ms. `python -m benchmarks --only
starting` prints a start with both.
"""
_EACH: Final = 4.5e-4
"""Seconds that an optimized build takes for each of these statements."""
_FRAME: Final = (8192, 16)
"""Bytes on a thread's stack of what is not optimized: for each lane, and for each statement and lane.

Path-traced `glass` (2,506 statements, 16 lanes) has 257 kB, a shader of 64 lanes 260 kB: a third of these bounds.
"""
_OPTIMIZED: Final = "texts that the driver optimized"
"""The list of the texts whose optimized code the driver is expected to have in its own files."""
_SPENT: Final = "quarters that were spent on texts which the driver did not optimize"


class OpenCLBackend:
    """OpenCL devices as a backend; see `base.Backend`."""

    name = "opencl"

    def devices(self) -> list[Device]:
        """Return every OpenCL device; BackendUnavailable, with the command that mends it, when there is none."""
        return devices()

    def compile(self, module: Module, options: Options) -> Executable:
        """Prepare, print, build, and have the driver generate its code; CompileError naming the user's line.

        `lanes="auto"` follows from the form of the program on a CPU (see `widths_of`), and is 1 on a GPU or for a
        program that no packet can run, which is a ShpyWarning with the cause.
        """
        machine = machine_of(options.device)
        lanes = machine.lanes if options.lanes == "auto" else options.lanes
        if lanes not in (1, *WIDTHS, *WIDER):
            raise ShpyTypeError(f"lanes={lanes!r}", cure=f'lanes="auto", 1, {", ".join(map(str, (*WIDTHS, *WIDER)))}')
        if lanes > 1 and lanes not in machine.widths:
            name = machine.device.name.strip()
            cure = f'lanes="auto", or {max((1, *machine.widths))}'
            raise CompileError(f"{name} has no vectors of {lanes}", loc=module.entry.loc, cure=cure)
        try:
            return _built(machine, module, options, lanes)
        except CompileError as e:
            if options.lanes != "auto" or lanes == 1:
                raise
            single = _built(machine, module, options, 1)
            remark = f"one element at a time, not {lanes}: {e.message}"
            warn(f"{module.entry.loc}: {module.name} is slower on OpenCL, {remark}")
            return replace(single, remarks=(*single.remarks, remark))

    def faults(self, device: int | None) -> frozenset[str]:
        """Return the faults of a device by which its bits in strict mode may differ from numpy's."""
        return uncorrected(machine_of(device).wrong)

    def space(self, device: int | None) -> OpenCLSpace:
        """Return the memory of a device."""
        return _space_of(device or 0)


@once
def _space_of(index: int) -> OpenCLSpace:
    return OpenCLSpace(machine_of(index), collectives)


def _built(machine: Machine, module: Module, options: Options, lanes: int) -> OpenCLExecutable:
    prepared = prepare(module, options, machine.target(lanes, options.math))
    check_size(prepared.module, "OpenCL's compiler")
    check_growth(prepared.module, _MOST_STATEMENTS, "OpenCL's compiler follows every call of every call")
    if options.math in REPRODUCIBLE:
        refuse_wrong(prepared.module, machine.wrong, machine.device.name.strip())
    kernel = _printed(machine, prepared, options, lanes)
    if kernel.doubles and not machine.doubles:
        raise CompileError(
            f"{machine.device.name.strip()} has no f64",
            loc=prepared.module.entry.loc,
            cure='precision="f32", or backend="numpy"',
            lacks="f64",
        )
    group, whole = group_of(machine, kernel)
    remarks = () if options.math in REPRODUCIBLE or machine.denormals else (_FLUSHED.format(options.math),)
    if options.fuse and emulates_fma(machine.wrong, options.precision):
        remarks = (*remarks, EMULATED)
    if group < whole:
        remarks = (*remarks, _GROUPED.format(kernel.private.size, group, whole))
    worth = _worth(machine, prepared.module, kernel, options)
    seconds, bounded = _CPU_SECONDS if machine.is_cpu else SECONDS, few_turns(prepared.module)
    pace = Pace(seconds, bounded=bounded)
    if worth is not None:
        name = machine.key(kernel.text, machine.options(options.math))
        pace = Watch(seconds, bounded=bounded, worth=worth, quarters=_spent(name), tell=partial(_remember, name))
    with machine.lock:
        try:
            program = machine.build(kernel.text, options.math, hurried=worth is not None)
            executable = OpenCLExecutable(machine, kernel, prepared, program, pace, group, remarks)
            executable.warm_up()
        except machine.cl.Error as e:
            raise _refusal(str(e), kernel) from e
    if worth is not None:
        executable.optimize = partial(_optimized, machine, module, kernel.text, options)
    return executable


def _worth(machine: Machine, module: Module, kernel: KernelText, options: Options) -> float | None:
    """Return the seconds that an optimized build is expected to take; None where the first build is optimized."""
    statements = sum(1 for f in module.functions for _ in walk(f.body))
    if not machine.hurries or options.math not in REPRODUCIBLE or statements < LARGE:
        return None
    fixed, each = _FRAME
    if kernel.lanes * (fixed + each * statements) > (thread_stack() or 0) // 2:
        return None
    is_kept = store.is_remembered(_OPTIMIZED, machine.key(kernel.text, machine.options(options.math)))
    return None if is_kept else _EACH * statements


def _spent(name: str) -> int:
    """Return the quarters of an optimized build's cost that earlier processes spent on a text without one."""
    return max(n for n in range(QUARTERS) if not n or store.is_remembered(_SPENT, f"{name}+{n}"))


def _remember(name: str, quarters: int) -> None:
    """Remember the quarters that processes spent: a script that is run again and again would never reach all four."""
    store.remember(_SPENT, f"{name}+{quarters}")


def _optimized(machine: Machine, module: Module, text: str, options: Options) -> Any:
    """Build a text again, optimized, and remember that."""
    with announced(module, "opencl"):
        program = machine.build(text, options.math)
    store.remember(_OPTIMIZED, machine.key(text, machine.options(options.math)))
    return program


def _printed(machine: Machine, prepared: PreparedModule, options: Options, lanes: int) -> KernelText:
    module, near = prepared.module, lanes
    if lanes > 1:
        if options.lanes == "auto":
            lanes, near = widths_of(machine, module, options.precision)
        return print_packets(module, lanes, machine.abilities, options.math, faults=machine.wrong, near=near)
    rounds = any(isinstance(s, Let) and s.op in ELEMENTWISE for f in module.functions for s in walk(f.body))
    return print_kernel(
        module, options.math, elementwise=rounds and machine.abilities.elementwise, faults=machine.wrong
    )


def _refusal(log: str, kernel: KernelText) -> CompileError:
    """Return the driver's complaints, each at the user's line that the text's line comes from."""
    complaints: list[tuple[Loc | None, str]] = []
    for line, text in re.findall(r":(\d+):\d+(?: <[^>]*>)?: (?:(?:fatal )?error: )?(.*)", log):
        upto = kernel.lines[: int(line)]
        complaints.append((next((loc for loc in reversed(upto) if loc), None), text.strip()))
    if not complaints:
        return CompileError(f"the OpenCL driver refused the kernel:\n{log.strip()}")
    listed = "\n".join(f"  {loc or 'prologue'}: {text}" for loc, text in complaints)
    return CompileError(f"the OpenCL driver refused the kernel:\n{listed}", loc=complaints[0][0])


def widths_of(machine: Machine, module: Module, precision: Precision) -> tuple[int, int]:
    """Return the lanes of a prepared module's packets, and those where it reads neighbours in a grid."""
    each = private_memory(module).size
    fits = [n for n in machine.widths if n * _PACKETS * each <= machine.most_private] if each else machine.widths
    fitting = fits or [min(machine.widths)]
    doubled = 2 if precision == "f64" else 1
    register = machine.lanes // doubled
    statements = [(f, s) for f in module.functions for s in walk(f.body)]
    loops = [_carried(f, s) for f, s in statements if isinstance(s, Loop)]
    registers = _REGISTERS if machine.lanes == _LANES_OF_AVX512 else _REGISTERS // 2
    most = min(_MOST_EACH, registers // max(loops, default=1) or 1) * register
    beside = min(most, max(_MOST_OF_LARGE * register, _NEIGHBOURS // doubled))
    read = sum(s.value.type.size for _, s in statements if isinstance(s, Let) and s.op == "table")
    if sum(f.name not in SELDOM for f, _ in statements) > _LARGE or (read >= _GATHERED and not loops):
        most = beside = min(most, _MOST_OF_LARGE * register)
    return _widest(fitting, most), _widest(fitting, beside)


def _widest(widths: Sequence[int], most: int) -> int:
    return max((n for n in widths if n <= most), default=min(widths))


def _carried(function: Function, loop: Loop) -> int:
    """Return how many numbers a loop stores, so that the next iteration may read them; at least 1."""
    stored = {s.variable for s in walk(loop.body) if isinstance(s, Store)}
    return sum(v.type.size for v in variables_of(function) if v.id in stored) or 1


def group_of(machine: Machine, kernel: KernelText) -> tuple[int, int]:
    """Return the work items of a group, and how many it would have if its kernel had no local arrays.

    Raise CompileError if the local arrays of a single work item do not fit.
    """
    whole = LOCAL_SIZE if kernel.lanes == 1 else _PACKETS if kernel.packets == 1 else _LINES
    size = kernel.private.size
    group = whole
    most = machine.most_private if size else 0
    work = "an element" if kernel.lanes == 1 else f"a packet of {kernel.lanes} elements"
    cure = 'smaller arrays, or compile("numpy")' if kernel.lanes == 1 else 'lanes="auto", or smaller arrays'
    check_private(kernel.private, most, work, machine.device.name.strip(), cure)
    while machine.is_cpu and group * size > most:
        group //= 2
    return group, whole


backend = OpenCLBackend()
