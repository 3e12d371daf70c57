"""Subroutines, called with host objects that are equal, of equal identity or freed, are recorded for each of them."""

import math
import random
from dataclasses import dataclass

import numpy as np
import pytest

import shpy as sh


@dataclass
class Scale:
    by: float

    @sh.subroutine
    def shared(self, x: sh.Attrib1f) -> sh.Attrib1f:
        return 3 * x + self.by

    def alone(self, x):
        return 3 * x + self.by


def draw(rng, depth=0):
    """Return a function that makes a host object anew: many of the objects are equal and none is the same."""
    kinds = ("number", "number", "list", "tuple", "dict", "array", "record")
    match rng.choice(kinds if depth < 2 else ("number",)):
        case "number":
            value = rng.choice((0.0, -0.0, 1, 1.0, True, False, 0, 2, 2.5))
            return lambda: value
        case "list":
            parts = [draw(rng, depth + 1) for _ in range(rng.randint(0, 3))]
            return lambda: [part() for part in parts]
        case "tuple":
            parts = [draw(rng, depth + 1) for _ in range(rng.randint(1, 2))]
            return lambda: tuple(part() for part in parts)
        case "dict":
            parts = {name: draw(rng, depth + 1) for name in rng.sample("abc", 2)}
            return lambda: {name: part() for name, part in parts.items()}
        case "array":
            numbers, dtype = [rng.choice((0.0, -0.0, 1.0, 2.0)) for _ in range(2)], rng.choice(("f4", "f8", "i4"))
            return lambda: np.array(numbers, dtype)
    value = rng.choice((1.0, 2.0, 1))
    return lambda: Scale(value)


def digest(value):
    """A number that tells apart whatever recording may tell apart: types, signs of zeros, lengths and order."""
    match value:
        case bool():
            return 0.5 + value
        case int() | float():
            return 8.0 * value + math.copysign(0.25, value) + 0.125 * isinstance(value, int)
        case dict():
            return sum((k + 1) * (ord(name) + digest(part)) for k, (name, part) in enumerate(value.items()))
        case Scale():
            return 100 + digest(value.by)
        case np.ndarray():
            return sum((k + 2) * digest(float(n)) for k, n in enumerate(value)) + value.dtype.itemsize
    return sum((k + 3) * digest(part) for k, part in enumerate(value)) + 0.0625 * isinstance(value, tuple)


def fold(x: sh.Attrib1f, value) -> sh.Attrib1f:
    return 2 * x + digest(value)


shared_fold = sh.subroutine(fold)


def check(number):
    rng = random.Random(number)
    makers = [draw(rng) for _ in range(rng.randint(2, 4))]
    calls = [rng.choice(makers) for _ in range(6)]

    def recorded(call):
        @sh.program
        def program(x: sh.Attrib1f) -> sh.Attrib1d:
            total = sh.Attrib1d(0)
            for make in calls:  # what is made here is freed after the call
                total[:] = total * 3 + sh.Attrib1d(call(x, make()))
            return total

        return program

    found, expected = (recorded(f).compile("numpy")(np.float32([0, 1.5])) for f in (shared_fold, fold))
    np.testing.assert_array_equal(found, expected)


def test_equal_objects_are_not_the_same():
    for number in range(30):
        check(number)


@pytest.mark.slow
def test_many_equal_objects_are_not_the_same():
    for number in range(1000, 4000):
        check(number)


def test_methods_of_equal_instances():
    @sh.program
    def program(x: sh.Attrib1f):
        total = sh.Attrib1f(0)
        for by in (1.0, 2.0, 2.0, 3.0):
            total += Scale(by).shared(x) * by
        return total

    expected = sum((3 * 2 + by) * by for by in (1.0, 2.0, 2.0, 3.0))
    assert program.compile("numpy")(np.float32(2)) == expected
