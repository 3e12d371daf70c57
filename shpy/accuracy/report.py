"""Measured errors as a table, a picture and JSON.

Stage: measure. Holds the rows of `measure`, one for each output of each variant.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.errors import ShpyError
from shpy.lang.recording.location import here
from shpy.passes.modes import mode_name
from shpy.pictures.outputs import new_figure, save_figure

Array = NDArray[Any]

BINS = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 64.0, 256.0, 4096.0, 65536.0, 2.0**20)
"""Upper ends of the histogram's bins, in ULP; a last bin holds all larger errors."""


LARGE = 16.0
"""ULP; strict results that are further off have lost more than one of their seven digits."""


def pointer(math: str | None, precision: str, errors: float, output: str) -> str | None:
    """Return a line that points to `roundings`, None where these are not of a large error in strict mode at f32."""
    if math != "strict" or precision != "f32" or errors <= LARGE:
        return None
    call = f"sh.accuracy.roundings(program, domain{output})"
    return f"more than {LARGE:g} ULP: {call}, or shpy accuracy --lines, names the lines"


@dataclass(frozen=True)
class Row:
    """The errors of one output of one variant, over the elements inside the domain.

    `ulp` and `relative` are (max, 99th percentile, median). `worst` is the input of the largest error, with the
    computed and the exact result. `histogram` counts elements up to each of BINS, and beyond. Outside the domain,
    `edges` of the `specials` special values are off by more than inside, and by more than 4 ULP. `flushed` elements
    meet a denormal on a device that flushes them, and are not counted.
    """

    backend: str
    math: str | None
    precision: str
    output: str
    count: int
    ulp: tuple[float, float, float]
    relative: tuple[float, float, float]
    worst: dict[str, Any]
    found: Any
    exact: Any
    histogram: tuple[int, ...]
    specials: int
    edges: int
    edge: dict[str, Any] | None
    flushed: int
    fuse: bool
    errors: Array = field(repr=False, compare=False)
    """Each element's error in ULP, (n,); NaN for those that are not counted."""


@dataclass(frozen=True)
class Report:
    """The rows, what was `skipped` and why, and the inputs that all were measured on."""

    program: str
    reference: str
    rows: tuple[Row, ...]
    skipped: tuple[tuple[str, str], ...]
    inputs: dict[str, dict[str, Array]] = field(repr=False)
    """By precision, then by name."""

    def table(self) -> str:
        """Return the rows as text: errors in ULP (max, 99 %, median), the largest relative error, the worst input."""
        head = (
            "backend",
            "math",
            "precision",
            "output",
            "max ULP",
            "99 %",
            "median",
            "relative",
            "edges",
            "worst input",
        )
        body = [
            (
                row.backend,
                mode_name(row.math or "·", row.fuse),
                row.precision,
                row.output,
                *(f"{v:.3g}" for v in row.ulp),
                f"{row.relative[0]:.2g}",
                f"{row.edges}/{row.specials}",
                ", ".join(f"{n}={_short(v)}" for n, v in row.worst.items()),
            )
            for row in self.rows
        ]
        lines = [f"{self.program}, against {self.reference}", *columns([head, *body], left=(0, 1, 2, 3, 9))]
        lines += [f"  not measured: {what}: {why}" for what, why in self.skipped]
        lines += dict.fromkeys(f"  {p}" for p in map(self._pointer, self.rows) if p is not None)
        return "\n".join(lines)

    def _pointer(self, row: Row) -> str | None:
        """Return a line that points to `roundings`, which is for outputs of one float of inputs of floats."""
        moving = any(x.dtype.kind == "f" for x in self.inputs[row.precision].values())
        name = f", output={row.output!r}" if len({r.output for r in self.rows}) > 1 else ""
        return pointer(row.math, row.precision, row.ulp[0], name) if moving and isinstance(row.found, float) else None

    def __str__(self) -> str:
        return self.table()

    def json(self) -> dict[str, Any]:
        """Everything but the single elements, for `json.dump`."""
        rows = []
        for row in self.rows:
            fields = {k: v for k, v in asdict(row).items() if k != "errors"}
            rows.append({**fields, "bins": [*BINS, None]})
        return {"program": self.program, "reference": self.reference, "rows": rows, "skipped": list(self.skipped)}

    def plot(self, path: str | Path) -> None:
        """Draw errors against the first input, and their distribution, one line of pictures for each output.

        Writes JSON of the same name beside it. Raises ShpyError without matplotlib, without rows, or for a path that
        is no picture.
        """
        if not self.rows:
            reason = self.skipped[0][1] if self.skipped else None
            raise ShpyError(f"no variant of {self.program} was measured", loc=here(), cure=reason)
        outputs = list(dict.fromkeys(row.output for row in self.rows))
        figure = new_figure(12, 4 * len(outputs))
        axes = figure.subplots(len(outputs), 2, squeeze=False)
        for (left, right), output in zip(axes, outputs, strict=True):
            for row in (r for r in self.rows if r.output == output):
                label = " ".join([row.backend, mode_name(row.math or "·", row.fuse), row.precision])
                shown = np.clip(row.errors, 2**-10, 1e9)
                name, along = self._along(row)
                left.plot(along, shown, ".", markersize=2, label=label)
                ordered = np.sort(shown[np.isfinite(shown)])
                right.plot(ordered, np.linspace(0, 100, len(ordered)), label=label)
                left.set_xscale("symlog" if _wide(along[np.isfinite(row.errors)]) else "linear")
            left.set(yscale="log", xlabel=name, ylabel=f"{output}: error in ULP")
            right.set(xscale="log", xlabel="error in ULP", ylabel="% of elements up to it")
            right.legend()
        figure.suptitle(f"{self.program}, against {self.reference}")
        save_figure(figure, Path(path), self.json())

    def _along(self, row: Row) -> tuple[str, Array]:
        """Return the name and values of the axis that errors are drawn along: the first input, or its length."""
        for name, array in self.inputs[row.precision].items():
            wide = array.astype(np.float64)
            return name, wide if wide.ndim == 1 else np.linalg.norm(wide, axis=1)
        return "element", np.arange(float(len(row.errors)))


def _wide(numbers: Array) -> bool:
    """Return True if numbers are spread over many powers of ten."""
    sizes = np.abs(numbers[np.isfinite(numbers) & (numbers != 0)])
    return bool(sizes.size) and bool(np.quantile(sizes, 0.9) > 100 * np.quantile(sizes, 0.1))


def columns(rows: Sequence[Sequence[str]], left: Iterable[int] = ()) -> list[str]:
    """Return rows of texts as aligned lines: columns in `left` to the left, the others to the right."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    keep = set(left)

    def line(row: Sequence[str]) -> str:
        cells = (t.ljust(w) if k in keep else t.rjust(w) for k, (t, w) in enumerate(zip(row, widths, strict=True)))
        return "  ".join(cells).rstrip()

    return [line(row) for row in rows]


def _short(value: Any) -> str:
    array = np.asarray(value)
    texts = [f"{v:.9g}" if array.dtype.kind == "f" else str(v) for v in array.ravel().tolist()]
    return texts[0] if array.ndim == 0 else f"({', '.join(texts)})"
