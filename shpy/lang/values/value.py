"""Values: the values of a program. The base of all scalar and vector types of the language.

Stage: record. Inside a recording a value is a slot: each use loads it, each operator makes a new one, and in-place
stores change it for every name bound to it, as numpy arrays do. Outside a recording a value is a constant.

    z = sh.Attrib2f(0, 0)
    z[:] = z + c            # a store: every name bound to z sees it
    w = z + c               # a new value
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, NoReturn

import numpy as np
from numpy.typing import NDArray

from shpy.errors import RecordError, ShpyAttributeError, ShpyIndexError, ShpyTypeError
from shpy.ir.constants import encode, to_array
from shpy.ir.types import SIZES, vec
from shpy.lang.mistakes.aliases import check_store
from shpy.lang.mistakes.foreign import value_cure
from shpy.lang.mistakes.statements import check_none
from shpy.lang.recording.location import here, on_one_line, user_frame
from shpy.lang.recording.pickling import cannot_travel
from shpy.lang.recording.recorder import Frame, current_frame
from shpy.lang.recording.symbolic import Symbolic
from shpy.lang.values import arithmetic
from shpy.lang.values.abstract import CLASSES as CLASSES, AbstractValue, Part
from shpy.lang.values.coerce import Literal, sequence
from shpy.lang.values.dependent import follower

_SETS = ("xyzw", "rgba", "stpq")

_Binary = Callable[[Any, Any], Any]


def _operator(op: str, what: str) -> tuple[_Binary, _Binary, _Binary]:
    """Return the method of an operator, of its reflected form and of its form in place: `x + y`, `2 + x`, `x += y`."""

    def plain(self: Any, other: Any, modulus: Any = None) -> Any:  # Python's pow gives the third
        if modulus is not None:
            raise ShpyTypeError("pow takes a base and an exponent", loc=here(), cure="(x ** y) % modulus")
        return self._binary(op, other, what)

    def reflected(self: Any, other: Any) -> Any:
        return self._binary(op, other, what, True)

    def in_place(self: Any, other: Any) -> Any:
        return self._inplace(op, other, what)

    return plain, reflected, in_place


def _unary(op: str, what: str) -> Callable[[Any], Any]:
    return lambda self: self._unary(op, what)


class Value(AbstractValue, Symbolic):
    """A scalar or vector. Made by the constructors `Attrib1f`, `Point3f`, …; see docs for the rules.

    Raises ShpyTypeError where components do not add up or types do not mix, RecordError for stores that cannot be.
    """

    __slots__ = ()
    __array_ufunc__: ClassVar[None] = None
    __hash__ = None  # type: ignore[assignment]

    def __new__(cls, *components: Any) -> Any:
        """Make an object that follows the Params among the components, outside of a program."""
        follows = current_frame() is None and any(map(_follows, components))
        return object.__new__(follower(CLASSES[cls.kind, cls.size, cls.base]) if follows else cls)  # type: ignore[arg-type]

    def __init__(self, *components: Any) -> None:
        self._compose(components)

    @on_one_line
    def _compose(self, components: tuple[Any, ...]) -> None:
        """Become a value of these components, which are scalars, vectors and numbers."""
        if not hasattr(type(self), "kind"):
            raise ShpyTypeError("Value is not a type of the language", loc=here(), cure="sh.Attrib1f(x), for example")
        frame = current_frame()
        parts = [p for c in components for p in arithmetic.parts(type(self), c)]
        literals = [p for p in parts if isinstance(p, Literal)]
        if parts and len(literals) == len(parts):
            const = arithmetic.constant(self.type, literals, type(self))
            self._become(frame, const=const)
        elif not parts:
            if components:
                raise arithmetic.count_error(type(self), 0)
            self._become(frame, const=encode(self.type, [0] * self.size))
            if frame is not None:
                frame.unset.add(self._variable)
        else:
            emitter = arithmetic.emitter_of(*parts)
            self._become(frame, emitter, arithmetic.assemble(emitter, self.type, parts, type(self)))

    def __reduce__(self) -> Any:
        if self._frame is not None:
            raise cannot_travel(
                f"a value of {self._frame.recording.name}",
                "the program is being recorded, and the value is known only when it runs",
                "an output of the program, whose arrays travel",
            )
        return _constant, (CLASSES[self.kind, self.size, self.base], self._const)

    # Reading

    def copy(self) -> Any:
        """Return a new value of the same type that holds the same."""
        return CLASSES[self.kind, self.size, self.base](self)

    def __getattr__(self, name: str) -> Any:
        picked = _swizzle(name, self.size)
        if picked is None and hasattr(type(self), name):
            object.__getattribute__(
                self, name
            )  # a property that ended in an AttributeError of its own: raise that again
        if picked is None:
            raise self._no_attribute(name)
        return self._pick(picked, f".{name}")

    def _no_attribute(self, name: str) -> AttributeError:
        """Return the error for a name that is no component, with the cure for a method of another library."""
        text = f"{type(self).__name__!r} object has no attribute {name!r}"
        if name.startswith("_"):
            return AttributeError(text, name=name, obj=self)
        called = "v" if self._frame is None else self._frame.names[self._variable] or "v"
        cure = value_cure(name, called)
        if cure is None and any(set(name) <= set(letters) for letters in _SETS) and len(name) <= 4:
            text = f"{type(self).__name__} has no component {name!r}"
        if self.size == 1 and name in ("sum", "mean", "max", "min", "prod"):
            cure = "the value itself, which is one component"
        sets = " or ".join(letters[: self.size] for letters in _SETS)
        return ShpyAttributeError(text, loc=here(), cure=cure or f"components of {sets}, of one set, up to four")

    @on_one_line
    def _pick(self, picked: tuple[int, ...], spelled: str) -> Any:
        emitter = arithmetic.emitter_of(self)
        type_ = vec(self.base, len(picked))
        read = self._read(emitter)
        identity = picked == tuple(range(self.size))
        if identity:
            handle = read
        elif self.size == 1:
            handle = emitter.let("splat", (read,), type_)
        else:
            handle = emitter.let("swizzle", (read,), type_, picked)
        return self._part_read(arithmetic.make_value("Attrib", type_, emitter, handle), spelled)

    def _part_read(self, part: Any, spelled: str) -> Any:
        if self._part is None:
            return part._read_from(f"{self._called()}{spelled}")
        owner = "constant" if self._part.owner == "constant" else "vector"
        return part._read_from(_within(self._part, spelled), owner)

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, Value):
            arithmetic.check_index(key)
            emitter = arithmetic.emitter_of(self, key)
            if self.size == 1:
                return self.copy()
            handle = emitter.let("component", (self._read(emitter), arithmetic.index(emitter, key)), self.type.scalar)
            return self._part_read(arithmetic.make_value("Attrib", self.type.scalar, emitter, handle), "[i]")
        if isinstance(key, slice) and key == slice(None):
            return self._part_read(self.copy(), "[:]")
        return self._pick(_components(key, self.size), f"[{_spell(key)}]")

    def __len__(self) -> int:
        if self.size == 1:
            raise ShpyTypeError(
                f"{type(self).__name__} is one component and has no len()", loc=here(), cure="1, or a vector"
            )
        return self.size

    def __iter__(self) -> Iterator[Any]:
        if self.size == 1:
            raise ShpyTypeError(
                f"{type(self).__name__} is one component and cannot be iterated over",
                loc=here(),
                cure="the value itself; with SH_FOR(n) as i: for a loop at run time",
            )
        return (self[i] for i in range(self.size))

    def __contains__(self, item: object) -> bool:
        raise RecordError("`in` needs a value that is known now", loc=here(), cure="sh.any(v == x)")

    # Storing

    def __setattr__(self, name: str, value: Any) -> None:
        picked = _swizzle(name, self.size)
        if picked is None:
            if name == "value":
                object.__setattr__(self, name, value)  # a Param's property
                return
            raise self._no_attribute(name)
        self._store(value, picked, f".{name}")

    def __setitem__(self, key: Any, value: Any) -> None:
        if isinstance(key, Value):
            arithmetic.check_index(key)
            for i in range(self.size):
                chosen = arithmetic.select(key == i, value, self[i])
                self._store(chosen, (i,), "[i]")
            return
        if isinstance(key, slice) and key == slice(None):
            self._store(value, None, "[:]")
            return
        self._store(value, _components(key, self.size), f"[{_spell(key)}]")

    @on_one_line
    def _store(self, value: Any, picked: tuple[int, ...] | None, spelled: str) -> None:
        frame = self._storable(spelled)
        check_store(frame, self, value if picked is None else None)
        if picked is not None and len(set(picked)) != len(picked):
            raise RecordError(f"{spelled} stores one component twice", loc=here(), cure="name each component once")
        size = self.size if picked is None else len(picked)
        handle = arithmetic.convert(frame, value, vec(self.base, size), f"a store into {self._called()}")
        whole = picked is None or picked == tuple(range(self.size))
        frame.store(self._variable, handle, None if whole else picked)

    def _storable(self, spelled: str) -> Frame:
        """Return the frame to store in; errors for constants, parts that are copies, and values of other recordings."""
        if self._frame is None:
            raise RecordError(
                f"a constant cannot be stored into: it was made outside of the program as {type(self).__name__}",
                loc=here(),
                cure="a copy inside the program, y = x.copy()",
            )
        frame = current_frame()
        self._check(frame)
        assert frame is not None
        loc = here()
        part = self._part
        if part is not None and frame.names[self._variable] is None and loc == self._loc and not _is_held(self):
            raise RecordError(
                f"{part.name} is a copy, so a store into {part.name}{spelled} would be lost",
                loc=loc,
                cure=_direct(part, spelled),
            )
        return frame

    # Operators

    __neg__ = _unary("neg", "-")
    __abs__ = _unary("abs", "abs")
    __invert__ = _unary("not", "~")

    __add__, __radd__, __iadd__ = _operator("add", "+")
    __sub__, __rsub__, __isub__ = _operator("sub", "-")
    __mul__, __rmul__, __imul__ = _operator("mul", "*")
    __truediv__, __rtruediv__, __itruediv__ = _operator("div", "/")
    __floordiv__, __rfloordiv__, __ifloordiv__ = _operator("floordiv", "//")
    __mod__, __rmod__, __imod__ = _operator("floormod", "%")
    __pow__, __rpow__, __ipow__ = _operator("pow", "**")
    __and__, __rand__, __iand__ = _operator("and", "&")
    __or__, __ror__, __ior__ = _operator("or", "|")
    __xor__, __rxor__, __ixor__ = _operator("xor", "^")
    __lshift__, __rlshift__, __ilshift__ = _operator("shl", "<<")
    __rshift__, __rrshift__, __irshift__ = _operator("shr", ">>")

    __lt__ = _operator("lt", "<")[0]
    __le__ = _operator("le", "<=")[0]
    __gt__ = _operator("gt", ">")[0]
    __ge__ = _operator("ge", ">=")[0]
    __eq__ = _operator("eq", "==")[0]
    __ne__ = _operator("ne", "!=")[0]

    def _unary(self, op: str, what: str) -> Any:
        return arithmetic.elementwise(op, (self,), what)

    def _binary(self, op: str, other: Any, what: str, reflected: bool = False) -> Any:
        if not arithmetic.is_operand(other):
            if other is None:
                check_none(here())
            if op not in ("eq", "ne") or isinstance(other, complex):
                arithmetic.refuse_operand(other, what)
            return NotImplemented
        return arithmetic.binary(op, other, self, what) if reflected else arithmetic.binary(op, self, other, what)

    def __matmul__(self, other: Any) -> Any:
        if arithmetic.is_operand(other):
            raise ShpyTypeError(
                "@ is the product of matrices, and neither side is one", loc=here(), cure="sh.dot(a, b), or a * b"
            )
        arithmetic.refuse_operand(other, "@")
        return NotImplemented

    __rmatmul__ = __matmul__

    def _inplace(self, op: str, other: Any, what: str) -> Any:
        if not arithmetic.is_operand(other):
            arithmetic.refuse_operand(other, what)
            return NotImplemented
        return self._keep(arithmetic.binary(op, self, other, what), what)

    def __imatmul__(self, other: Any) -> Any:
        return self._keep(self @ other, "@")

    def _keep(self, value: Any, what: str) -> Any:
        """Store what `x += v`, or another such operator, has computed."""
        if self._part is None:
            self._store(value, None, f" {what}= …")
            return self
        # A part read from x keeps its own slot; `x.xy += v` then stores it back through x.
        frame = current_frame()
        self._check(frame)
        assert frame is not None
        frame.store(self._variable, arithmetic.convert(frame, value, self.type, f"{what}="))
        return self

    def __pos__(self) -> Any:
        return self.copy()

    def __round__(self, digits: int | None = None) -> Any:
        self._asked("round")

    def __bool__(self) -> bool:
        if self._frame is not None:
            self._asked("bool")
        if self.size != 1:
            raise TypeError(f"{type(self).__name__} has several components: sh.any(v) or sh.all(v)")
        return bool(self._now())

    def __int__(self) -> int:
        return int(self._host("int"))

    def __float__(self) -> float:
        return float(self._host("float"))

    def __index__(self) -> int:
        if self._frame is None and not self.type.is_int:
            raise TypeError(f"{type(self).__name__} cannot be an index")
        return int(self._host("index"))

    def _asked(self, kind: str) -> NoReturn:
        from shpy.lang.mistakes.explain import refuse  # here: importing shpy records nothing

        refuse(self, kind)

    def _host(self, kind: str) -> Any:
        if self._frame is not None:
            self._asked(kind)
        if self.size != 1:
            raise TypeError(f"{type(self).__name__} has {self.size} components")
        return self._now()[()]

    def _now(self) -> NDArray[Any]:
        """Return the present value of a constant or uniform, of shape () or (size,)."""
        return to_array(self.type, self._const)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        if self._frame is not None:
            self._asked("array")
        array = self._now()
        return array if dtype is None else array.astype(dtype)

    def __format__(self, spec: str) -> str:
        if not spec:
            return repr(self)
        if self._frame is not None:
            raise ShpyTypeError(
                f"{self._called()} has no digits while the program is recorded",
                loc=here(),
                cure="program.trace(…), which shows values as the program runs, or an output",
            )
        return format(np.asarray(self)[()], spec)

    def __trunc__(self) -> int:
        return int(self._host("trunc"))

    def __divmod__(self, other: Any) -> Any:
        return self // other, self % other

    def __rdivmod__(self, other: Any) -> Any:
        return other // self, other % self

    def __repr__(self) -> str:
        if self._frame is None:
            return f"{type(self).__name__}({', '.join(map(str, np.atleast_1d(np.asarray(self)).tolist()))})"
        return f"<{type(self).__name__} {self._called()}>"


def with_article(cls: type) -> str:
    """Return the name of a class with the article of its first letter: an Attrib3f, a Color3f."""
    return f"{'an' if cls.__name__[:1] in 'AEIOU' else 'a'} {cls.__name__}"


def _follows(x: Any) -> bool:
    """Return whether a component is a uniform, or a tuple, list or array with one."""
    if isinstance(x, AbstractValue):
        return x._uniform
    entries = sequence(x)
    return entries is not None and any(map(_follows, entries))


def _constant(cls: type[Value], const: tuple[int, ...]) -> Value:
    """Return the constant that another process sent."""
    value = object.__new__(cls)
    value._become(None, const=const)
    return value


def _swizzle(name: str, size: int) -> tuple[int, ...] | None:
    if not 1 <= len(name) <= 4:
        return None
    for letters in _SETS:
        if all(c in letters for c in name):
            picked = tuple(letters.index(c) for c in name)
            return picked if max(picked) < size else None
    return None


def _components(key: Any, size: int) -> tuple[int, ...]:
    """Return the components that a constant index, slice or tuple names; ShpyIndexError out of range."""
    if isinstance(key, slice):
        picked = tuple(range(size)[key])
        if not picked:
            raise ShpyIndexError(
                f"[{_spell(key)}] picks none of {size} components", loc=here(), cure=f"a slice of 0 to {size}"
            )
        return _counted(picked)
    keys = key if isinstance(key, tuple) else (key,)
    if any(isinstance(k, Value) for k in keys):
        raise ShpyTypeError("components of a list are constants", loc=here(), cure="one index at a time, x[i]")
    try:
        indices = [operator.index(k) for k in keys]
    except TypeError:
        text = "a component is named by an int or a letter"
        raise ShpyTypeError(text, loc=here(), cure="v[0], v[0:2] or v.x") from None
    for i in indices:
        if not -size <= i < size:
            raise ShpyIndexError(f"component {i} of {size}", loc=here(), cure=f"0 to {size - 1}")
    return _counted(tuple(i % size for i in indices))


def _counted(picked: tuple[int, ...]) -> tuple[int, ...]:
    """Return components that make a scalar or vector; ShpyIndexError for any other number of them."""
    if len(picked) not in SIZES:
        picks = f"{len(picked)} components are picked, and a vector has one to four"
        raise ShpyIndexError(picks, loc=here(), cure="v[0, 2], or several vectors")
    return picked


def _spell(key: Any) -> str:
    if isinstance(key, slice):
        return ":".join("" if k is None else str(k) for k in (key.start, key.stop))
    return ", ".join(map(str, key)) if isinstance(key, tuple) else str(key)


def _is_held(value: Value) -> bool:
    """Return whether a name of the user's function, or a field of the struct that it names, holds this value."""
    frame = user_frame()
    things = [] if frame is None else list(frame.f_locals.values())
    for thing in things:  # the list grows meanwhile
        things += [getattr(thing, name, None) for name in getattr(type(thing), "_shpy_fields", ())]
    return any(thing is value for thing in things)


def _within(part: Part, spelled: str) -> str:
    """Spell a part of a part: the entry `m[0, 1]` of the row `m[0]`."""
    entry = part.owner == "matrix" and spelled[0] == "[" and ":" not in spelled and "," not in spelled
    return f"{part.name[:-1]}, {spelled[1:]}" if entry else f"{part.name}{spelled}"


def _direct(part: Part, spelled: str) -> str:
    """Return the statements that do what a store into a copy was meant to do."""
    if part.owner == "constant":
        return f"y = {part.name}, and y{spelled} = …"
    direct = _within(part, spelled)
    if direct != f"{part.name}{spelled}":
        return f"{direct} = …"
    owner, dot, letters = part.name.rpartition(".")
    if part.owner == "vector" and dot and spelled[1:-1].isdigit() and int(spelled[1:-1]) < len(letters):
        return f"{owner}.{letters[int(spelled[1:-1])]} = …"
    if part.owner == "vector" and part.name.endswith("[:]"):
        return f"{part.name[:-3]}{spelled} = …"
    return f"{part.name} = …, with the whole value"
