"""Domains: which inputs a program is measured on, special values always among them.

Stage: measure. Takes the user's domain of each input, gives arrays.

    {"x": (1e-3, 1e3, "log"), "v": (-1, 1), "n": (0, 100), "t": array, "r": lambda rng, count: rng.normal(size=count)}
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.errors import ShpyTypeError
from shpy.ir.constants import dtypes_at
from shpy.ir.traverse import grid_rank
from shpy.ir.types import Base, Type
from shpy.lang.data.tables import TableType
from shpy.lang.data.textures import TextureType
from shpy.lang.recording.location import here
from shpy.lang.values.structure import build_arrays, leaves
from shpy.programs import Program, check_count, check_program

Array = NDArray[Any]
Domain = Mapping[str, Any]
"""The values of each input or leaf (`ray.o`): (lo, hi), (lo, hi, "log"), an array, or a function of rng and count."""

_EXPONENTS = (-100, -64, -24, -12, -6, -3, -2, -1, 0, 1, 2, 3, 6, 12, 20, 24, 64, 100)


@dataclass(frozen=True)
class Samples:
    """`inputs` as the program takes them; `leaves` by name, (n[, size]); `inside` (n,) marks those in the domain."""

    inputs: tuple[Any, ...]
    leaves: dict[str, Array]
    inside: Array

    @property
    def count(self) -> int:
        """The number of elements."""
        return self.inside.size


def special_values(type: Type, precision: str = "f32") -> Array:
    """Return the values of a type at which errors are most frequent.

    Floats: zeros, ones, halves, powers of two and their neighbours, denormals, the least and largest, infinities, NaN.
    """
    if type.is_bool:
        return np.array([False, True])
    if type.is_int:
        info = np.iinfo(np.int32 if type.base is Base.I else np.uint32)
        near = [0, 1, 2, 3, 7, 31, 32, 33, 255, 65535, info.max - 1, info.max, info.min, info.min + 1]
        return np.array([n for n in near + [-1, -2] if info.min <= n <= info.max], info.dtype)
    dtype = np.dtype(dtypes_at(precision)[type.base])
    info_f = np.finfo(dtype)
    with np.errstate(all="ignore"):
        powers = np.array([2.0**e for e in _EXPONENTS]).astype(dtype)
        powers = powers[np.isfinite(powers) & (powers > 0)]
        around = np.concatenate([powers, np.nextafter(powers, dtype.type(0)), np.nextafter(powers, dtype.type(np.inf))])
        ends = [0, 1.5, 2.5, 3.5, info_f.smallest_subnormal, info_f.tiny, info_f.max, np.inf]
        least = np.array([info_f.tiny]).astype(dtype)
        positive = np.concatenate([around, np.array(ends).astype(dtype), np.nextafter(least, dtype.type(0))])
    return np.concatenate([positive, -positive, np.array([np.nan], dtype)])


@np.errstate(over="ignore")  # numbers beyond the precision are infinite there
def draw(
    program: Program,
    domain: Domain,
    count: int,
    rng: np.random.Generator,
    *,
    precision: str = "f32",
    special: bool = True,
) -> Samples:
    """Return `count` elements inside the domain, then (with `special`) one for each special value of each input.

    An element with a special value has ordinary ones in its other inputs. Raises ShpyTypeError for a domain that lacks
    an input, or has one that the program does not. A program whose inputs are tables alone, or that has none, runs
    one element.
    """
    check_program(program)
    if not isinstance(domain, Mapping):
        what = f"a domain is a dict that says of each input where it lies, not {reprlib.repr(domain)}"
        raise ShpyTypeError(what, loc=here(), cure='{"x": (-1, 1)}')
    check_count("samples", count, 0)
    types = dict(_leaves(program))
    _check(program, domain, set(types))
    _check_rank(program, 1 if types else 0)
    arrays = {name: _draw(_of(domain, name), type, count, rng, precision) for name, type in types.items()}
    count = max((len(a) for a in arrays.values()), default=1)
    inside = np.ones(count, np.bool_)
    for name, type in types.items() if special else ():
        values = special_values(type, precision)
        extra = {n: _draw(_of(domain, n), t, len(values), rng, precision) for n, t in types.items()}
        shape = extra[name].shape[1:]
        extra[name] = np.broadcast_to(values.reshape(-1, *(1,) * len(shape)), (len(values), *shape)).copy()
        within = _within(_of(domain, name), values)
        arrays = {n: np.concatenate([arrays[n], extra[n][: len(values)]]) for n in types}
        inside = np.concatenate([inside, within])
    return Samples(_shaped(program, domain, arrays), arrays, inside)


def _leaves(program: Program) -> list[tuple[str, Type]]:
    return [
        (leaf, cls.type)
        for name, layout in program.recorded.inputs.items()
        if not isinstance(layout, TableType | TextureType)
        for leaf, _, cls in leaves(layout, name)
    ]


def _check(program: Program, domain: Domain, names: set[str]) -> None:
    inputs = program.recorded.inputs
    missing = [n for n in (*names, *inputs) if _of(domain, n) is None and (n in inputs or n in names)]
    missing = [n for n in missing if n in names or isinstance(inputs.get(n), TableType | TextureType)]
    if missing:
        raise ShpyTypeError(
            f"the domain says nothing of {missing[0]}, an input of {program.name}",
            loc=here(),
            cure=f'{{"{missing[0]}": (-1, 1)}}, a range, an array, or a function of rng and count',
        )
    unknown = [n for n in domain if n not in names and n not in inputs]
    if unknown:
        raise ShpyTypeError(f"{unknown[0]} is no input of {program.name}", loc=here(), cure=", ".join(inputs))


def _check_rank(program: Program, rank: int) -> None:
    """Raise ShpyTypeError for a program whose elements have another number of axes than those of a domain."""
    own_rank = grid_rank(program.ir)
    if own_rank is not None and own_rank != rank:
        raise ShpyTypeError(
            f"{program.name} uses grid_index({own_rank}), and the elements of this domain have {rank} axes",
            loc=here(),
            cure=f"an input of type Attrib{own_rank}i in place of sh.grid_index({own_rank})",
        )


def _of(domain: Domain, name: str) -> Any:
    """Return the domain's entry for a leaf, or that of the input that it is part of."""
    head = name.partition(".")[0].partition("[")[0]
    return domain.get(name, domain.get(head))


def _draw(entry: Any, type: Type, count: int, rng: np.random.Generator, precision: str) -> Array:
    dtype = dtypes_at(precision)[type.base]
    shape = (count, type.size) if type.size > 1 else (count,)
    if callable(entry):
        return _numbers(_sampled(entry, rng, count), type, shape).astype(dtype)
    if not isinstance(entry, tuple):
        numbers = _numbers(entry, type, (-1, *shape[1:])).astype(dtype)
        return numbers if count == len(numbers) else numbers[rng.integers(0, len(numbers), count)]
    low, high, *scale = _ends(entry, type)
    if type.is_bool:
        return rng.integers(0, 2, shape).astype(np.bool_)
    if type.is_int:
        low, high = math.ceil(low), math.floor(high)
        if low > high:
            raise ShpyTypeError(f"{entry!r} is a range without an int", loc=here(), cure="(0, 10)")
    if not scale and type.is_int:
        return rng.integers(low, high, shape, np.int64, endpoint=True).astype(dtype)
    if not scale:
        return rng.uniform(low, high, shape).astype(dtype)
    if scale != ["log"] or low <= 0 <= high:
        raise ShpyTypeError(f"{entry!r} is no range", loc=here(), cure='(1e-3, 1e3, "log"), both of one sign')
    least, most = sorted((np.log(abs(low)), np.log(abs(high))))
    sizes = np.exp(rng.uniform(least, most, shape))
    drawn = np.asarray(np.copysign(sizes, low))
    return (np.clip(np.rint(drawn), low, high) if type.is_int else drawn).astype(dtype)


def _sampled(sampler: Callable[..., Any], rng: np.random.Generator, count: int) -> Any:
    """Return the numbers that a function draws; raise ShpyTypeError if it takes other arguments."""
    try:
        return sampler(rng, count)
    except TypeError as error:
        if error.__traceback__ is None or error.__traceback__.tb_next is not None:  # raised inside `sampler`
            raise
        cure = "lambda rng, count: rng.random(count)"
        raise ShpyTypeError(f"a function of a domain takes rng and count: {error}", loc=here(), cure=cure) from None


def _numbers(entry: Any, type: Type, shape: tuple[int, ...]) -> Array:
    """Return the numbers of an array in a shape, -1 being any length above 0; raise ShpyTypeError if it has none."""
    try:
        array = np.asarray(entry)
        numbers = array.reshape(shape) if array.size and array.dtype.kind in "biuf" else None
    except ValueError:
        numbers = None
    if numbers is None:
        amount = f"{shape[0]} elements" if shape[0] >= 0 else "one or more elements"
        message = f"{reprlib.repr(entry)} in a domain is no array of {amount} of type {type}"
        raise ShpyTypeError(message, loc=here(), cure="(-1, 1), a range, or an array of numbers")
    _check_held(numbers.min(), numbers.max(), type, reprlib.repr(entry))
    return numbers


def _ends(entry: tuple[Any, ...], type: Type) -> tuple[Any, ...]:
    """Return the ends of a range and its scale; raise ShpyTypeError if it has none, or they are in the wrong order."""
    if len(entry) not in (2, 3) or not all(isinstance(end, float | int | np.number) for end in entry[:2]):
        raise ShpyTypeError(f"{entry!r} is no range", loc=here(), cure="(-1, 1)")
    low, high = entry[:2]
    if not np.isfinite(float(high) - float(low)):
        raise ShpyTypeError(f"{entry!r} is no range: its length is not finite", loc=here(), cure="(-1e30, 1e30)")
    if low > high:
        raise ShpyTypeError(
            f"{entry!r} is no range: its ends are in the wrong order", loc=here(), cure=f"({high}, {low})"
        )
    _check_held(low, high, type, repr(entry))
    return entry


def _check_held(low: Any, high: Any, type: Type, text: str) -> None:
    """Raise ShpyTypeError if numbers from `low` to `high` are more than an int type holds."""
    if not type.is_int:
        return
    limits = np.iinfo(np.int32 if type.base is Base.I else np.uint32)
    if not limits.min <= low <= high <= limits.max:
        raise ShpyTypeError(
            f"{text} in a domain is not in the range of type {type}", loc=here(), cure=f"({limits.min}, {limits.max})"
        )


def _within(entry: Any, values: Array) -> Array:
    """Return which special values are in the domain's range, (n,) bools; an array or a function adds none."""
    if not isinstance(entry, tuple):
        return np.zeros(len(values), np.bool_)
    if values.dtype == np.bool_:
        return np.ones(len(values), np.bool_)
    low, high = entry[:2]
    with np.errstate(invalid="ignore"):
        return np.asarray((values >= low) & (values <= high))


def _shaped(program: Program, domain: Domain, arrays: dict[str, Array]) -> tuple[Any, ...]:
    inputs = []
    for name, layout in program.recorded.inputs.items():
        if isinstance(layout, TableType | TextureType):
            inputs.append(domain[name])
        else:
            inputs.append(build_arrays(layout, iter([arrays[leaf] for leaf, _, _ in leaves(layout, name)])))
    return tuple(inputs)
