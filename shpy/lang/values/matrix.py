"""Matrices: rows of vectors. The IR knows only the rows.

Stage: record. `m @ v` sums products from the first column on; a Point takes w = 1, a Vector w = 0, a Normal the inverse
transpose of the upper 3x3.

>>> import shpy as sh, numpy as np
>>> np.asarray(sh.Matrix2f((1, 2), (3, 4)) @ sh.Attrib2f(1, 1)).tolist()
[3.0, 7.0]
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from shpy.errors import ShpyAttributeError, ShpyIndexError, ShpyTypeError
from shpy.ir.constants import is_int
from shpy.ir.types import Base, vec
from shpy.lang.recording.location import here
from shpy.lang.recording.recorder import current_frame
from shpy.lang.recording.symbolic import Symbolic
from shpy.lang.values import builtins
from shpy.lang.values.arithmetic import check_index, check_width, refuse_operand
from shpy.lang.values.coerce import literal, sequence
from shpy.lang.values.dependent import name_parts
from shpy.lang.values.value import CLASSES, Value

_ROWS = "matrices of one size, or a number; m[r] += v changes one row"


class Matrix(Symbolic):
    """N x N floats, N = 2 to 4. Constructors take rows (or nothing: the identity); `m[r]` is a row, `m[r, c]` an entry.

    Raises ShpyTypeError where rows or operands have other sizes.
    """

    __slots__ = ("rows",)
    __array_ufunc__: ClassVar[None] = None
    __hash__ = None  # type: ignore[assignment]
    size: ClassVar[int]

    rows: tuple[Value, ...]

    def __init_subclass__(cls) -> None:
        """Read the size from the class's name."""
        cls.size = int(cls.__name__[-2])

    def __init__(self, *rows: Any) -> None:
        n = self.size
        if not rows:
            rows = tuple(tuple(float(r == c) for c in range(n)) for r in range(n))
        elif len(rows) == 1:
            rows = self._rows_of(rows[0])
        elif len(rows) == n * n:
            rows = tuple(tuple(rows[r * n : r * n + n]) for r in range(n))
        if len(rows) != n:
            raise ShpyTypeError(
                f"{type(self).__name__} takes {n} rows of {n}, not {len(rows)}",
                loc=here(),
                cure=f"sh.{type(self).__name__}(row0, row1, …)",
            )
        row_values = tuple(self._row_type()(r) for r in rows)
        object.__setattr__(self, "rows", row_values)
        frame = current_frame()
        if frame is not None:
            frame.name_parts({str(r): row._variable for r, row in enumerate(row_values)}, "{}[{}]")
        else:
            name_parts({f"[{r}]": row for r, row in enumerate(row_values)})

    def __reduce__(self) -> Any:
        return self._plain().of_rows, (self.rows,)

    @classmethod
    def for_store(cls, source: Any, what: str) -> Matrix:
        """Return a matrix, or rows, as a matrix. Raises ShpyTypeError for binary64, which a store would narrow."""
        for row in source if isinstance(source, tuple | list) else ():
            for entry in row if isinstance(row, tuple | list) else (row,):
                if isinstance(entry, Value) and entry.base is Base.D:
                    check_width(entry, vec(Base.F, entry.size), what)
        return cls(source)

    @classmethod
    def _plain(cls) -> type[Matrix]:
        """Return the matrix type for results: a Param's class derives from one, but its results are no Params."""
        return MATRICES[cls.__name__]

    def _rows_of(self, argument: Any) -> tuple[Any, ...]:
        """Return the rows of one argument, a matrix or a sequence of rows; raise ShpyTypeError for a single number."""
        if literal(argument) is not None or isinstance(argument, Value) or not isinstance(argument, Iterable):
            name = f"sh.{type(self).__name__}"
            raise ShpyTypeError(
                f"{type(self).__name__} takes rows, not one {type(argument).__name__}",
                loc=here(),
                cure=f"{name}() for the identity, {name}() * x for a multiple of it",
            )
        return tuple(argument.rows if isinstance(argument, Matrix) else argument)

    def __getattr__(self, name: str) -> Any:
        text = f"{type(self).__name__!r} object has no attribute {name!r}"
        if name.startswith("_"):
            raise AttributeError(text, name=name, obj=self)
        spoken = {"T": "transpose", "inv": "inverse", "det": "determinant", "invert": "inverse"}.get(name, name)
        is_function = spoken in ("transpose", "inverse", "determinant")
        cure = (
            f"sh.{spoken}(m)"
            if is_function
            else "m[r] for a row, m[r, c] for an entry, sh.transpose(m)[c] for a column"
        )
        raise ShpyAttributeError(text, loc=here(), cure=cure)

    def _refuse(self, operator: str, other: Any, cure: str, *, reflected: bool = False) -> Any:
        """Raise ShpyTypeError for values, numbers and arrays; return NotImplemented for other objects."""
        if not (literal(other) is not None or isinstance(other, Value | Matrix | list | tuple | np.ndarray)):
            return NotImplemented
        sides = [type(self).__name__, type(other).__name__]
        left, right = reversed(sides) if reflected else sides
        raise ShpyTypeError(f"{left} {operator} {right} has no meaning", loc=here(), cure=cure)

    @classmethod
    def _row_type(cls) -> type[Value]:
        return CLASSES["Attrib", cls.size, Base.F]

    @classmethod
    def of_rows(cls, rows: Sequence[Value]) -> Any:
        """Make the matrix whose rows are these values themselves, not copies."""
        matrix = object.__new__(cls)
        object.__setattr__(matrix, "rows", tuple(rows))
        return matrix

    @classmethod
    def from_columns(cls, *columns: Any) -> Any:
        """Make the matrix with these columns."""
        return transpose(cls(*columns))

    def copy(self) -> Any:
        """Return a new matrix with the same entries."""
        return self._plain()(*self.rows)

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, tuple):
            row, column = self._pair(key, "sh.transpose(m)[c]")
            return self[row][column]
        if isinstance(key, slice) and key == slice(None):
            whole = self.copy()
            for r, (copy, row) in enumerate(zip(whole.rows, self.rows, strict=True)):
                self._marked(copy, row, f"m[{r}]")
            return whole
        if isinstance(key, Value):
            check_index(key)
            chosen = self.rows[-1]
            for i in reversed(range(self.size - 1)):
                chosen = builtins.cond(key <= i, self.rows[i], chosen)
            return chosen._read_from("m[i]", "matrix")
        row = self._row(key)
        return self._marked(row.copy(), row, f"m[{key}]")

    def _marked(self, copy: Value, row: Value, spelled: str) -> Any:
        """Let the copy of a row know what it was read from: a matrix, or what this line read the matrix from."""
        if row._frame is None:
            return copy._read_from(spelled, "constant")
        if row._part is not None and row._loc == here():
            return copy._read_from(*row._part)
        called = row._called()
        return copy._read_from(called if called.endswith("]") else spelled, "matrix")

    def _row(self, key: Any) -> Value:
        """Return the row of a known index. Raises ShpyIndexError out of range."""
        if not is_int(key):
            raise ShpyTypeError(f"{key!r} is no row of a {type(self).__name__}", loc=here(), cure="m[r], or m[r, c]")
        if not -self.size <= key < self.size:
            raise ShpyIndexError(f"row {key} of {self.size}", loc=here(), cure=f"0 to {self.size - 1}")
        return self.rows[key]

    def _pair(self, key: tuple[Any, ...], column: str) -> tuple[Any, ...]:
        """Return a row and a column; `column` is the cure for a whole column."""
        if len(key) != 2:
            raise ShpyTypeError(f"a matrix has 2 axes, not {len(key)}", loc=here(), cure="m[r], or m[r, c]")
        if isinstance(key[0], slice):
            raise ShpyTypeError("a matrix has rows, and no slices of them", loc=here(), cure=column)
        return key

    def __setitem__(self, key: Any, value: Any) -> None:
        if isinstance(key, tuple):
            row, column = self._pair(key, f"{', '.join(f'm[{r}, c]' for r in range(self.size))} = v")
            if isinstance(row, Value):
                check_index(row)
                for r, own in enumerate(self.rows):
                    own[column] = builtins.cond(row == r, value, own[column])
            else:
                self._row(row)[column] = value
        elif isinstance(key, Value):
            check_index(key)
            for r, own in enumerate(self.rows):
                own[:] = builtins.cond(key == r, value, own)
        elif isinstance(key, slice) and key == slice(None):
            fresh = self._plain().for_store(value, "a store into this matrix")
            for row, new in zip(self.rows, fresh.rows, strict=True):
                row[:] = new
        else:
            self._row(key)[:] = value

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def __len__(self) -> int:
        return self.size

    def __iter__(self) -> Iterator[Any]:
        return (self[i] for i in range(self.size))

    def _as_vector(self, other: Any) -> Any:
        """Return a tuple, list or 1-D array as a vector, other objects as they are; refuse other arrays."""
        entries = sequence(other)
        if entries is None and isinstance(other, np.ndarray):
            refuse_operand(other, "@")
        fits = entries is not None and ("Attrib", len(entries), Base.F) in CLASSES
        return CLASSES["Attrib", len(entries), Base.F](*entries) if entries is not None and fits else other

    def __matmul__(self, other: Any) -> Any:
        if isinstance(other, Matrix):
            self._same_size(other)
            return self._plain()(*(_combine(row, other.rows) for row in self.rows))
        other = self._as_vector(other)
        if not isinstance(other, Value) or other.size == 1:
            return self._refuse("@", other, "m * x, which multiplies each entry")
        return self._transform(other)

    def __rmatmul__(self, other: Any) -> Any:
        other = self._as_vector(other)
        if not isinstance(other, Value) or other.size != self.size:
            cure = f"a vector of {self.size} components on the left, or m * x, which multiplies each entry"
            return self._refuse("@", other, cure, reflected=True)
        return _combine(other, self.rows)

    def _transform(self, v: Value) -> Any:
        if v.kind == "Normal" and v.size == 3 and self.size in (3, 4):
            upper = self.size == 3
            linear = self if upper else Matrix3f(*(r.xyz for r in self.rows[:3]))
            turned = transpose(inverse(linear)) @ CLASSES["Attrib", 3, v.base](v)
            return CLASSES["Normal", 3, turned.base](turned)
        if v.kind in ("Point", "Vector") and v.size == self.size - 1:
            entries = [builtins.dot(r[: v.size], v) for r in self.rows[: v.size]]
            if v.kind == "Point":
                entries = [e + r[v.size] for e, r in zip(entries, self.rows, strict=False)]
            return CLASSES[v.kind, v.size, entries[0].base](*entries)
        if v.size != self.size:
            one_less = v.size == self.size - 1 and v.size > 1
            raise ShpyTypeError(
                f"{type(self).__name__} @ {type(v).__name__} has no meaning"
                + (": is it a place or a direction?" if one_less else f": it takes {self.size} components"),
                loc=here(),
                cure=f"sh.Point{v.size}f(v) (w = 1) or sh.Vector{v.size}f(v) (w = 0)"
                if one_less
                else f"a vector of {self.size} components, or a Point or Vector of {self.size - 1}",
            )
        entries = [builtins.dot(r, v) for r in self.rows]
        result = CLASSES["Attrib", self.size, entries[0].base](*entries)
        return CLASSES[v.kind, v.size, result.base](result) if v.kind != "Attrib" else result

    def _each(self, op: Any, other: Any) -> Any:
        if isinstance(other, Matrix):
            self._same_size(other)
            return self._plain()(*(op(a, b) for a, b in zip(self.rows, other.rows, strict=True)))
        if literal(other) is not None or (isinstance(other, Value) and other.size == 1):
            if isinstance(other, Value) and other.base is Base.D:  # no matrix holds f64
                check_width(other, vec(Base.F, 1), type(self).__name__)
            return self._plain()(*(op(a, other) for a in self.rows))
        return NotImplemented

    def _same_size(self, other: Matrix) -> None:
        if self.size != other.size:
            raise ShpyTypeError(
                f"{type(self).__name__} with {type(other).__name__}", loc=here(), cure="matrices of one size"
            )

    def _with(self, operator: str, op: Any, other: Any, cure: str, *, reflected: bool = False) -> Any:
        result = self._each(op, other)
        return self._refuse(operator, other, cure, reflected=reflected) if result is NotImplemented else result

    def __add__(self, other: Any) -> Any:
        return self._with("+", lambda a, b: a + b, other, _ROWS)

    def __radd__(self, other: Any) -> Any:
        return self._with("+", lambda a, b: b + a, other, _ROWS, reflected=True)

    def __sub__(self, other: Any) -> Any:
        return self._with("-", lambda a, b: a - b, other, _ROWS)

    def __rsub__(self, other: Any) -> Any:
        return self._with("-", lambda a, b: b - a, other, _ROWS, reflected=True)

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Matrix):
            raise ShpyTypeError("* of two matrices is not the matrix product here", loc=here(), cure="a @ b")
        return self._with("*", lambda a, b: a * b, other, "m @ v, the product of a matrix and a vector")

    def __rmul__(self, other: Any) -> Any:
        return self._with("*", lambda a, b: b * a, other, "v @ m, or m @ v", reflected=True)

    def __truediv__(self, other: Any) -> Any:
        return self._with("/", lambda a, b: a / b, other, "m @ sh.inverse(n), or a number as the divisor")

    def __rtruediv__(self, other: Any) -> Any:
        return self._refuse("/", other, "x * sh.inverse(m), or 1 / m[r, c] for each entry", reflected=True)

    def __pow__(self, other: Any) -> Any:
        return self._refuse("**", other, "m @ m for the square")

    def __eq__(self, other: object) -> Any:
        return self._refuse("==", other, f"sh.all(m[0] == n[0]) & … & sh.all(m[{self.size - 1}] == n[{self.size - 1}])")

    def __ne__(self, other: object) -> Any:
        return self._refuse("!=", other, f"sh.any(m[0] != n[0]) | … | sh.any(m[{self.size - 1}] != n[{self.size - 1}])")

    def __neg__(self) -> Any:
        return self._plain()(*(-r for r in self.rows))

    def _inplace(self, result: Any, what: str) -> Any:
        if result is NotImplemented:
            return result
        for row, new in zip(self.rows, self._plain()(result).rows, strict=True):
            row._keep(new, what)
        return self

    def __iadd__(self, other: Any) -> Any:
        return self._inplace(self + other, "+")

    def __isub__(self, other: Any) -> Any:
        return self._inplace(self - other, "-")

    def __imul__(self, other: Any) -> Any:
        return self._inplace(self * other, "*")

    def __itruediv__(self, other: Any) -> Any:
        return self._inplace(self / other, "/")

    def __imatmul__(self, other: Any) -> Any:
        return self._inplace(self @ other, "@")

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        array = np.stack([np.asarray(r) for r in self.rows])
        return array if dtype is None else array.astype(dtype)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(map(repr, self.rows))})"


class Matrix2f(Matrix):
    """Two rows of two floats."""

    __slots__ = ()


class Matrix3f(Matrix):
    """Three rows of three floats."""

    __slots__ = ()


class Matrix4f(Matrix):
    """Four rows of four floats."""

    __slots__ = ()


MATRICES: dict[str, type[Matrix]] = {c.__name__: c for c in (Matrix2f, Matrix3f, Matrix4f)}


def _combine(v: Value, rows: Sequence[Value]) -> Any:
    """Return the row vector v times the matrix with these rows."""
    total = v[0] * rows[0]
    for i, row in enumerate(rows[1:], 1):
        total = total + v[i] * row
    return total


def _matrix(m: Any, what: str) -> Matrix:
    if not isinstance(m, Matrix):
        raise ShpyTypeError(f"sh.{what} takes a matrix, not {type(m).__name__}", loc=here(), cure="sh.Matrix3f(…)")
    return m


def rows_of_array(array: Any, cls: type[Matrix], what: str) -> list[Any]:
    """Return the rows (*S, N) of an array of matrices (*S, N, N); ShpyTypeError naming `what` for other shapes."""
    size = cls.size
    if array.ndim < 2 or array.shape[-2:] != (size, size):
        count = math.prod(array.shape)
        cure = f"an array whose last two axes have {size} components each"
        if count and count % size**2 == 0:
            cure = f"np.asarray(m).reshape(-1, {size}, {size})"
        message = f"{what} is a {cls.__name__} and takes an array (*S, {size}, {size}), not {array.shape}"
        raise ShpyTypeError(message, loc=here(), cure=cure)
    return [array[..., r, :] for r in range(size)]


def transpose(m: Any) -> Any:
    """Return the transpose: rows for columns."""
    rows = _matrix(m, "transpose").rows
    return m._plain()(*(tuple(r[c] for r in rows) for c in range(m.size)))


def determinant(m: Any) -> Any:
    """Return the determinant, by cofactors of the first row."""
    _matrix(m, "determinant")
    return _cofactor_sum([[m[r, c] for c in range(m.size)] for r in range(m.size)])


def _cofactor_sum(entries: list[list[Any]]) -> Any:
    if len(entries) == 1:
        return entries[0][0]
    if len(entries) == 2:
        (a, b), (c, d) = entries
        return a * d - b * c
    total = None
    for column, entry in enumerate(entries[0]):
        minor = [row[:column] + row[column + 1 :] for row in entries[1:]]
        term = entry * _cofactor_sum(minor)
        total = term if total is None else total - term if column % 2 else total + term
    return total


def inverse(m: Any) -> Any:
    """Return the inverse, the adjugate over the determinant; infinite or NaN where that is zero."""
    n = _matrix(m, "inverse").size
    entries = [[m[r, c] for c in range(n)] for r in range(n)]

    def cofactor(r: int, c: int) -> Any:
        minor = [row[:c] + row[c + 1 :] for i, row in enumerate(entries) if i != r]
        value = _cofactor_sum(minor)
        return -value if (r + c) % 2 else value

    cofactors = [[cofactor(r, c) for c in range(n)] for r in range(n)]
    total = entries[0][0] * cofactors[0][0]
    for c in range(1, n):
        total = total + entries[0][c] * cofactors[0][c]
    return m._plain()(*(tuple(cofactors[c][r] / total for c in range(n)) for r in range(n)))
