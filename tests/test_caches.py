"""Whatever keeps compiled things or results for later has a limit, or keys of which there are few."""

import ast
from pathlib import Path

import numpy as np

import shpy as sh
from shpy.backend.device.pool import Recent
from shpy.backend.glsl.device import memory as glsl_memory
from shpy.backend.opencl.device import memory as opencl_memory
from shpy.backend.registry import backend as backend_named

ROOT = Path(__file__).parent.parent
FEW = {
    "raytracer/accel/shape.py": "backends",
    "raytracer/layered/raster.py": "one switch",
    "shpy/backend/dump.py": "the parts of SHPY_DUMP",
    "shpy/backend/device/probe.py": "constants",
    "shpy/backend/glsl/device/textures.py": "classes of moderngl",
    "shpy/backend/opencl/device/buffers.py": "one function of the C library",
    "shpy/backend/opencl/device/declarations.py": "functions of OpenCL C",
    "shpy/backend/opencl/device/memory.py": "words of 8 to 64 bits",
    "shpy/backend/opencl/packets/widen.py": "types and widths of packets",
    "shpy/chains/counter.py": "one program",
    "shpy/collectives/choosing.py": "types of an element",
    "shpy/collectives/histograms.py": "types of an element",
    "shpy/collectives/leaves.py": "types of an element",
    "shpy/collectives/scattering.py": "types of an index",
    "shpy/fitting.py": "one program",
    "shpy/ieee.py": "one library and one warning",
    "shpy/ir/constants.py": "precisions",
    "shpy/ir/exact.py": "functions of the language",
    "shpy/ir/ops.py": "operations of the language and their types",
    "shpy/ir/parser.py": "one grammar",
    "shpy/lang/recording/location.py": "one warning",
    "shpy/passes/formulas/edges.py": "operations of the language and their types",
    "shpy/passes/library.py": "operations of the language and their types",
    "shpy/streams/methods.py": "methods of streams",
    "shpy/testing/certify/functions.py": "functions of the language",
    "shpy/testing/certify/golden.py": "one file",
    "shpy/view/kernels.py": "one thread",
}
"""Files with `functools.cache`, and what its keys are there: there are few of them, whatever a program does."""


def unlimited(path):
    """Yield the functions of a file that a cache without a limit decorates."""
    source = path.read_text()
    for node in ast.walk(ast.parse(source)) if "cache" in source else ():
        for decorator in getattr(node, "decorator_list", []):
            text = ast.unparse(decorator)
            if text in ("cache", "functools.cache") or "maxsize=None" in text:
                yield node.name


def test_caches_without_a_limit_have_few_keys():
    paths = (p for room in ("shpy", "raytracer") for p in sorted((ROOT / room).rglob("*.py")))
    found = {str(path.relative_to(ROOT)): list(unlimited(path)) for path in paths}
    assert {path: names for path, names in found.items() if names and path not in FEW} == {}
    assert [path for path in FEW if not found[path]] == []


def test_the_things_used_last_stay():
    released: list[str] = []
    kept = Recent(3, released.append)
    for key in "abcadbe":
        assert kept.get(key, key.upper) == key.upper()
    assert released == ["B", "C", "A"]
    assert len(kept) == 3
    assert kept.get("e", lambda: "made anew") == "E"


def test_kernels_of_a_space_are_forgotten(monkeypatch):
    space = backend_named("opencl").space(None)
    monkeypatch.setattr(space, "_kernels", Recent(3))
    target = space.allocate(64, sh.Attrib1i.type, np.dtype(np.int32))
    for k in range(7):
        text = f"__kernel void put(__global int *a, ulong n) {{ size_t i = get_global_id(0); if (i < n) a[i] = {k}; }}"
        space.each(text, "put", 64, (target.buffer,))
        assert (target.read() == k).all()
    assert len(space._kernels) == 3
    assert opencl_memory.KERNELS <= 1024


def test_programs_and_depths_of_a_space_are_forgotten(monkeypatch):
    space = backend_named("glsl").space(None)
    monkeypatch.setattr(space, "_programs", Recent(8, glsl_memory._release_all))
    monkeypatch.setattr(space, "_depths", Recent(4, lambda depth: depth.release()))
    to = space.allocate(64, sh.Attrib1f.type, np.dtype(np.float32))
    for k in range(20):
        text = f"#version 330 core\nout float a;\nvoid main() {{ a = {k}.0; }}"
        space.call(lambda text=text: space.draw(text, {}, {}, to, (64, 1)))
        assert (to.read() == k).all()
        space.call(lambda k=k: space.depth((k + 1, 1)))
    assert len(space._programs) == 8
    assert len(space._depths) == 4
