"""The result of a program without rounding: the reference that errors are measured against.

Stage: measure. Takes a program and flat inputs, gives for each output the exact values as pairs of float64 whose sum
they are, and how each element ends. It runs the recorded module without the passes:

- "mpmath": the reference interpreter on numbers of 240 bits; in binary64 where mpmath has no such number (infinities,
  NaN, the sign of a zero);
- "f64": the numpy kernel at f64.

    exact = evaluate(setting, "mpmath")
    ulp(found, exact.outputs[0].high)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from shpy.errors import ShpyTypeError
from shpy.ir import meaning
from shpy.ir.closures import Compiler, Run
from shpy.ir.constants import DTYPES, decode
from shpy.ir.interpreter import Interpreter
from shpy.ir.nodes import Function, Let, Module, Status, Value
from shpy.ir.ops import OPS
from shpy.ir.traverse import defined
from shpy.ir.types import FLOATS, Type
from shpy.lang.recording.location import here
from shpy.testing.observers import Setting
from shpy.testing.runs import run

Array = NDArray[Any]
Kind = Literal["mpmath", "f64"]


@dataclass(frozen=True)
class Exact:
    """The values of one output, (n, size): `high` + `low`, where `high` is their nearest float64 (or int, bool)."""

    high: Array
    low: Array


@dataclass(frozen=True)
class Truth:
    """The outputs, and the elements (n,) that are written."""

    outputs: tuple[Exact, ...]
    written: Array


def evaluate(setting: Setting, kind: Kind = "mpmath") -> Truth:
    """Run the program without rounding (but for that of binary64, if `kind` is "f64") on the setting's inputs.

    Inputs are those of the setting's precision, exactly; constants are the numbers that the user wrote, in binary64.
    Raises ShpyError where mpmath is asked for and not there.
    """
    if kind == "f64":
        results = run(replace(setting, options={**setting.options, **_DOUBLE}, watches={}), "numpy")
        return Truth(tuple(Exact(a, np.zeros(a.shape)) for a in results.outputs), results.written)
    if kind != "mpmath":
        raise ShpyTypeError(f"reference={kind!r} is not a reference", loc=here(), cure='reference="mpmath" or "f64"')
    return _Multiprecision(setting).run()


_DOUBLE = {"precision": "f64"}


class _Multiprecision:
    """The interpreter on mpf, element by element."""

    def __init__(self, setting: Setting) -> None:
        from shpy.accuracy import multiprecision

        self.mp = multiprecision
        self.setting = setting
        self.module = setting.program.ir
        limit = setting.options.get("loop_limit", 1_048_576)
        self.compiled = _Exactly(self.module, limit, multiprecision).entry
        self.double = Interpreter(self.module, "f64", limit)
        params, self.tables = setting.data()
        self.params = {n: np.asarray(p.at("f64", "strict")) for n, p in setting.program.recorded.params.items()}
        self.params = {**params, **self.params}

    def run(self) -> Truth:
        shape = self.setting.element_shape
        count = int(np.prod(shape, dtype=np.int64))
        types = [slot.type for slot in self.module.entry.outputs[: len(self.module.outputs)]]
        outputs = [
            Exact(*(np.zeros((count, t.size), np.float64 if t.is_float else DTYPES[t.base]) for _ in range(2)))
            for t in types
        ]
        written = np.zeros(count, np.bool_)
        for n in range(count):
            values, written[n] = self.element(n)
            for output, value in zip(outputs, values, strict=False):
                for k, part in enumerate(value if np.ndim(value) else [value]):
                    output.high[n, k], output.low[n, k] = self.split(part)
        return Truth(tuple(outputs), written)

    def split(self, value: Any) -> tuple[Any, Any]:
        """Split a number into the nearest float64 and the rest."""
        if not isinstance(value, self.mp.MP.mpf):
            return value, 0
        high = float(value)
        return high, float(value - self.mp.MP.mpf(high)) if np.isfinite(high) else 0.0

    def element(self, n: int) -> tuple[list[Any], bool]:
        inputs = list(self.setting.element(n).values())
        try:
            return self.exactly(inputs, n)
        except self.mp.Unsayable:  # the sign of a zero, an infinity: binary64 says it, and docs/accuracy.md says so
            index = self.setting.index(n)
            values, status = self.double.run_element(
                inputs, self.params, self.tables, index, self.setting.element_shape
            )
            return values, status == Status.WRITTEN

    def exactly(self, inputs: list[Any], n: int) -> tuple[list[Any], bool]:
        compiled, entry = self.compiled, self.module.entry
        index, shape = self.setting.index(n), self.setting.element_shape
        arrays = {name: getattr(t, "array", t) for name, t in self.tables.items()}
        frame = compiled.frame(Run(self.params, arrays, index, shape, None, None))
        for port, value in zip(entry.inputs, inputs, strict=True):
            assert isinstance(port, Value)
            frame[compiled.places[port.id]] = self.exact_input(port.type, value)
        status = compiled.run(frame)
        slots = entry.outputs[: len(self.module.outputs)]
        return [frame[compiled.slots[slot.id]] for slot in slots], status == Status.WRITTEN

    def exact_input(self, type: Type, value: Any) -> Any:
        return exact(self.mp, value) if type.is_float else value


def exact(mp: Any, value: Any) -> Any:
    """Convert a float, or an array of them, to mpf."""
    if np.ndim(value):
        return mp.array([mp.number(v) for v in value])
    return mp.number(value)


class _Exactly(Compiler):
    """Closures whose floats are mpf."""

    def __init__(self, module: Module, limit: int | None, mp: Any) -> None:
        self.mp = mp
        super().__init__(module, {**DTYPES, **dict.fromkeys(FLOATS, object)}, limit, traced=False)

    def function(self, function: Function) -> Any:
        """Compile one function; the types of its values tell which operations are on floats."""
        self.types = {v.id: v.type for v in defined(function)}
        return super().function(function)

    def operation(self, let: Let, args: list[int]) -> Callable[[Any], Any]:
        """Return the function that computes the right side of a Let from a frame."""
        type, mp = let.value.type, self.mp
        operands = [self.types[a] for a in let.args]
        match let.op:
            case "const" if type.is_float:
                return self.constant(type, let.attr)
            case "param" if type.is_float:
                return lambda frame: exact(mp, frame[0].params[let.attr])
            case "table" if type.is_float:
                read = super().operation(let, args)
                return lambda frame: exact(mp, read(frame))
            case "convert":
                return self.convert(operands[0], type, args[0])
            case "unit_float":
                return lambda frame: exact(mp, OPS["unit_float"].meaning(frame[args[0]]))
            case "bits_from_float" | "float_from_bits" | "half":
                return self.bits(let, args[0])
        if let.op in mp.OPERATIONS and any(t.is_float for t in (type, *operands)):
            f = mp.OPERATIONS[let.op]
            return lambda frame: f(*[frame[a] for a in args])
        return super().operation(let, args)

    def constant(self, type: Type, attr: Any) -> Callable[[Any], Any]:
        """Return the number that the user wrote, in binary64; infinities are mpmath's, and -0 is 0."""
        mp, numbers = self.mp, decode(type, attr)

        def unsayable(frame: Any) -> Any:
            raise mp.Unsayable("NaN")

        if any(v != v for v in numbers):
            return unsayable
        parts = [mp.MP.mpf(v) for v in numbers]
        value = mp.array(parts) if type.size > 1 else parts[0]
        return lambda frame: value

    def convert(self, source: Type, type: Type, place: int) -> Callable[[Any], Any]:
        """Return the conversion: a float stays exact for any type of float, and an int is taken as it is."""
        mp, dtype = self.mp, DTYPES[type.base]
        if source.is_float and type.is_float:
            return lambda frame: frame[place]
        if source.is_float:
            if type.is_bool:
                return lambda frame: _mapped(lambda x: x != 0, frame[place], np.bool_)
            info = np.iinfo(dtype)
            return lambda frame: _mapped(lambda x: min(max(int(x), info.min), info.max), frame[place], dtype)
        if type.is_float:
            return lambda frame: exact(mp, np.asarray(frame[place]).astype(np.float64)[()])
        return lambda frame: meaning.convert(frame[place], dtype)

    def bits(self, let: Let, place: int) -> Callable[[Any], Any]:
        """Return the bits of a number as the working precision rounds it: binary32."""
        mp, f = self.mp, OPS[let.op].meaning if let.op in OPS else None
        if let.op == "half":
            return lambda frame: frame[place]
        assert f is not None
        if let.op == "float_from_bits":
            return lambda frame: exact(mp, f(frame[place]))
        return lambda frame: f(_mapped(float, frame[place], np.float32))


def _mapped(f: Callable[[Any], Any], value: Any, dtype: Any) -> Any:
    return np.array([f(v) for v in value], dtype) if np.ndim(value) else dtype(f(value))
