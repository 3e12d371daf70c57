"""What measurements are written to: pictures, and JSON beside them.

Stage: measure. A file gets its name when it is complete: until then it has a temporary one in the same folder.

    with replacing(Path("found.json")) as path:
        path.write_text("{}")
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from shpy.errors import ShpyError

__all__ = ["check_folder", "check_output", "new_figure", "replacing", "save_figure", "write_json"]


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path beside `path`, with its ending, which takes its place unless the block raises."""
    temporary = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def check_folder(path: Path) -> None:
    """Raise ShpyError where the folder of `path` does not exist."""
    if not path.parent.is_dir():
        raise ShpyError(f"there is no folder {path.parent}", cure=f"mkdir -p {path.parent}")


def check_output(path: Path) -> None:
    """Raise ShpyError for a path that neither JSON nor a picture can be written to: before anything is measured."""
    check_folder(path)
    if path.suffix != ".json":
        known = sorted(new_figure(1, 1).canvas.get_supported_filetypes())
        if path.suffix[1:].lower() not in known:
            raise ShpyError(f"{path} is no picture", cure=f"a path that ends in .{', .'.join(known)}; or in .json")


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write it with numpy's numbers as plain ones, infinities and NaN as texts."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(_plain(content), indent=1) + "\n")


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, float) and not np.isfinite(value):
        return str(value)
    return value


def new_figure(width: float, height: float) -> Any:
    """A matplotlib Figure of this size in inches, which needs no screen and leaves the user's plots alone.

    Raises ShpyError, with the command that brings it, where matplotlib is missing.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ShpyError("plots need matplotlib", cure="pip install 'shpy-dsl[accuracy]'") from error
    return Figure(figsize=(width, height), layout="constrained")


def save_figure(figure: Any, path: Path, content: dict[str, Any]) -> None:
    """Write the picture, in the format of its ending, and JSON of the same name beside it; raises as `check_output`."""
    check_output(path)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120)
    write_json(path.with_suffix(".json"), content)
