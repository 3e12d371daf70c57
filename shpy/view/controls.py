"""Params as controls: sliders, colour pickers and switches, described by values that JSON can hold.

Stage: view. A control has `name`, `title`, `description`, `form`, the `first` and the current `value` as lists of
components, and for numbers `range` and `step`. If a Param has no range, the slider covers a guess around its value.

    controls = Controls(program.params)
    controls.describe()             # [{"name": "sea_level", "form": "number", "value": [0.02], …}]
    controls.assign({"sea_level": [0.1]})
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

import numpy as np

from shpy.errors import ShpyError
from shpy.lang.data.params import Param
from shpy.lang.values.value import Value

_STEPS: Final = 200
"""The number of steps of a slider whose Param has no step."""


class Controls:
    """The controls of a program's Params; dependent uniforms, matrices, structs, and Params with title="" have none."""

    def __init__(self, params: Mapping[str, Any]) -> None:
        single = {n: p for n, p in params.items() if isinstance(p, Param) and isinstance(p, Value)}
        self._params = {n: p for n, p in single.items() if p.title != ""}
        self.first = self.values()
        """The values that the file gives."""

    def values(self) -> dict[str, list[Any]]:
        """Return the current values by name, each a list of components."""
        return {name: np.atleast_1d(param.value).tolist() for name, param in self._params.items()}

    def describe(self) -> list[dict[str, Any]]:
        """Return the current controls."""
        return [{**_described(name, param), "first": self.first[name]} for name, param in self._params.items()]

    def assign(self, values: Mapping[str, Any]) -> list[str]:
        """Set Params by name, None to their first value; return a message for each Param that refuses its value.

        A page may send the values of an earlier version of the file, whose Params had other names, sizes and ranges, so
        unknown names are ignored.
        """
        refused = []
        for name, value in values.items():
            param = self._params.get(name)
            if param is None:
                continue
            try:
                param.value = _typed(param, self.first[name] if value is None else value)
            except (ShpyError, TypeError, ValueError, OverflowError) as error:
                refused.append(getattr(error, "message", str(error)))
        return refused

    @contextmanager
    def at(self, values: Mapping[str, Any]) -> Iterator[None]:
        """Give Params other values inside the block."""
        before = self.values()
        self.assign(values)
        try:
            yield
        finally:
            self.assign(before)


def _described(name: str, param: Any) -> dict[str, Any]:
    value = np.atleast_1d(param.value)
    description = {
        "name": name,
        "title": param.title or name,
        "description": param.description,
        "value": value.tolist(),
        "form": _form(param),
    }
    if description["form"] in ("number", "color"):
        low, high = param.range or _guess(value)
        whole = not param.type.is_float
        step = param.step or (1 if whole else _round_step((high - low) / _STEPS))
        description |= {"range": [low, high], "step": step, "whole": whole, "bounded": param.range is not None}
    return description


def _form(param: Any) -> str:
    if param.type.is_bool:
        return "switch"
    low, high = param.range or (0, 1)
    within = bool(np.all((np.asarray(param.value) >= 0) & (np.asarray(param.value) <= 1)))
    is_color = param.kind == "Color" and param.type.size >= 3 and param.type.is_float
    return "color" if is_color and within and (low, high) == (0, 1) else "number"


def _guess(value: Any) -> tuple[float, float]:
    """Return a range for a Param without one: 0 to twice the largest number, and as far below 0 if one is negative."""
    numbers = np.asarray(value, float)
    numbers = numbers[np.isfinite(numbers)]
    most = float(np.abs(numbers).max(initial=0)) or 0.5
    high = max(2 * most, 1.0) if most == round(most) else 2 * most
    return (-high if bool((numbers < 0).any()) or not numbers.any() else 0.0), high


def _round_step(step: float) -> float:
    """Return the power of ten at or below a step."""
    return float(10.0 ** math.floor(math.log10(step))) if step > 0 else 0.01


def _typed(param: Any, value: Any) -> Any:
    """Return a list of components converted to a value that the Param accepts."""
    parts = value if isinstance(value, list) else [value]
    if param.type.is_bool:
        parts = [bool(part) for part in parts]
    elif not param.type.is_float:
        parts = [round(part) for part in parts]
    return parts if param.type.size > 1 else parts[0]
