"""Golden results: every example and built-in scene has the bits of the files in `golden`, on every backend.

A bit that changes is a fault, or a change of the example; then `--shpy-update -m "slow or not slow"` writes the file
anew. Pictures lie beside the files. One example and one of 12 scenes runs by default.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

import shpy as sh
from raytracer import Renderer, Scene
from raytracer.meshes.shapes import box
from raytracer.scene.scene import BUILTIN
from shpy.run.kernel import Kernel

EXAMPLES = Path(__file__).parents[2] / "examples"
BACKENDS = ("numpy", "opencl-8", "glsl")
DRAWN = {
    "raster": "OpenGL rasterises it",
    "pictures": "it saves what others draw",
    "cubemap": "`render` makes its programs",
    "metals": "`render` makes its programs",
    "fabrics": "`render` makes its programs",
    "studio": "`render` makes its programs",
    "meadow": "`render` makes its programs",
}
"""Files of examples/ without a program of their own, and why."""

SIZE = (16, 24)
ROWS, COLUMNS = np.indices(SIZE, np.float32)
UV = np.stack([COLUMNS / SIZE[1], ROWS / SIZE[0]], axis=-1)
AT = UV * np.float32(2.25) - np.float32(1.125)
RNG = np.random.default_rng(53)
GRAY = RNG.random(SIZE, np.float32)
BOARD = RNG.integers(0, 2, SIZE, np.int32)
ON_SCREEN = {"uv": UV, "resolution": SIZE[::-1], "time": 1.5}
PARTICLES = {"at": RNG.uniform(0, 250, (30, 2)).astype(np.float32), "angle": RNG.uniform(0, 6, 30).astype(np.float32)}


def kernel_in(function):
    """Return the program whose kernel a function closes over."""
    contents = (cell.cell_contents for cell in function.__closure__)
    return next(sh.Program(value.recorded) for value in contents if isinstance(value, Kernel))


def bodies(m):
    position, velocity, mass = m.galaxies(32)
    return kernel_in(m.simulation(position, velocity, mass, 0.01, "numpy")), position.astype(np.float32)


CASES = {
    "mandelbrot": lambda m: (m.palette << m.mandelbrot, {"c": AT * 1.5 - np.float32([0.6, 0])}),
    "planet": lambda m: (m.planet, {"shape": SIZE}),
    "patterns": lambda m: (m.painted(m.marble), {"shape": SIZE}),
    "patterns.water": lambda m: (m.painted(m.water), {"shape": SIZE}),
    "patterns.mosaic": lambda m: (m.painted(m.mosaic), {"shape": SIZE}),
    "textures": lambda m: (m.scene, {"shape": SIZE}),
    "algebra": lambda m: (m.BALLS[3], {"at": AT}),
    "algebra.marble": lambda m: (m.BALLS[2], {"at": AT}),
    "blur": lambda m: (m.gaussian(3), {"picture": sh.Texture2D(np.stack([GRAY] * 3, -1)), "shape": SIZE}),
    "nbody": lambda m: (lambda program, x: (program, {"x": x}))(*bodies(m)),
    "life": lambda m: (m.generation, {"cells": BOARD, "shape": SIZE}),
    "life.fade": lambda m: (m.fade, {"age": GRAY, "cells": BOARD}),
    "gray_scott": lambda m: (m.react, {"u": GRAY, "v": GRAY * GRAY, "shape": SIZE}),
    "heat": lambda m: (m.relax, {"heat": GRAY, "shape": SIZE}),
    "particles": lambda m: (
        m.move, {"p": PARTICLES, "others": PARTICLES, "ends": np.linspace(0, 30, m.CELLS**2, dtype=np.int32)}
    ),
    "particles.glow": lambda m: (m.glow, {"crowds": BOARD * 7, "shape": SIZE}),
    "equalize": lambda m: (m.mountains, {"at": AT}),
    "equalize.spread": lambda m: (
        m.spread, {"light": GRAY, "darker": np.arange(256, dtype=np.int32), "count": np.float32(256)}
    ),
    "raymarch": lambda m: (m.raymarch, ON_SCREEN),
    "voronoi": lambda m: (m.voronoi, ON_SCREEN),
    "warp": lambda m: (m.warp, ON_SCREEN),
    "contours": lambda m: (m.contours, ON_SCREEN),
    "bumps": lambda m: (m.bumps, ON_SCREEN),
    "curvature": lambda m: (m.curvature, ON_SCREEN),
    "filaments": lambda m: (m.filaments, {name: ON_SCREEN[name] for name in ("uv", "resolution")}),
    "fitting": lambda m: (m.picture, {"uv": UV}),
    "newton": lambda m: (m.newton, {name: ON_SCREEN[name] for name in ("uv", "resolution")}),
    "trace": lambda m: (m.cube_root, {"a": GRAY + 1, "start": np.float32(1)}),
    "trace.slow": lambda m: (m.slow, {"a": GRAY[0]}),
    "whitted": lambda m: (m.tracer_of(Scene.builtin("boxes"), SIZE[::-1], backend="numpy"), {"shape": SIZE}),
    "occlusion": lambda m: (m.sky_of(Scene.framed(box()), SIZE[::-1], 4, "numpy"), {"shape": SIZE}),
}  # fmt: skip
"""The program of each example, and its inputs; a name after the point tells several of one file apart."""


CHAINS = {
    "life": lambda m: (sh.repeat(m.life, 20), {"cells": BOARD, "age": GRAY}),
    "gray_scott": lambda m: (sh.repeat(m.react, 30), {"u": GRAY, "v": GRAY * GRAY}),
    "heat": lambda m: (sh.loop(m.relax, where="free"), dict(zip(("heat", "free"), m.plate(*SIZE), strict=True))),
}
"""The chain of each example that has one, and its streams."""


def rendered(scene):
    """Return the program of a scene's picture with the values of its Params for it."""
    renderer = Renderer(scene, backend="numpy")
    renderer.render(SIZE[::-1])
    return renderer.program


def test_every_example_has_a_golden_result():
    files = {path.stem for path in EXAMPLES.glob("*.py")}
    assert {name.partition(".")[0] for name in CASES} == files - DRAWN.keys()


@pytest.mark.sampled(31)
@pytest.mark.parametrize("name", CASES)
def test_examples_have_their_bits(name, monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    example = name.partition(".")[0]
    monkeypatch.delitem(sys.modules, example, raising=False)  # other tests set its Params
    program, inputs = CASES[name](importlib.import_module(example))
    sh.testing.assert_golden(program, name=f"example.{name}", backends=BACKENDS, **inputs)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", CHAINS)
def test_chains_of_examples_have_their_bits(name, monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    chain, streams = CHAINS[name](importlib.import_module(name))
    sh.testing.assert_golden(chain, name=f"chain.{name}", **streams)


@pytest.mark.sampled(12)
@pytest.mark.parametrize("name", BUILTIN)
def test_built_in_scenes_have_their_bits(name):
    sh.testing.assert_golden(rendered(Scene.builtin(name)), name=f"scene.{name}", backends=BACKENDS, shape=SIZE)
