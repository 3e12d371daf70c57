"""Golden results: the bits of a program in the user's repository, which every backend and later version must give.

Stage: test. Takes a program, its inputs and a name; compares with the file of that name, or writes it.

    assert_golden(planet, uv=uv, name="planet")     # reads golden/planet.npz beside the file of this line

Strict and portable mode promise the same bits on every backend, so nothing but those counts: there is no tolerance. A
file holds the outputs, the elements that were written, and the program's IR, by which a failure names the first
statement that changed. Of a picture, a PNG file for people lies beside it.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from shpy.chains.chain import Chain
from shpy.display.png import png
from shpy.display.screen import pixels
from shpy.errors import ShpyTypeError
from shpy.files import replacing
from shpy.ir.nodes import Loc, Module
from shpy.ir.text import lines
from shpy.ir.traverse import walk
from shpy.lang.recording.location import here
from shpy.passes.modes import REPRODUCIBLE
from shpy.programs import Program
from shpy.testing import defaults
from shpy.testing.chained import UPDATE, assert_golden_chain, check_streams, first_change, load, save
from shpy.testing.equivalence import Agreement, Comparison
from shpy.testing.observers import Setting
from shpy.testing.reference import split_options, targets
from shpy.testing.runs import Run, run

_NAME: Final = re.compile(r"[\w-][\w.-]*")
_LARGEST: Final = 1 << 26
"""The most bytes of results that a file takes: a repository keeps each version of it."""


def assert_golden(
    program: Program | Chain,
    *inputs: Any,
    name: str,
    folder: str | Path | None = None,
    update: bool | None = None,
    backends: Iterable[str] | None = None,
    shape: Any = None,
    **named: Any,
) -> Agreement:
    """Compare every bit of the results on each backend with those of the file `folder/name.npz`; NaNs are equal.

    `folder` is by default the folder "golden" beside the file of the calling line. `pytest --shpy-update`, or `update`,
    writes the file where it is missing or not that of this program and these bits, after the backends agreed; of one
    output of numbers over two axes, also `name.png`. `backends`, `inputs` and other names are those of
    `assert_equivalent`. Of a chain the names are those of `chain.run`, the results are its streams, and `backends` are
    names without a width.

    Raises AssertionError where the file is missing or a bit differs: it names the element, its inputs, both values, and
    the first statement of the program that is not that of the file. Raises ShpyTypeError for a name that no file can
    have, for relaxed and fast mode, whose bits differ between backends, and for results beyond 64 MiB; ShpyError for a
    file that is not of this function.
    """
    if not (isinstance(name, str) and _NAME.fullmatch(name)):
        raise ShpyTypeError(f"name={name!r} is no name of a file", loc=here(), cure='name="planet"')
    path = _folder(folder) / f"{name}.npz"
    updates = defaults.update if update is None else update
    if isinstance(program, Chain):
        check_streams(program, inputs)
        arguments = named | ({} if shape is None else {"shape": shape})
        if backends is None and defaults.backends is not None:
            backends = [target.partition("-")[0] for target in defaults.backends]
        return assert_golden_chain(program, path, updates, backends, arguments)
    inputs_by_name, options = split_options(named, program)
    mode = options.get("math", "strict")
    if mode not in REPRODUCIBLE:
        raise ShpyTypeError(
            f"math={mode!r} gives other bits on other backends", loc=here(), cure='math="strict" or math="portable"'
        )
    setting = Setting(program, inputs, inputs_by_name, shape, options)
    targets_ = targets(backends if backends is not None else defaults.backends)
    if not updates:
        golden = load(path, Golden.read)
        return _compare(golden, setting, [run(setting, target) for target in targets_])
    runs = [run(setting, target) for target in targets_]
    agreement = Comparison(setting, runs).check()
    golden = Golden.of(setting, runs[0])
    if not path.exists() or not golden.is_like(load(path, Golden.read)):
        golden.save(path, _picture(setting, runs[0]))
    return agreement


def _folder(folder: str | Path | None) -> Path:
    if folder is not None:
        return Path(folder)
    place = here()
    if place is None or not Path(place.file).is_file():
        raise ShpyTypeError(
            "the calling line is in no file, beside which results lie", loc=place, cure='folder="golden"'
        )
    return Path(place.file).parent / "golden"


@dataclass(frozen=True)
class Golden:
    """The content of a file: the `result` of a run, a digest of its `inputs`, the IR's `text`, shpy's `version`."""

    result: Run
    inputs: str
    text: str
    version: str

    @classmethod
    def of(cls, setting: Setting, result: Run) -> Golden:
        """Return what a file of this run holds; raise ShpyTypeError for results that are too large."""
        from shpy import __version__  # here: it is assigned after this module

        size = sum(output.nbytes for output in result.outputs)
        if size > _LARGEST:
            raise ShpyTypeError(
                f"the results take {size >> 20} MiB, and a file takes {_LARGEST >> 20}",
                loc=here(),
                cure="inputs of fewer elements",
            )
        return cls(result, _digest(setting), "\n".join(_texts(setting.program.ir)), __version__)

    @classmethod
    def read(cls, file: Mapping[str, Any]) -> Golden:
        """Return what a file holds; raise KeyError where it is not of a program."""
        count = sum(name.startswith("output") for name in file)
        outputs = tuple(file[f"output{n}"] for n in range(count))
        result = Run("golden", outputs, file["written"], int(file["stopped"]), tuple(map(str, file["notes"])))
        return cls(result, *(str(file[name]) for name in ("inputs", "text", "version")))

    def save(self, path: Path, picture: bytes | None) -> None:
        """Write the file, and the picture beside it."""
        r = self.result
        parts: dict[str, Any] = {f"output{n}": output for n, output in enumerate(r.outputs)}
        parts |= {"written": r.written, "stopped": r.stopped, "notes": np.array(r.notes, np.str_)}
        save(path, {**parts, "inputs": self.inputs, "text": self.text, "version": self.version})
        if picture is not None:
            with replacing(path.with_suffix(".png")) as file:
                file.write_bytes(picture)

    def is_like(self, other: Golden) -> bool:
        """Return whether both have the same program and inputs, outputs, elements and ends, bit for bit."""
        a, b = self.result, other.result
        has_same_bits = _shape(a) == _shape(b) and a.stopped == b.stopped and _bits(a) == _bits(b)
        return has_same_bits and self.text == other.text and self.inputs == other.inputs


def _compare(golden: Golden, setting: Setting, runs: list[Run]) -> Agreement:
    """Raise AssertionError where a run differs from the file."""
    if _shape(golden.result) != _shape(runs[0]):
        raise AssertionError(
            f"{setting.program.name}: the golden result has {_shape(golden.result)}, and the run {_shape(runs[0])}; "
            f"{UPDATE} writes it anew"
        )

    def explain(other: Run, element: int) -> Iterator[str]:
        yield from _change(golden, setting)
        yield f"  {UPDATE} takes the new bits"

    return Comparison(setting, [golden.result, *runs], explain=explain).check()


def _change(golden: Golden, setting: Setting) -> Iterator[str]:
    """Yield the first statement that is not that of the file, or else what is the same and what is not."""
    changes = list(first_change(golden.text, list(_located(setting.program.ir))))
    if changes:
        yield from changes
        return
    inputs = "so are the inputs" if _digest(setting) == golden.inputs else "the inputs, or a Param, are not"
    yield f"the recorded program is that of the file; {inputs}"
    from shpy import __version__

    if golden.version != __version__:
        yield f"  shpy {golden.version} wrote it, this is shpy {__version__}"


def _located(module: Module) -> Iterator[tuple[str, Loc | None]]:
    """Yield each line of the IR without locations, and the user's line of the statement that it prints."""
    statements = [s for f in module.functions for s in walk(f.body)]
    for line in lines(module, locations=False):
        kind, n = line.anchor
        s: Any = statements[n] if kind == "statement" and n < len(statements) else None
        yield str(line), (s.value.loc if hasattr(s, "value") and hasattr(s.value, "loc") else getattr(s, "loc", None))


def _texts(module: Module) -> Iterator[str]:
    return (text for text, _ in _located(module))


def _digest(setting: Setting) -> str:
    """Return a digest of the inputs, Params, Tables and options."""
    params, tables = setting.data()
    digest = hashlib.sha256(repr((setting.element_shape, sorted(setting.options.items()))).encode())
    arrays = {**{leaf.name: leaf.array for leaf in setting.leaves}, **params, **tables}
    for name, value in arrays.items():
        array = np.ascontiguousarray(value)
        digest.update(f"{name} {array.dtype} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _shape(result: Run) -> str:
    types = ", ".join(f"{output.shape[1]} x {output.dtype}" for output in result.outputs)
    return f"{result.written.size} elements of {types}"


def _bits(result: Run) -> list[bytes]:
    return [array.tobytes() for array in (*result.outputs, result.written)]


def _picture(setting: Setting, result: Run) -> bytes | None:
    """Return the PNG file of a result that is one output of one to four components over two axes; else None."""
    if len(result.outputs) != 1 or len(setting.element_shape) != 2 or result.outputs[0].shape[1] > 4:
        return None
    if result.outputs[0].dtype.kind != "f":
        return None
    return png(pixels(result.outputs[0].reshape(*setting.element_shape, -1)))
