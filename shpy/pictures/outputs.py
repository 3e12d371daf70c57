"""The files that measurements are written to: pictures, and JSON beside them.

Stage: measure. Files are written whole or not at all (`shpy.files`), and paths are checked before anything is measured.

    check_output(Path("found.png"))
    save_figure(figure, Path("found.png"), {"x": 1})     # and found.json
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from shpy.errors import ShpyError
from shpy.files import check_writable, replacing
from shpy.packages import install


def check_file(path: Path) -> None:
    """Raise ShpyError where no file can be made at `path`: before anything is measured."""
    try:
        check_writable(path)
    except OSError as error:
        missing = not path.parent.is_dir()
        raise ShpyError(str(error), cure=f"mkdir -p {path.parent}" if missing else None) from error


def check_output(path: Path) -> None:
    """Raise ShpyError for a path that neither JSON nor a picture can be written to: before anything is measured."""
    if path.suffix != ".json":
        formats = sorted(new_figure(1, 1).canvas.get_supported_filetypes())
        if path.suffix[1:].lower() not in formats:
            raise ShpyError(f"{path} is no picture", cure=f"a path that ends in .{', .'.join(formats)}; or in .json")
        check_file(path.with_suffix(".json"))
    check_file(path)


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
    """Make a matplotlib Figure of this size in inches, which needs no screen and leaves the user's plots alone.

    Raises ShpyError, with the command that brings it, where matplotlib is missing.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ShpyError("plots need matplotlib", cure=install("matplotlib")) from error
    return Figure(figsize=(width, height), layout="constrained")


def save_figure(figure: Any, path: Path, content: dict[str, Any]) -> None:
    """Write the picture, in the format of its ending, and JSON of the same name beside it; raises as `check_output`.

    A path that ends in .json gets JSON alone.
    """
    check_output(path)
    if path.suffix != ".json":
        with replacing(path) as temporary:
            figure.savefig(temporary, dpi=120)
    write_json(path.with_suffix(".json"), content)
