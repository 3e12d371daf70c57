"""Dataclasses whose `__init__` is written when it is needed, beside those of the standard library."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pickle
import subprocess
import sys
import threading
from typing import Any

import pytest

from shpy_start.dataclass import dataclass

OPTIONS = [
    {**frozen, **eq, **slots, **keywords}
    for frozen in ({}, {"frozen": True})
    for eq in ({}, {"eq": False})
    for slots in ({}, {"slots": True}, {"slots": True, "weakref_slot": True})
    for keywords in ({}, {"kw_only": True})
]


def cases(decorator: Any, **options: Any) -> list[type]:
    """Return the same classes, decorated by `decorator`."""

    @decorator(**options)
    class Point:
        """A point."""

        x: float
        y: float = 0.0
        note: str = dataclasses.field(default="", compare=False, repr=False)
        tags: list[str] = dataclasses.field(default_factory=list, hash=False)

    @decorator(**options)
    class Sized:
        """A square and what follows from it."""

        size: int
        area: int = dataclasses.field(init=False)
        name: str = dataclasses.field(default="square", kw_only=True)

        def __post_init__(self) -> None:
            object.__setattr__(self, "area", self.size**2)

    @decorator(**options)
    class Special:
        """A class with methods of its own."""

        value: int = 3

        def __init__(self, value: int) -> None:
            object.__setattr__(self, "value", -value)

        def __repr__(self) -> str:
            return f"<{self.value}>"

        def __hash__(self) -> int:
            return 5

    @decorator(**options)
    class Equal:
        """A class with an equality of its own."""

        value: int = 3

        def __eq__(self, other: object) -> bool:
            return isinstance(other, int) or other is self

    @decorator(**options)
    class Empty:
        """A class without fields."""

    @decorator(**options)
    class Told:
        value: int = 0

    @decorator(**options)
    class Longer(Point):
        """A point with a height."""

        z: float = 1.0

    return [Point, Sized, Special, Equal, Empty, Told, Longer]


def outcome(function: Any) -> Any:
    """Return the text of a result, or the type and text of an error."""
    try:
        return repr(function())
    except Exception as error:
        return type(error), str(error)


def assigned(x: Any, name: str) -> Any:
    """Return an object after an assignment to its attribute."""
    setattr(x, name, 9)
    return x


def deleted(x: Any, name: str) -> Any:
    """Return an object after an attribute was deleted."""
    delattr(x, name)
    return x


def told(cls: Any) -> list[Any]:
    """Return what a class and its instances do."""
    calls = [(), (4,), (4, 5), (4, 5, "n", ["t"]), (1, 2, 3, 4, 5)]
    named = [{"x": 4}, {"x": 4, "y": 5, "tags": ["t"]}, {"size": 3, "name": "s"}, {"value": 7}, {"other": 1}]
    objects: list[Any] = []
    answers = [outcome(lambda c=c: objects.append(cls(*c))) for c in calls]
    answers += [outcome(lambda n=n: objects.append(cls(**n))) for n in named]
    other = cls.__base__ if cls.__base__ is not object else int
    assignable = [f.name for f in dataclasses.fields(cls)]
    if "__slots__" not in cls.__dict__:  # else the standard library's `super` of a frozen class is wrong
        assignable.append("unknown")
    for x in objects:
        answers += [repr(x), dataclasses.is_dataclass(x), outcome(lambda x=x: dataclasses.asdict(x))]
        answers += [outcome(lambda x=x, y=y: [x == y, x != y]) for y in [*objects, 4, other]]
        answers += [outcome(lambda x=x: {hash(x)} if cls.__hash__ is not object.__hash__ else "by identity")]
        answers += [outcome(lambda x=x: copy.copy(x)), outcome(lambda x=x: copy.deepcopy(x))]
        answers += [outcome(lambda x=x: dataclasses.replace(x)), outcome(lambda x=x: x < x)]
        for name in assignable:
            answers += [outcome(lambda x=x, n=name: assigned(copy.copy(x), n))]
            answers += [outcome(lambda x=x, n=name: deleted(copy.copy(x), n))]
    answers += [str(inspect.signature(cls)), cls.__match_args__, cls.__doc__, cls.__init__.__qualname__]
    answers += [cls.__init__.__annotations__, cls.__eq__ is object.__eq__, cls.__dict__.get("__slots__")]
    answers += [repr(dataclasses.fields(cls)), repr(cls.__dataclass_params__)]
    return answers


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_classes_do_what_those_of_the_standard_library_do(options: dict[str, bool]) -> None:
    for own, standard in zip(cases(dataclass, **options), cases(dataclasses.dataclass, **options), strict=True):
        assert told(own) == told(standard), own


def test_a_class_may_be_decorated_without_options() -> None:
    @dataclass
    class Pair:
        """Two numbers."""

        a: int
        b: int

    pair = Pair(1, 2)
    pair.a = 3
    assert (pair, repr(pair)) == (Pair(3, 2), f"{Pair.__qualname__}(a=3, b=2)")


@dataclass(frozen=True, slots=True)
class Kept:
    """A class whose instances travel."""

    a: int
    b: tuple[int, ...] = ()


def test_frozen_instances_with_slots_travel() -> None:
    assert pickle.loads(pickle.dumps(Kept(1, (2,)))) == Kept(1, (2,))


def test_users_may_extend_a_class_that_no_one_has_used_yet() -> None:
    base = cases(dataclass, frozen=True)[0]

    @dataclasses.dataclass(frozen=True)
    class Derived(base):  # type: ignore[misc, valid-type]
        w: int = 0

    assert Derived(1, w=2) == Derived(x=1, y=0.0, w=2)
    with pytest.raises(TypeError, match="non-frozen"):
        dataclasses.dataclass(type("Loose", (base,), {"__annotations__": {"w": int}, "w": 0}))


def test_threads_may_make_the_first_instances() -> None:
    for _ in range(20):
        points: list[Any] = []
        point = cases(dataclass, frozen=True, slots=True)[0]
        start = threading.Barrier(4)

        def make(cls: Any = point, start: Any = start, points: list[Any] = points) -> None:
            start.wait()
            points.append(cls(1, tags=[]))

        threads = [threading.Thread(target=make) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert points == [point(1)] * 4


def test_importing_the_product_writes_no_methods() -> None:
    """The classes of an import cost as much as its other code if each is compiled."""
    text = """
import dataclasses
import numpy
standard = set()
process = dataclasses._process_class
def count(cls, init, *options):
    if init and cls.__module__.startswith(("shpy", "raytracer")):
        standard.add(f"{cls.__module__}.{cls.__qualname__}")
    return process(cls, init, *options)
dataclasses._process_class = count
import raytracer
print(*sorted(standard))
"""
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    extended = {"Whitted", "Path", "Staged", "BoundArrays", "BoundStreams"}  # of Integrator and Bound
    assert {name.rpartition(".")[2] for name in done.stdout.split()} <= extended, done.stdout
