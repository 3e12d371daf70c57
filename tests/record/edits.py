"""A file that is edited again and again in one process: its texts, the ways to load them, and what each of them gives.

    python edits.py 7301 12 folder    # 12 edits in a folder, from this seed; prints a line for each difference

Each version is loaded in every way that keeps the process. Its programs have to give the values, names and errors that
a process gives which has never seen another version: a fork of this one, which forgets the others.
"""

from __future__ import annotations

import contextlib
import copy
import importlib.util
import io
import json
import linecache
import os
import random
import runpy
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import shpy as sh
from shpy.errors import ShpyError, ShpyWarning
from shpy.view.source import explain, open_file

FRAGMENTS = {
    "fine": ["n = sh.Attrib1f(0)", "with SH_IF(x > 0):", "    n += 1", "y += n"],
    "rebound": ["n = 0", "with SH_IF(x > 0):", "    n = n + 1", "y += n"],
    "aliased": ["z = y", "z += 1", "y += z"],
    "copied": ["z = y.copy()", "z += 1", "y += z"],
    "leaves": ["with SH_IF(x > 0):", "    return y"],
    "leaves well": ["with SH_IF(x > 0):", "    SH_RETURN(y)"],
    "alone": ["SH_IF(x > 0)", "y += 1"],
    "asks": ["if x > 0:", "    y += 1"],
    "converts": ["y += int(x)"],
    "not numpy": ["y += math.sin(x)"],
    "typo": ["y += ramp.size"],
    "called": ["y += ramp(1)"],
    "read": ["y += ramp[1]"],
    "loop": ["for k in range(3):", "    y += x * k"],
    "uncalled": ["with SH_FOR(3) as i:", "    SH_BREAK", "    y += i"],
    "counted": ["with SH_FOR(3) as i:", "    y += i"],
}
"""Bodies of programs: mistakes, and what should be written instead."""
SILENT = ("aliased", "alone", "uncalled")
"""Mistakes that only a text shows."""
HEAD = ["import math", "import shpy as sh", "from shpy import SH_BREAK, SH_FOR, SH_IF, SH_RETURN", ""]


class Version:
    """The choices behind one text; each edit changes one of them."""

    def __init__(self, chance: random.Random) -> None:
        self.chance = chance
        self.params = ["gain", "bias"]
        self.values = [2.0, 0.5]
        self.blanks = 0
        self.bodies = {"helper": "fine", "program": "loop", "method": "counted"}
        self.scale = 1
        self.type = "Attrib1f"
        self.asserted = False

    def edit(self) -> None:
        """Change one thing, as a user does in an editor."""
        chance = self.chance
        match chance.randrange(8):
            case 0:
                self.params.reverse()
            case 1:
                self.values[chance.randrange(2)] = chance.choice([0.25, 3.0, -1.0])
            case 2:
                self.params[chance.randrange(2)] = (
                    chance.choice(["alpha", "omega", "gamma", "level"]) + "1" * self.scale
                )
            case 3:
                self.blanks = chance.randrange(4)
            case 4:
                self.scale = chance.randrange(1, 9)
            case 5:
                self.type, self.asserted = chance.choice(["Attrib1f", "Point1f", "Attrib1i"]), chance.random() < 0.5
            case _:
                self.bodies[chance.choice(list(self.bodies))] = chance.choice(list(FRAGMENTS))

    def alone(self, part: str) -> Version:
        """Return a version in which the other bodies have no mistake."""
        found = copy.copy(self)
        found.bodies = dict.fromkeys(self.bodies, "fine") | {part: self.bodies[part]}
        return found

    @property
    def text(self) -> str:
        first, second = self.params
        lines = [
            *HEAD,
            *["# a remark"] * self.blanks,
            f"{first} = sh.Param(sh.Attrib1f, {self.values[0]})",
            f"{second} = sh.Param(sh.Attrib1f, {self.values[1]})",
            f"twice = {first} * 2",
            "ramp = sh.Table([1.0, 2.0, 3.0], sh.Attrib1f)",
            "def helper(x, y):",
            *self._body("helper", 4),
            "class Curve:",
            "    @sh.program",
            f"    def at(self, x: sh.{self.type}) -> sh.Attrib1f:",
            f"        y = sh.Attrib1f(x) * {self.scale} + {second}",
            *self._body("method", 8),
            "@sh.program",
            f"def shape(x: sh.{self.type}) -> sh.Attrib1f:",
            f"    y = sh.Attrib1f(x) * {self.scale} + {first} + twice",
            *(["    assert y is not None, 'never'"] if self.asserted else []),
            "    y += helper(x, y.copy())",
            *self._body("program", 4),
        ]
        return "\n".join(lines) + "\n"

    def _body(self, part: str, margin: int) -> list[str]:
        return [" " * margin + line for line in (*FRAGMENTS[self.bodies[part]], "return y")]


Names = dict[str, Any]


def answer(load: Callable[[], Names], path: Path, meanwhile: Callable[[], None] = lambda: None) -> Any:
    """Return what a version gives: of each program its values, its Params and its IR, or else an error as it is shown.

    `meanwhile` happens between the definitions and the first use of the method.
    """
    try:
        names = load()
        meanwhile()
        return [_run(names["shape"]), _run(names["Curve"]().at)]
    except ShpyError as error:
        told = explain(error, path)
        told["source"] = [list(line) for line in told["source"]]
        return {key: told[key] for key in ("type", "message", "cure", "line", "source")}


def _run(program: Any) -> Any:
    kind = program.inputs["x"]
    values = program.compile("numpy")(np.array([-1, 2], np.int32 if kind is sh.Attrib1i else np.float32))
    params = [[name, np.asarray(param.value).tolist()] for name, param in program.params.items()]
    lines = [line for line in str(program.ir).splitlines() if not line.startswith("file ")]
    return [np.asarray(values).tolist(), params, lines]


def fresh(path: Path, answers: dict[str, Any]) -> Any:
    """Return the answer of a process that has loaded no version before; the file has its text."""
    text = path.read_text()
    if text not in answers:
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            _report(path, writing)
        os.close(writing)
        with open(reading) as sent:
            answers[text] = json.load(sent)
        os.waitpid(child, 0)
    return answers[text]


def _report(path: Path, writing: int) -> None:
    try:
        with open(writing, "w") as out:
            json.dump(answer(lambda: runpy.run_path(str(path)), path), out)
    finally:
        os._exit(0)


# The ways to load a version


class Ways:
    """The ways to load the file, with the modules that live from version to version."""

    def __init__(self, path: Path) -> None:
        from IPython.core.interactiveshell import InteractiveShell

        self.path = path
        self.modules: dict[str, Any] = {}
        self.shell = InteractiveShell.instance()
        self.shell.showtraceback = _raise  # %run shows the error of a file, and goes on
        self.all: dict[str, Callable[[], Names]] = {
            "importlib.reload": lambda: self._module("reloaded", importlib.reload),
            "autoreload": lambda: self._module("replaced", self._replace),
            "exec with linecache": self._execute,
            "runpy": lambda: runpy.run_path(str(path)),
            "%run": lambda: self._run_cell(f"%run {path}"),
            "a cell": lambda: self._run_cell(path.read_text()),
            "the live page": lambda: open_file(path).names,
        }

    def _module(self, name: str, again: Callable[[Any], Any]) -> Names:
        """Import the file as a module of this name, or load the module again, as `again` does."""
        if name in self.modules:
            sys.modules[name] = self.modules[name]
            again(self.modules[name])
        else:
            spec = importlib.util.spec_from_file_location(name, self.path)
            assert spec is not None
            assert spec.loader is not None
            self.modules[name] = sys.modules[name] = importlib.util.module_from_spec(spec)
            sys.meta_path.insert(0, Finder(spec))
            spec.loader.exec_module(self.modules[name])
        return vars(self.modules[name])

    def _replace(self, module: Any) -> None:
        """Load a module again as notebooks do, which give old functions the new code."""
        from IPython.extensions.autoreload import superreload

        superreload(module, importlib.reload, {}, self.shell)

    def _execute(self) -> Names:
        """Execute the text under a name for which linecache has it, as doctest and code generators do."""
        text, file = self.path.read_text(), "<edited>"
        linecache.cache[file] = (len(text), None, text.splitlines(True), file)
        names: Names = {"__name__": "edited"}
        exec(compile(text, file, "exec", dont_inherit=True), names)
        return names

    def _run_cell(self, text: str) -> Names:
        with contextlib.redirect_stdout(io.StringIO()):
            result = self.shell.run_cell(text)
        result.raise_error()
        return dict(self.shell.user_ns)


def _raise(*_: Any, **__: Any) -> None:
    error = sys.exc_info()[1]
    assert error is not None
    raise error


class Finder:
    """Finds the module of a spec again, wherever its file is."""

    def __init__(self, spec: Any) -> None:
        self.spec = spec

    def find_spec(self, name: str, *_: Any) -> Any:
        same = name == self.spec.name
        return importlib.util.spec_from_file_location(name, self.spec.origin) if same else None


def differences(seed: int, count: int, folder: Path) -> Iterator[str]:
    """Edit a file `count` times, load each version in every way, and yield what differs from a fresh process."""
    sys.dont_write_bytecode = True  # a compiled file of the same second and size would pass for the new version
    path = folder / "edited.py"
    version, answers, ways = Version(random.Random(seed)), dict[str, Any](), Ways(path)
    before = ""
    for number in range(count):
        text = version.text
        path.write_text(text)
        expected = fresh(path, answers)
        for name, load in ways.all.items():
            yield from _different(f"{number} {name}", expected, answer(load, path), text)
        yield from _edited_meanwhile(number, path, expected, version, answers, before)
        before = text
        while version.text == text:
            version.edit()


def _edited_meanwhile(
    number: int, path: Path, expected: Any, version: Version, answers: dict[str, Any], before: str
) -> Iterator[str]:
    """Edit the file between its definitions and the first use of a method, and before its code is executed."""
    text = version.text
    other = before or "\n" + text

    def edit() -> None:
        path.write_text(other)

    path.write_text(text)
    found = answer(lambda: runpy.run_path(str(path)), path, edit)
    yield from _different(f"{number} edited before the first use", expected, found, text)
    path.write_text(other)
    file = f"{path}.{number}"  # Python never saw the text that is there now
    Path(file).write_text(other)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = answer(lambda: _executed(text, file), path)
    notices = [str(w.message) for w in told if issubclass(w.category, ShpyWarning)]
    if isinstance(expected, dict):
        unseen = any(kind in version.bodies.values() for kind in SILENT) and notices
        right = unseen or (isinstance(found, dict) and _is_a_mistake(found, path, version, answers))
    else:
        right = not isinstance(found, dict) and [part[:2] for part in found] == [part[:2] for part in expected]
    if not right:
        yield f"{number} edited before it runs: {notices}\n  {expected}\n  {found}\n{text}"


def _is_a_mistake(found: dict[str, Any], path: Path, version: Version, answers: dict[str, Any]) -> bool:
    """Return whether an error is that of a mistake in one of the bodies.

    Of mistakes in several bodies the first one is shown. With the text, many are found before the program is recorded;
    without it, they are found while it is recorded, so the order differs. The line may be that of the `with`.
    """
    line = version.text.splitlines()[found["line"] - 1]
    for part in version.bodies:
        text = version.alone(part).text
        path.write_text(text)
        expected = fresh(path, answers)
        if isinstance(expected, dict) and expected["type"] == found["type"]:
            at = expected["line"]
            if line in text.splitlines()[max(at - 2, 0) : at]:
                return True
    return False


def _executed(text: str, file: str) -> Names:
    names: Names = {"__name__": "edited"}
    exec(compile(text, file, "exec", dont_inherit=True), names)
    return names


def _different(way: str, expected: Any, found: Any, text: str) -> Iterator[str]:
    if found != expected:
        yield f"{way}:\n  {expected}\n  {found}\n{text}"


if __name__ == "__main__":
    print(*differences(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])), sep="\n")
    print("done")
