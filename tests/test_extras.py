"""Each extra of pyproject.toml, installed alone, does what the documents say of it; what it lacks is named with a cure.

By default the environments are made of links to the packages of the tests. `-m slow` installs each extra by pip, for
which pip needs a package index, and runs every benchmark.
"""

import re
import signal
import subprocess
import tomllib
import urllib.request

import pytest
from environments import ROOT, environment, installed, linked
from patience import HANGING

EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
NOT_FOR_USERS = {"dev"}
"""The tests themselves run in it."""

PROGRAM = """
import numpy as np
import shpy as sh


@sh.program
def shade(uv: sh.TexCoord2f, time: sh.Attrib1f) -> sh.Color3f:
    return sh.Color3f(uv.x, sh.sin(time + uv.y), 0.5)


@sh.program
def root(a: sh.Attrib1f) -> sh.Attrib1f:
    return sh.sqrt(a * a + 1)
"""

LOAD = """
import json, struct
from pathlib import Path

points = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
accessor = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}
text = json.dumps({
    "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], "accessors": [accessor],
    "bufferViews": [{"buffer": 0, "byteLength": 36}], "buffers": [{"byteLength": 36}],
}).encode()
text += b" " * (-len(text) % 4)
chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(points), 0x004E4942) + points
Path("t.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
corners = ["0 0 0", "1 0 0", "0 1 0"]
Path("t.obj").write_text("\\n".join([*("v " + c for c in corners), "f 1 2 3"]))
Path("t.off").write_text("\\n".join(["OFF", "3 1 0", *corners, "3 0 1 2"]))
Path("t.stl").write_bytes(bytes(80) + struct.pack("<I12fH", 1, 0, 0, 1, *map(float, " ".join(corners).split()), 0))
header = ["ply", "format ascii 1.0", "element vertex 3", *("property float " + axis for axis in "xyz")]
faces = ["element face 1", "property list uchar int vertex_indices", "end_header"]
Path("t.ply").write_text("\\n".join([*header, *faces, *corners, "3 0 1 2\\n"]))

from raytracer import Mesh, Scene

for name in ("t.glb", "t.obj", "t.off", "t.stl", "t.ply"):
    assert len(Mesh.load(name)) == len(Scene.load(name).meshes[0]) == 1, name
"""

CODE = {
    "": """
from program import np, root, sh
assert root(np.float32([0.0])) == 1
assert sh.testing.assert_equivalent(root, np.float32([1.0]), backends=["numpy", "interpreter"])
assert root.trace(a=1)
""",
    "opencl": """
from program import np, root
assert root.compile("opencl")(np.float32([0.0])) == 1
""",
    "glsl": """
from program import np, root
assert root.compile("glsl")(np.float32([0.0])) == 1
""",
    "raytracer": LOAD,
    "testing": """
from hypothesis import given, settings
from program import sh

@settings(max_examples=2, database=None)
@given(sh.testing.programs())
def check(program):
    sh.testing.assert_equivalent(program, backends=["numpy", "interpreter"])
""",
    "accuracy": """
from program import np, root, sh
report = sh.accuracy.measure(root, {"a": (1, 8)}, backends=["numpy"], math="strict", samples=50)
report.plot("error.png")
import flip_evaluator, sys
""",
    "cluster": """
from program import np, root, sh
import dask.array as da
assert np.array_equal(sh.map_blocks(root, da.zeros(8, chunks=4, dtype=np.float32)).compute(), np.ones(8))
""",
    "notebook": """
from program import shade, sh
assert sh.widget(shade, size=(8, 4), backend="numpy")
sh.animate(shade, "waves.gif", frames=2, size=(8, 4))
assert shade._repr_png_()
""",
    "completion": "",
    "denoise": "",
    "view": "",
    "bench": "",
    "all": "",
}
"""Code that the documents promise to run with each extra."""

COMMANDS = {
    "": [["shpy", "doctor"], ["shpy", "certify", "--help"]],
    "raytracer": [
        ["raytracer", "render", "boxes", "--size", "16x12", "-o", "boxes.png"],
        ["raytracer", "render", "t.obj", "--size", "16x12", "-o", "t.exr"],
        ["raytracer", "animate", "animated", "--size", "16x12", "--frames", "2", "-o", "animated.gif"],
    ],
    "accuracy": [["shpy", "accuracy", "program.py:root", "--domain", "a=1:8", "--samples", "20", "-o", "accuracy.png"]],
    "denoise": [
        ["raytracer", "render", "cornell", "--integrator", "path", "--samples", "1", "--size", "16x12", "--denoise"]
        + ["-o", "smooth.npy"]
    ],
    "completion": [["shpy", "--completion", "bash"], ["raytracer", "--completion", "zsh"]],
    "bench": [
        ["benchmarks", "--quick", "--only", "mandelbrot", "--targets", "numpy", "--peers", "masks", "--size", "16"]
    ],
}
"""Further commands by extra."""

SERVERS = {"view": ["shpy", "view", "program.py"], "all": ["raytracer", "view", "boxes"]}
"""Commands that serve a page, by extra."""


def run(python, folder, *arguments):
    """Run Python in a user's environment; return what it printed."""
    variables = {"SHPY_CACHE_DIR": str(folder / "cache")} | (
        {"PYTHONPATH": str(ROOT)} if "benchmarks" in arguments else {}
    )
    ran = subprocess.run(
        [python, *arguments],
        cwd=folder,
        env=environment(**variables),
        capture_output=True,
        text=True,
        timeout=HANGING,
        stdin=subprocess.DEVNULL,
    )
    assert ran.returncode == 0, f"{arguments}\n{ran.stdout}\n{ran.stderr}"
    return ran.stdout


def serve(python, folder, *arguments):
    """Start a command that serves a page, ask for the page, and end the command by Ctrl-C."""
    page = subprocess.Popen(
        [python, "-m", *arguments, "--port", "0"],
        cwd=folder,
        env=environment(SHPY_CACHE_DIR=str(folder / "cache"), PYTHONUNBUFFERED="1"),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        lines = []
        for line in page.stdout:
            lines.append(line)
            if address := re.search(r"http://\S+", line):
                break
        else:
            pytest.fail("".join(lines))
        with urllib.request.urlopen(address[0], timeout=HANGING) as answer:
            assert b"<html" in answer.read().lower()
    finally:
        page.send_signal(signal.SIGINT)
        page.communicate(timeout=HANGING)


def use(python, folder, extra):
    """Do what the documents say of an extra."""
    (folder / "program.py").write_text(PROGRAM)
    if CODE[extra]:
        run(python, folder, "-c", CODE[extra])
    for module, *arguments in COMMANDS.get(extra, ()):
        run(python, folder, "-m", module, *arguments)
    if extra in SERVERS:
        serve(python, folder, *SERVERS[extra])


def test_every_extra_is_used():
    assert set(CODE) == {"", *EXTRAS} - NOT_FOR_USERS


@pytest.mark.sampled(7)
@pytest.mark.parametrize("extra", CODE)
def test_an_extra_alone_does_what_the_documents_say(extra, tmp_path):
    use(linked(tmp_path / "environment", extra), tmp_path, extra)


LACKING = {
    "opencl": (["-c", "from program import root; root.compile('opencl')"], "pyopencl"),
    "glsl": (["-c", "from program import root; root.compile('glsl')"], "moderngl"),
    "raytracer": (["-c", "from raytracer import Mesh; Mesh.load('frame.obj')"], "mapbox-earcut"),
    "testing": (["-c", "from program import sh; sh.testing.programs()"], "hypothesis"),
    "accuracy": (["-m", "shpy", "accuracy", "program.py:root", "--domain", "a=1:8"], "mpmath"),
    "cluster": (["-c", "from program import root, sh; sh.map_blocks(root, 1)"], "dask[array]"),
    "view": (["-m", "shpy", "view", "program.py"], "starlette"),
    "notebook": (["-c", "from program import shade, sh; sh.widget(shade)"], "anywidget"),
    "completion": (["-m", "shpy", "--completion", "bash"], "shtab"),
    "picture": (["-c", "from program import shade, sh; sh.animate(shade, 'a.gif', frames=2)"], "pillow"),
    "render": (["-m", "raytracer", "render", "boxes", "-o", "boxes.png"], "pillow"),
    "exr": (["-m", "raytracer", "render", "boxes", "-o", "boxes.exr"], "openexr"),
    "denoise": (
        ["-m", "raytracer", "render", "cornell", "--integrator", "path", "--denoise", "-o", "smooth.npy"],
        "pyoidn",
    ),
    "load": (["-m", "raytracer", "render", "frame.obj", "-o", "frame.npy"], "mapbox-earcut"),
    "raytracer view": (["-m", "raytracer", "view", "boxes"], "starlette"),
    "study": (["-m", "raytracer", "study", "christen", "-o", "christen.png"], "matplotlib"),
    "raytracer cluster": (["-m", "raytracer", "render", "boxes", "--cluster", "local:2", "-o", "b.npy"], "dask[array]"),
}
"""Features beyond the core, each with the package that it asks for."""


@pytest.fixture(scope="module")
def core(tmp_path_factory):
    """The Python of an environment with the core alone, and a folder with a program."""
    folder = tmp_path_factory.mktemp("core")
    (folder / "program.py").write_text(PROGRAM)
    corners = [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)]
    lines = [*(f"v {x} {y} 0" for x, y in corners), "f " + " ".join(str(n + 1) for n in range(len(corners)))]
    (folder / "frame.obj").write_text("\n".join(lines))  # a face with a hole, by a bridge edge
    return linked(folder / "environment", ""), folder


@pytest.mark.sampled(6)
@pytest.mark.parametrize("feature", LACKING)
def test_what_the_core_lacks_is_named_with_the_command_that_installs_it(feature, core):
    python, folder = core
    arguments, package = LACKING[feature]
    ran = subprocess.run(
        [python, *arguments],
        cwd=folder,
        env=environment(SHPY_CACHE_DIR=""),
        capture_output=True,
        text=True,
        timeout=HANGING,
    )
    assert ran.returncode != 0
    assert re.search(rf"pip install .*{re.escape(package)}", ran.stderr + ran.stdout), ran.stderr + ran.stdout
    if arguments[0] == "-m":
        assert "Traceback" not in ran.stderr


@pytest.mark.slow
@pytest.mark.parametrize("extra", sorted(set(CODE)))
def test_an_extra_installed_by_pip_does_what_the_documents_say(extra, tmp_path):
    use(installed(tmp_path / "environment", extra), tmp_path, extra)


@pytest.mark.slow
def test_every_benchmark_runs_after_its_extra_is_installed(tmp_path):
    """The files of the clone and the extra `bench`, as `scripts/setup bench` installs it, peers included."""
    python = installed(tmp_path / "environment", "bench")
    run(python, tmp_path, "-m", "benchmarks", "--quick", "--peers", "none", "--json", "bench.json")
    assert (tmp_path / "bench.json").stat().st_size > 1000
