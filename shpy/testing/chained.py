"""Golden results of chains: the streams that a chain writes, in a file that every backend and later version must give.

Stage: test. `golden.assert_golden` hands chains to `assert_golden_chain`. A chain runs on a backend as streams do, so a
width of OpenCL's packets is not chosen. Its file holds each stream and the IR of each kernel. Files of programs are
read and written here too.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from shpy.backend.registry import backends as all_backends
from shpy.chains.chain import Chain
from shpy.errors import ShpyError, ShpyTypeError
from shpy.files import check_writable, replacing
from shpy.ir.nodes import Loc
from shpy.ir.text import print_module
from shpy.lang.recording.location import here
from shpy.lang.recording.text import written
from shpy.testing.arrays import Array, differing, flat_leaves
from shpy.testing.equivalence import Agreement

_STREAM: Final = "stream "
UPDATE: Final = "pytest --shpy-update or update=True"
_T = TypeVar("_T")


def assert_golden_chain(
    chain: Chain, path: Path, update: bool, backends: Iterable[str] | None, streams: dict[str, Any]
) -> Agreement:
    """Compare the streams of a chain on each backend with a file, or write it; see `golden.assert_golden`.

    `streams` are the arguments of `chain.run`.
    """
    available = [b.name for b in all_backends() if b.available]
    chosen = list(dict.fromkeys(available if backends is None else backends))
    if unknown := set(chosen) - set(available):
        cure = f"backends={available}"
        raise ShpyTypeError(f"a chain does not run on {', '.join(sorted(unknown))}", loc=here(), cure=cure)
    results = {name: _arrays(chain, name, streams) for name in chosen}
    text = "\n".join(print_module(kernel.recorded.module, locations=False) for kernel in chain.kernels)
    if update:
        first = results[chosen[0]]
        for name in chosen[1:]:
            _compare(chosen[0], first, name, results[name], ())
        if not path.exists() or not _is_like(load(path, _read), first, text):
            save(path, {**{_STREAM + name: array for name, array in first.items()}, "text": text})
        return Agreement(tuple(chosen), _count(first), {})
    golden, before = load(path, _read)
    changes = list(first_change(before, [(line, None) for line in text.splitlines()]))
    notes = [*(changes or ["the kernels are those of the file"]), f"  {UPDATE} takes the new bits"]
    for name, arrays in results.items():
        _compare("golden", golden, name, arrays, notes)
    return Agreement(("golden", *chosen), _count(golden), {})


def check_streams(chain: Chain, inputs: tuple[Any, ...]) -> None:
    """Raise ShpyTypeError for streams by position."""
    if inputs:
        names = ", ".join(f"{name}=…" for name in chain.inputs)
        raise ShpyTypeError(f"{chain} takes its streams by name", loc=here(), cure=names or "no streams")


def _arrays(chain: Chain, backend: str, streams: dict[str, Any]) -> dict[str, Array]:
    """Return the streams that the chain writes, by name; of a struct each leaf."""
    written = chain.run(**streams, backend=backend).streams
    leaves = {name: flat_leaves(stream.numpy()) for name, stream in written.items()}
    return {
        name if len(parts) == 1 else f"{name}, leaf {k}": np.asarray(part)
        for name, parts in leaves.items()
        for k, part in enumerate(parts)
    }


def _count(arrays: dict[str, Array]) -> int:
    return sum(a.size for a in arrays.values())


def _compare(first: str, a: dict[str, Array], second: str, b: dict[str, Array], notes: Iterable[str]) -> None:
    """Raise AssertionError for the first number that differs."""
    for name in {**a, **b}:
        x, y = a.get(name), b.get(name)
        if x is None or y is None or (x.shape, x.dtype) != (y.shape, y.dtype):
            shapes = ["none" if v is None else f"{v.dtype} {v.shape}" for v in (x, y)]
            line = f"stream {name}: {first} has {shapes[0]} and {second} has {shapes[1]}"
            raise AssertionError("\n".join([line, *notes]))
        wrong = np.argwhere(differing(x, y))
        if len(wrong):
            at = tuple(wrong[0].tolist())
            lines = [f"stream {name}: {first} and {second} differ in {len(wrong)} of {x.size} numbers, first in {at}"]
            lines += [f"    {n:12} {v[at].item()!r}" for n, v in ((first, x), (second, y))]
            raise AssertionError("\n".join([*lines, *notes]))


def _is_like(content: tuple[dict[str, Array], str], arrays: dict[str, Array], text: str) -> bool:
    kept, before = content
    same = kept.keys() == arrays.keys() and all(
        (kept[n].dtype, kept[n].shape, kept[n].tobytes()) == (a.dtype, a.shape, a.tobytes()) for n, a in arrays.items()
    )
    return same and before == text


def _read(file: Mapping[str, Any]) -> tuple[dict[str, Array], str]:
    return {name.removeprefix(_STREAM): file[name] for name in file if name.startswith(_STREAM)}, str(file["text"])


def load(path: Path, read: Callable[[Mapping[str, Any]], _T]) -> _T:
    """Return what `read` makes of a file; AssertionError where it is missing, ShpyError where it is not such a file."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return read(file)
    except FileNotFoundError:
        raise AssertionError(f"there is no golden result {path}; {UPDATE} writes it") from None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ShpyError(f"{path} holds no golden result: {error}", loc=here(), cure=UPDATE) from None


def save(path: Path, parts: Mapping[str, Any]) -> None:
    """Write a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    check_writable(path)
    with replacing(path) as file:
        np.savez_compressed(file, **parts)


def first_change(before: str, now: Sequence[tuple[str, Loc | None]]) -> Iterator[str]:
    """Yield lines that show the first statement that is not that of the file; none where all are.

    `now` has each line of today's text, and the user's line of its statement.
    """
    old = [(line, None) for line in before.splitlines()]
    for (a, _), (b, loc) in zip_longest(old, now, fillvalue=(None, None)):
        if a != b:
            yield f"the first statement that changed{f', at {loc}' if loc else ''}:"
            if loc and written(loc):
                yield f"    {written(loc)}"
            yield f"  golden       {'no more statements' if a is None else a.strip()}"
            yield f"  now          {'no more statements' if b is None else b.strip()}"
            return
