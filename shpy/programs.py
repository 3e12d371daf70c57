"""Programs: recorded functions as values, to be run, compiled, joined and changed.

Stage: above all others. `Program` stands over the backends; `lang` only records.

    @sh.program
    def scale(x: sh.Attrib1f, by: sh.Attrib1f) -> sh.Attrib1f:
        return x * by

    scale([1, 2, 3], 2)                      # array([2., 4., 6.], dtype=float32)
    scale.compile("opencl").source           # the emitted text
    double = scale.bind(by=2)                # a program of one input
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from itertools import chain
from types import MethodType
from typing import TYPE_CHECKING, Any, Generic, Literal, overload

from shpy import algebra
from shpy.backend.base import Options
from shpy.backend.registry import CHOICES, default_backend
from shpy.display.png import picture
from shpy.errors import ShpyTypeError
from shpy.ir.constants import is_int
from shpy.ir.nodes import Module
from shpy.ir.verifier import verify
from shpy.lang.data.params import listed
from shpy.lang.data.tables import listed_tables
from shpy.lang.programs.claims import checked
from shpy.lang.programs.inline import call_recorded
from shpy.lang.programs.method import PerInstance, is_method
from shpy.lang.programs.record import RecordedProgram, record
from shpy.lang.recording.location import caller, here, located
from shpy.lang.recording.pickling import Unchanging
from shpy.lang.recording.recorder import current_frame
from shpy.lang.values.dependent import evaluate_with
from shpy.lang.values.structure import Layout, leaves, type_of
from shpy.passes.modes import MODES, PRECISIONS, REPRODUCIBLE, Math, Precision
from shpy.run.host import bind
from shpy.run.kernel import Kernel
from shpy.run.uniforms import evaluate
from shpy.streams.stream import Place, Stream, streams_in
from shpy.tracing import Step, trace

if TYPE_CHECKING:  # defaults of type variables came with Python 3.13
    from typing import Concatenate, Self

    from typing_extensions import ParamSpec, TypeVar

    _P = ParamSpec("_P", default=...)
    _R = TypeVar("_R", default=Any)
    _Instance = TypeVar("_Instance")
    _Rest = ParamSpec("_Rest")
else:
    from typing import ParamSpec, TypeVar

    _P, _R = ParamSpec("_P"), TypeVar("_R")

_LANES: tuple[Any, ...] = ("auto", 1, 4, 8, 16, 32, 64)
_PLAIN = Options()
"""The options of a plain call, which finds its kernel by them: to check options takes 5 µs."""

evaluate_with(evaluate)


class Program(Unchanging, Generic[_P, _R]):
    """A recorded function. Call it with arrays to run it on the default backend, with values to inline it.

    A type checker knows it as `Program[parameters, result]` of the function: called with values it gives the result,
    called with arrays it gives arrays.
    """

    recorded: RecordedProgram
    """The module, with the facts that the host needs to run it: inputs, outputs, params, tables and defaults."""

    def __init__(self, recorded: RecordedProgram) -> None:
        self.recorded = recorded
        self._kernels: dict[tuple[str, Options], Kernel] = {}

    def __reduce__(self) -> Any:
        return Program, (self.recorded,)

    @classmethod
    def from_ir(cls, module: Module) -> Program:
        """Make a module runnable: its tables become inputs. Raises VerifyError for a module that breaks a rule.

        Whoever wrote it need not be trusted: a loop that does not show that it takes the iterations that it promises
        has a budget (`loop_limit`), and nothing in a name reaches a target as code. Raises ShpyTypeError for anything
        but a module.
        """
        if not isinstance(module, Module):
            cure = "sh.parse(text) for the text of one, or a program's .ir"
            raise ShpyTypeError(f"from_ir takes a module, not {type(module).__name__}", loc=here(), cure=cure)
        verify(module)
        return cls(algebra.recorded_from(checked(module)))

    @property
    def name(self) -> str:
        """The function's name."""
        return self.recorded.module.name

    @property
    def ir(self) -> Module:
        """The recorded module; `str` of it is its text."""
        return self.recorded.module

    @property
    def inputs(self) -> dict[str, Any]:
        """The type of each input by name."""
        return {n: type_of(t) if isinstance(t, Layout) else t for n, t in self.recorded.inputs.items()}

    @property
    def outputs(self) -> dict[str, Any]:
        """The type of each output by name; outputs without a name are "0", "1", …."""
        return {name: cls for name, _, cls in _output_leaves(self.recorded)}

    @property
    def params(self) -> dict[str, Any]:
        """Each Param by name; set `.value` between runs.

        Dependent uniforms are here too, and the Params that they follow. A matrix or struct is one Param.
        """
        return listed(self.recorded.params)

    @property
    def tables(self) -> dict[str, Any]:
        """Each Table by name; a Table of structs or matrices is one."""
        return listed_tables(self.recorded.tables)

    @overload
    def __call__(self, /, *args: _P.args, **named: _P.kwargs) -> _R: ...
    @overload
    def __call__(self, /, *args: Any, shape: Any = None, **named: Any) -> Any: ...
    def __call__(self, /, *args: Any, **named: Any) -> Any:
        """Run on arrays on the default backend, or, while a program is recorded, be inlined into it.

        With a Stream among the inputs, or in a Table, it runs on the device where that lies.
        """
        if current_frame() is not None:
            return call_recorded(self.recorded, bind(self.recorded, args, named))
        stream = next(streams_in(chain(args, named.values(), self.recorded.tables.values())), None)
        if stream is not None:
            return self.compile_for(stream)(*args, **named)
        kernel = self._kernels.get((default_backend(), _PLAIN)) or self.compile()
        return kernel(*args, **named)

    def compile_for(self, stream: Stream) -> Kernel:
        """Compile for the device where a stream lies, at its precision."""
        return self.compile_at(stream.place)

    def compile_at(self, place: Place) -> Kernel:
        """Compile for a device, at the precision of the streams there."""
        return self.compile(place.backend, device=place.device or None, precision=place.precision)

    @located
    def compile(
        self,
        backend: str | None = None,
        *,
        device: int | None = None,
        precision: Precision = "f32",
        math: Math = "strict",
        fuse: bool = False,
        lanes: int | Literal["auto"] = "auto",
        loop_limit: int | None = 1_048_576,
    ) -> Kernel:
        """Compile for "auto", "numpy", "opencl" or "glsl" (None: the default); kernels are kept and given again.

        An "auto" kernel runs on numpy, and on OpenCL with the same bits once that pays; `kernel.runs_on` names the one
        in use. Its streams lie on numpy, and in relaxed and fast mode it stays there.
        `precision` is the working float's, `loop_limit` the iterations of a loop without a known bound. `math` is
        "strict", the same bits on every backend; "portable", the same by formulas that use no binary64; "relaxed", the
        target's own functions within OpenCL's bounds; or "fast", whatever is fastest, where NaN and infinity may
        vanish. With `fuse`, strict and portable mode round a * b + c once, by a rule of the language's own, with the
        same bits on every backend (docs/numerics.md).
        `lanes` is how many elements OpenCL runs together: 4, 8 or 16; 32 or 64 where the driver's compiler takes such
        vectors; 1; or "auto": 1 on a GPU, and on a CPU one, two or four of its vectors, by the form of the program.
        Strict and portable mode give the same bits at every width; relaxed and fast mode may not, so a width written
        out keeps their bits the same on another processor.
        Raises BackendUnavailable, with the command that mends it; CompileError with the user's line.
        """
        options = self._options(device, precision, math, lanes, loop_limit, fuse)
        name = backend if backend is not None else default_backend()
        if not isinstance(name, str):
            cure = " or ".join(f'backend="{n}"' for n in CHOICES)
            raise ShpyTypeError(f"backend={name!r} names no backend", loc=caller(), cure=cure)
        kernel = self._kernels.get((name, options))
        if kernel is None:
            kernel = self._kernels[name, options] = Kernel.on(self.recorded, name, options)
        return kernel

    def _options(self, device: Any, precision: Any, math: Any, lanes: Any, loop_limit: Any, fuse: Any) -> Options:
        def refuse(option: str, value: Any, cure: str) -> None:
            raise ShpyTypeError(f"compile does not take {option}={value!r}", loc=here(), cure=cure)

        if not (device is None or is_int(device)):
            refuse("device", device, "device=0, the position of one in the devices of sh.backends()")
        if not (isinstance(precision, str) and precision in PRECISIONS):
            refuse("precision", precision, 'precision="f32", "f64" or "f16"')
        if not (isinstance(math, str) and math in MODES):
            refuse("math", math, 'math="strict", "portable", "relaxed" or "fast"')
        if not isinstance(fuse, bool):
            refuse("fuse", fuse, "fuse=True or False")
        if fuse and math not in REPRODUCIBLE:
            raise ShpyTypeError(
                f"math={math!r} contracts products and sums already, as each target likes",
                loc=here(),
                cure='math="strict", fuse=True, or math="portable", fuse=True: the same bits everywhere',
            )
        if not ((isinstance(lanes, str) or is_int(lanes)) and lanes in _LANES):
            refuse("lanes", lanes, 'lanes="auto", 1, 4, 8, 16, 32 or 64')
        if not (loop_limit is None or (is_int(loop_limit) and 0 < loop_limit < 2**31)):
            refuse("loop_limit", loop_limit, "a number of iterations, or None for no limit")
        device, loop_limit, lanes = (int(n) if is_int(n) else n for n in (device, loop_limit, lanes))
        return Options(precision, loop_limit, device, lanes, math, fuse)

    def trace(self, /, *args: Any, shape: Any = None, at: Any = None, **named: Any) -> list[Step]:
        """Run one element in the reference interpreter; return each step that has a name or stores into one.

        Inputs are those of a call. `at` is the index of the element along the axes of its shape, an int or a tuple of
        ints, counted from 0; it may be left out where there is one element. `shape` is needed where no input has the
        shape of the run, as in a program that reads `grid_index`. An input named `at` comes before the index of that
        name. Each Step has the line, the name, the value and the iterations of the loops around it.
        Raises ShpyTypeError, with a correction, for an index that does not fit the shape.
        """
        if at is not None and "at" in list(self.recorded.inputs)[len(args) :]:
            named, at = {**named, "at": at}, None
        return trace(self.recorded, args, named, shape, at)

    @located
    def fpcore(self, domain: Mapping[str, Any] | None = None, *, precision: Precision = "f32") -> str:
        """Return the program as FPCore 2.0, FPBench's language, for Herbie, FPTaylor, Satire and other tools.

        `domain` has the lower and upper end of inputs and Params, which become `:pre`; a Param has its `range` there
        without it. Params are arguments, vectors are arrays, and several results are one array. Ints are whole numbers
        that do not wrap. Raises ShpyError with the line of what FPCore lacks: tables, arrays that change, bits,
        unsigned ints, discards, places in a grid; ShpyTypeError for anything else as a domain.
        """
        from shpy.fpcore import write_fpcore  # here: few programs ask for it

        return write_fpcore(self.ir, domain, precision)

    if TYPE_CHECKING:  # a program that is a method is a `Method`, which gives the program of an instance

        @overload
        def __get__(self, instance: None, owner: Any = None) -> Self: ...
        @overload
        def __get__(
            self: Program[Concatenate[_Instance, _Rest], _R], instance: _Instance, owner: Any = None
        ) -> Program[_Rest, _R]: ...
        @overload
        def __get__(self, instance: object, owner: Any = None) -> Self: ...
        def __get__(self, instance: Any, owner: Any = None) -> Any: ...

    # Programs are values

    def __lshift__(self, other: Program) -> Program:
        """Return `g << f`: f's outputs become g's inputs."""
        if not isinstance(other, Program):
            return NotImplemented
        return Program(algebra.compose(self.recorded, other.recorded))

    def __and__(self, other: Program) -> Program:
        """Return `f & g`, a program that runs both: inputs and outputs of f, then those of g."""
        if not isinstance(other, Program):
            return NotImplemented
        return Program(algebra.beside(self.recorded, other.recorded, share=False))

    def merge(self, other: Program) -> Program:
        """Side by side; inputs of equal name and type are shared."""
        check_program(other)
        return Program(algebra.beside(self.recorded, other.recorded, share=True))

    def rename(self, **names: str) -> Program:
        """Rename inputs and named outputs: `rename(old="new")`."""
        return Program(algebra.renamed(self.recorded, names))

    def bind(self, **values: Any) -> Program:
        """Give inputs once and for all: a number becomes a uniform; a Param or Table is used as it is."""
        return Program(algebra.bound(self.recorded, values))

    def specialize(self, **values: Any) -> Program:
        """Make inputs or params constants, which are folded into the program."""
        return Program(algebra.specialized(self.recorded, values))

    # Derivatives

    def gradient(
        self,
        *wrt: Any,
        value: bool = False,
        mode: Literal["forward", "reverse"] = "forward",
        most: int | None = None,
    ) -> Program:
        """Return the program of the derivatives of the only output, a float: an output d_x for each x of `wrt`.

        `wrt` are inputs and Params, by name or the Params themselves; the first input by default. d_x has the type of
        x. With `value` the output comes first, as `value`. See `sh.gradient`, also for `mode` and `most`.

        Raises ShpyTypeError for a program with other outputs, and for a name that is no input or Param; RecordError
        where the output does not depend on one.
        """
        from shpy.gradients.programs import gradient_of  # here: few programs are differentiated

        return Program(gradient_of(self.recorded, wrt, value=value, mode=mode, most=most))

    def jvp(self, *wrt: Any) -> Program:
        """Return the program that also gives the derivatives of its outputs along a direction.

        It has an input d_x for each x of `wrt`, inputs and Params as in `gradient`, and an output d_y for each output
        y, after them all; a single output without a name is called `value`. See `sh.jvp`.
        """
        from shpy.gradients.programs import jvp_of  # here: few programs are differentiated

        return Program(jvp_of(self.recorded, wrt))

    def _repr_png_(self) -> bytes | None:
        """Return the picture that a notebook shows, of a program of pixels; None for others, which show their text."""
        return picture(self)

    def __repr__(self) -> str:
        defaults = {n: f" = {getattr(d, 'name', None) or repr(d)}" for n, d in self.recorded.defaults.items()}
        types = {n: algebra.type_name(t) if isinstance(t, Layout) else t for n, t in self.recorded.inputs.items()}
        inputs = ", ".join(f"{n}: {t}{defaults.get(n, '')}" for n, t in types.items())
        outputs = ", ".join(t.__name__ for t in self.outputs.values())
        return f"<Program {self.name}({inputs}) -> {outputs}>"


def check_program(thing: Any) -> None:
    """Raise ShpyTypeError for anything but a Program."""
    if not isinstance(thing, Program):
        raise ShpyTypeError(f"{thing!r} is no program", loc=here(), cure="a function under @sh.program")


def check_count(name: str, number: Any, least: int) -> None:
    """Raise ShpyTypeError for anything but an int from `least` on."""
    if not is_int(number) or number < least:
        raise ShpyTypeError(f"{name} is an int from {least} on, not {number!r}", loc=here(), cure=f"{name}=1000")


def _output_leaves(recorded: RecordedProgram) -> list[tuple[str, str, Any]]:
    return [(name or "0", kind, cls) for name, kind, cls in leaves(recorded.output, "")]


@overload
def program(function: classmethod[Any, _P, _R] | staticmethod[_P, _R]) -> Program[_P, _R]: ...
@overload
def program(function: Callable[_P, _R]) -> Program[_P, _R]: ...
def program(function: Any) -> Any:
    """Record a function, once, by running it on symbolic arguments; every input is annotated.

    An input with a default may be left out at a call. A method of a class, whose first parameter is not annotated, is
    recorded for each instance when it is first asked for (`Method`), a class method for each class.
    Raises RecordError and ShpyTypeError at the user's line.
    """
    if isinstance(function, Program) or hasattr(function, "_is_subroutine"):
        kind = "program" if isinstance(function, Program) else "subroutine"
        cure = f"@sh.program or @sh.subroutine above the def of {function.name}, and the name in other programs"
        raise ShpyTypeError(f"{function.name} is a {kind} already", loc=here(), cure=cure)
    if isinstance(function, functools._lru_cache_wrapper):
        raise ShpyTypeError(
            f"{function.__name__} is cached by its arguments, and the inputs of a program have no values yet",
            loc=here(),
            cure="@sh.program above the function, without functools.cache",
        )
    if isinstance(function, classmethod):
        return ClassMethod(function.__func__)
    if isinstance(function, staticmethod):
        function = function.__func__
    if is_method(function):
        return Method(function)
    result: Program[Any, Any] = Program(record(function))
    functools.update_wrapper(result, function, updated=())
    return result


class Method(PerInstance):
    """A program that is a method: `instance.shade` is a Program, recorded when it is first asked for."""

    def record_for(self, instance: Any) -> Program:
        """Return the program of the method bound to this instance."""
        result = Program(record(MethodType(self.function, instance)))
        # Not the bound method, which would keep the instance alive.
        functools.update_wrapper(result, self.function, updated=())
        return result


class ClassMethod(Method):
    """A program that is a class method: `Class.shade` is a Program, recorded when it is first asked for."""

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        return self._of(type(instance) if owner is None else owner)


def parse(text: str) -> Module:
    """Return the module that IR text describes, checked; raises ParseError or VerifyError. Loading executes nothing."""
    from shpy.ir.parser import parse as parse_text  # here: lark takes long to import, and few programs read texts

    module = parse_text(text)
    verify(module)
    return module
