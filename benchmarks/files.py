"""Mesh files read by raytracer and by trimesh, each in a process of its own: processor time and memory.

print(files(quick=False).markdown())
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.studies import Table
from raytracer import Mesh

HEAD = ("file", "reader", "CPU s", "of trimesh's", "MB", "of trimesh's")
READERS = {
    "trimesh": "import trimesh\nload = lambda: trimesh.load(path, process=False, force='mesh').faces",
    "Mesh.load": "from raytracer import Mesh\nload = lambda: Mesh.load(path).faces",
    "Scene.load": "from raytracer import Scene\nload = lambda: Scene.load(path).meshes[0].faces",
}
_CHILD = """
import json, re, resource, sys
path, triangles = sys.argv[1], int(sys.argv[2])
{reader}
def held(name):
    with open("/proc/self/status") as file:
        return int(re.search(name + r":\\s+(\\d+)", file.read())[1]) / 1024
with open("/proc/self/clear_refs", "w") as file:
    file.write("5")  # the most is counted from here on
before, size = resource.getrusage(resource.RUSAGE_SELF), held("VmRSS")
found = load()
after = resource.getrusage(resource.RUSAGE_SELF)
assert len(found) == triangles
print(json.dumps([after.ru_utime - before.ru_utime, held("VmHWM") - size]))
"""
"""The memory is the growth of the process, where Linux counts it, from what it has before the file to its most."""


def files(quick: bool) -> Table:
    """Return, for OBJ files with and without normals, PLY, STL and OFF, what reading a million triangles takes."""
    side = 70 if quick else 707
    with tempfile.TemporaryDirectory() as folder:
        rows = []
        for name, path in _written(Path(folder), side):
            measurements = {reader: _measured(code, path, 2 * side**2) for reader, code in READERS.items()}
            seconds, size = measurements["trimesh"]
            for reader, (own, most) in measurements.items():
                ratios = (f"{own / seconds:.2f}", f"{most / max(size, 1):.2f}")
                rows.append((name, reader, f"{own:.2f}", ratios[0], f"{most:,.0f}", ratios[1]))
    note = (
        f"{2 * side**2:,} triangles of a wavy square: user CPU time and the growth of the resident memory to its most. "
        "raytracer computes normals for files without them, smooth where faces meet at less than 45 degrees, and "
        "Scene.load a camera and lights; trimesh computes neither when it reads."
    )
    return Table("files", note, HEAD, rows)


def _measured(reader: str, path: Path, triangles: int) -> tuple[float, float]:
    """Return the seconds and MB that a reader takes for a file."""
    command = [sys.executable, "-W", "ignore", "-c", _CHILD.format(reader=reader), str(path), str(triangles)]
    seconds, size = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return seconds, size


def _written(folder: Path, side: int) -> list[tuple[str, Path]]:
    """Write the files of a square of 2 side^2 triangles; return each with what it holds."""
    import trimesh

    x, y = np.meshgrid(np.linspace(0, 1, side + 1), np.linspace(0, 1, side + 1), indexing="ij")
    places = np.stack([x, y, np.sin(7 * x) * np.cos(5 * y) / 10], axis=-1).reshape(-1, 3)
    number = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    a, b, c, d = (part.reshape(-1) for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    mesh = Mesh(places, faces)
    normals = np.zeros_like(places)
    normals[faces] = mesh.smoothed().normals
    entries = []
    for name, keys in (("OBJ, v", "v"), ("OBJ, v/vt", "vt"), ("OBJ, v/vt/vn", "vtn")):
        path = folder / f"{keys}.obj"
        _write_obj(path, places, faces, places[:, :2] if "t" in keys else None, normals if "n" in keys else None)
        entries.append((name, path))
    square = trimesh.Trimesh(places, faces, process=False)
    for kind, options in (("ply", {}), ("stl", {}), ("off", {})):
        path = folder / f"square.{kind}"
        square.export(path, **options)
        entries.append((kind.upper(), path))
    return entries


def _write_obj(path: Path, places: np.ndarray, faces: np.ndarray, uv: np.ndarray | None, normals: np.ndarray | None):
    tables = [("v", places), ("vt", uv), ("vn", normals)]
    word = "%d" if uv is None else "%d/%d" if normals is None else "%d/%d/%d"
    with open(path, "w") as file:
        for key, rows in tables:
            if rows is not None:
                row = f"{key} {' '.join(['%.6f'] * rows.shape[1])}\n"
                file.writelines(row % tuple(each) for each in rows.tolist())
        columns = sum(rows is not None for _, rows in tables)
        row = f"f {' '.join([word] * 3)}\n"
        file.writelines(row % tuple(each) for each in np.repeat(faces + 1, columns, axis=1).tolist())
