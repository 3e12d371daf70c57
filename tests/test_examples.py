"""Every example runs on every backend, and what it shows is right."""

import importlib
import itertools
import pathlib
import subprocess
import sys

import numpy as np
import pytest
from patience import HANGING

import shpy as sh
from raytracer import Camera, Intersector, Path, Renderer, Scene, render
from raytracer.meshes.shapes import box, floor

BOXES = Scene.builtin("boxes")
EXAMPLES = pathlib.Path(__file__).parents[1] / "examples"
NAMES = sorted(path.stem for path in EXAMPLES.glob("*.py") if path.stem != "pictures")

on_every_backend = pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])


def on_one_backend(test):
    """Run a test on one backend by default, and on the others with `-m slow`."""
    return pytest.mark.sampled(3)(on_every_backend(test))


@pytest.fixture(autouse=True)
def _importable(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))


def example(name):
    return importlib.import_module(name)


def pixels_of(program, size, backend="numpy", time=0.0, mouse=(0, 0, 0, 0), **params):
    """The numbers of a program of pixels, with other values of its Params."""
    before = {name: program.params[name].value for name in params}
    try:
        for name, value in params.items():
            program.params[name].value = value
        return sh.screen.drawn(program, sh.screen.Moment(size, time=time, mouse=mouse), backend=backend)
    finally:
        for name, value in before.items():
            program.params[name].value = value


def test_no_example_goes_untested():
    here = pathlib.Path(__file__)
    tested = here.read_text() + here.with_name("gradients").joinpath("test_derivatives_in_examples.py").read_text()
    assert NAMES
    assert [name for name in NAMES if f'example("{name}")' not in tested] == []


@pytest.mark.parametrize("name", NAMES)
def test_examples_are_short(name):
    assert len((EXAMPLES / f"{name}.py").read_text().splitlines()) < 80


@pytest.mark.parametrize("name", ["life", "trace"])
def test_examples_run_as_scripts(name, tmp_path):
    done = subprocess.run(
        [sys.executable, EXAMPLES / f"{name}.py"], cwd=tmp_path, capture_output=True, text=True, timeout=HANGING
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


SHOWN = {
    "mandelbrot": lambda m, backend: m.draw(60, 40, backend),
    "planet": lambda m, backend: m.draw(48, 48, backend),
    "patterns": lambda m, backend: m.draw(16, backend),
    "textures": lambda m, backend: m.scene.compile(backend)(shape=(18, 32)),
    "algebra": lambda m, backend: m.draw(40, backend),
    "blur": lambda m, backend: m.blurred(np.linspace(0, 1, 900, dtype=np.float32).reshape(15, 20, 3), 5, backend),
    "nbody": lambda m, backend: np.hstack(m.simulation(*m.galaxies(64), 0.01, backend)()),
    "life": lambda m, backend: m.game(m.r_pentomino(32), 20, backend)["age"].numpy(),
    "gray_scott": lambda m, backend: np.stack(m.pattern(24, 30, backend)),
    "heat": lambda m, backend: m.steady(*m.plate(12, 18), backend)[0],
    "particles": lambda m, backend: m.life(1500, 3, 40, backend)[1].numpy(),
    "equalize": lambda m, backend: m.equalized(m.photograph(40, 30, backend)).numpy(),
    "raymarch": lambda m, backend: pixels_of(m.raymarch, (40, 24), backend, time=1.5),
    "contours": lambda m, backend: pixels_of(m.contours, (60, 40), backend, time=1.5),
    "bumps": lambda m, backend: pixels_of(m.bumps, (60, 40), backend, time=1.5),
    "curvature": lambda m, backend: pixels_of(m.curvature, (60, 40), backend, time=1.5),
    "filaments": lambda m, backend: pixels_of(m.filaments, (60, 40), backend),
    "fitting": lambda m, backend: np.hstack(m.fitted(16, 4, backend)[0]),
    "newton": lambda m, backend: pixels_of(m.newton, (60, 40), backend),
    "voronoi": lambda m, backend: pixels_of(m.voronoi, (60, 40), backend, time=1.5),
    "warp": lambda m, backend: pixels_of(m.warp, (60, 40), backend, time=1.5),
    "cubemap": lambda m, backend: m.by_cube_map((16, 12), 8, 4, backend=backend).pixels,
    "occlusion": lambda m, backend: m.occlusion(Scene.framed(box()), (16, 12), 4, backend),
    "fabrics": lambda m, backend: render(m.fabrics(), (12, 8), integrator=Path(samples=1), backend=backend).pixels,
    "whitted": lambda m, backend: m.tracer_of(BOXES, (24, 18), backend=backend).compile(backend)(shape=(18, 24)),
    "metals": lambda m, backend: render(m.metals(), (12, 8), integrator=Path(samples=1), backend=backend).pixels,
    "studio": lambda m, backend: render(m.studio(), (12, 8), integrator=Path(samples=1), backend=backend).pixels,
    "meadow": lambda m, backend: render(m.meadow(30), (12, 8), accel="instances", backend=backend).pixels,
}


@pytest.mark.sampled(28)
@pytest.mark.parametrize("name", SHOWN)
def test_every_backend_shows_the_same_to_the_last_bit(name):
    shown = [SHOWN[name](example(name), backend) for backend in ("numpy", "opencl", "glsl")]
    np.testing.assert_array_equal(shown[0], shown[1])
    np.testing.assert_array_equal(shown[0], shown[2])


def test_newton_reaches_the_roots():
    m = example("newton")
    picture = pixels_of(m.newton, (60, 60))
    assert np.isfinite(picture).all()
    kinds = np.argmax(picture, axis=-1)
    assert (np.bincount(kinds.ravel(), minlength=3) > 0.2 * kinds.size).all()
    np.testing.assert_array_equal(kinds[:, 55], 0)  # the basin of the root 1, far to the right


@on_one_backend
def test_mandelbrot(backend):
    m = example("mandelbrot")
    inside = m.mandelbrot.compile(backend)([(0, 0), (-1, 0), (-0.12, 0.74), (-0.6, 0)])
    assert np.all(inside == m.ITERATIONS)
    leaving = m.mandelbrot.compile(backend)([(2, 2), (0.5, 0.5), (-2.1, 0)])
    assert np.all(leaving < 12)
    stays = m.mandelbrot.compile(backend)(m.points(60, 40)) == m.ITERATIONS
    np.testing.assert_array_equal(stays[:20], stays[:19:-1])  # the set mirrors in the real axis
    picture = m.draw(60, 40, backend)
    assert np.all(picture[stays] == 0)
    assert picture[~stays].sum(axis=-1).min() > 0


@on_every_backend
def test_bodies_attract_each_other_as_newton_says(backend):
    m = example("nbody")
    x, v, mass = m.galaxies(64)
    before = mass @ v
    advance = m.simulation(x, v, mass, 0.01, backend)
    away = x[None] - x[:, None]
    pull = (mass[:, None] * away / (np.sum(away**2, axis=-1, keepdims=True) + m.SOFTENING**2) ** 1.5).sum(axis=1)
    moved, faster = advance()
    np.testing.assert_allclose(faster, v + 0.01 * pull, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(moved, x + 0.01 * faster, rtol=1e-5, atol=1e-6)
    for _ in range(50):
        moved, faster = advance()
    np.testing.assert_allclose(mass @ faster, before, atol=1e-4)
    assert m.picture(moved, size=32).max() > 0.3


@on_one_backend
def test_planet(backend):
    m = example("planet")
    picture = m.draw(48, 48, backend)
    assert picture.shape == (48, 48, 3)
    assert np.isfinite(picture).all()
    assert picture[:2, -2:].max() < 0.2  # space
    assert picture[8:24, 8:24].mean() > 3 * picture[-14:, -14:].mean()  # the side that the light comes from
    sea = m.sea_level.value
    m.sea_level.value = 9  # all under water: no channel above the colours of water and clouds, and far less red
    try:
        drowned = m.draw(48, 48, backend)
    finally:
        m.sea_level.value = sea
    assert drowned[..., 0].mean() < picture[..., 0].mean()


@on_one_backend
def test_blur(backend):
    m = example("blur")
    point = np.zeros((21, 21, 3), np.float32)
    point[10, 10] = 1
    spread = m.blurred(point, 5, backend)
    np.testing.assert_allclose(spread.sum(axis=(0, 1)), 1, rtol=1e-5)
    np.testing.assert_allclose(spread, spread[::-1, ::-1], atol=1e-7)
    np.testing.assert_allclose(spread, spread.swapaxes(0, 1), atol=1e-7)
    offsets = np.arange(-5, 6)
    weights = np.exp(-0.5 * (offsets / 2.5) ** 2)
    np.testing.assert_allclose(spread[5:16, 10, 0], weights * weights[5] / weights.sum() ** 2, atol=1e-6)
    flat = np.full((8, 12, 3), 0.25, np.float32)
    np.testing.assert_allclose(m.blurred(flat, 3, backend), flat, rtol=1e-6)


@on_one_backend
def test_life(backend):
    m = example("life")
    board = m.r_pentomino(32)
    age = np.zeros(board.shape, np.float32)
    streams = m.game(board, 30, backend)
    for _ in range(30):
        around = sum(np.roll(board, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)) - board
        board = ((around == 3) | ((board == 1) & (around == 2))).astype(np.int32)
        age = np.where(board == 1, 1, np.float32(0.97) * age)
    np.testing.assert_array_equal(streams["cells"], board)
    np.testing.assert_array_equal(streams["age"], age)


@on_one_backend
def test_gray_scott(backend):
    m = example("gray_scott")
    u, v = m.drops(24)
    for _ in range(30):
        turned = u * v * v
        more = []
        for chemical in (u, v):
            at = [[np.roll(chemical, (i, j), (0, 1)) for j in (-1, 0, 1)] for i in (-1, 0, 1)]
            beside, across = at[0][1] + at[2][1] + at[1][0] + at[1][2], at[0][0] + at[0][2] + at[2][0] + at[2][2]
            more.append(0.2 * beside + 0.05 * across - chemical)
        u, v = u + more[0] - turned + m.FEED * (1 - u), v + 0.5 * more[1] + turned - (m.FEED + m.KILL) * v
    for found, expected in zip(m.pattern(24, 30, backend), (u, v), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-5)
    assert v.max() > 0.1


@on_one_backend
def test_heat(backend):
    m = example("heat")
    heat, free = m.plate(12, 18)
    found, rounds = m.steady(heat, free, backend)
    assert rounds > 10
    np.testing.assert_array_equal(found[~free], heat[~free].astype(np.float32))
    mean = 0.25 * (np.roll(found, 1, 0) + np.roll(found, -1, 0) + np.roll(found, 1, 1) + np.roll(found, -1, 1))
    assert np.abs(mean - found)[free].max() < 1.01 * m.TOLERANCE
    assert found[free].min() > 0


@on_one_backend
def test_particles(backend):
    m = example("particles")
    seen, light = (stream.numpy() for stream in m.life(1500, 1, 40, backend))
    at = (m.SIZE * np.random.default_rng(7).random((1500, 2))).astype(np.float32)
    away = at[None] - at[:, None]
    away -= np.float32(m.SIZE) * np.rint(away / np.float32(m.SIZE))
    near = np.sum(away * away, axis=-1) < m.SIGHT**2
    np.testing.assert_array_equal(np.sort(seen), np.sort(near.sum(axis=0) - 1))
    assert light.shape == (40, 40, 3)
    assert 0 < light.max() <= 1

    couple = {
        "at": [(10, 10), (11, 11.5)],
        "angle": [0, np.pi / 2],
    }  # of the same cell, each sees the other on its left
    ends = np.where(np.arange(m.CELLS**2) < 2 * m.CELLS + 2, 0, 2)
    moved, counts = m.move.compile(backend)(couple, sh.Table(couple, m.Particle), sh.Table(ends, sh.Attrib1i))
    assert counts.tolist() == [1, 1]
    angle = np.array([0, np.pi / 2]) + np.radians(180 + 17)
    np.testing.assert_allclose(moved.angle, angle, rtol=1e-6)
    step = 0.67 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    np.testing.assert_allclose(moved.at, couple["at"] + step, rtol=1e-6)


@on_one_backend
def test_equalize(backend):
    m = example("equalize")
    before = m.photograph(40, 30, backend)
    after = m.equalized(before).numpy()
    counts, _ = np.histogram(before.numpy(), m.BINS, range=(0, 1))
    share = np.cumsum(counts)[(before.numpy() * m.BINS).astype(int)] / before.size
    np.testing.assert_allclose(after, share, rtol=1e-6)
    assert np.ptp(before.numpy()) < 0.2
    assert np.ptp(after) > 0.95


@on_one_backend
def test_patterns(backend):
    m = example("patterns")
    sheet = m.draw(24, backend)
    assert sheet.shape == (72, 72, 3)
    assert sheet.min() >= 0
    assert sheet.max() <= 1
    tiles = sheet.reshape(3, 24, 3, 24, 3).swapaxes(1, 2)
    assert tiles.std(axis=(2, 3)).max(axis=-1).min() > 0.05
    mosaic = tiles[1, 0]
    hue, saturation, value = (sh.library.cellnoise(sh.vec2(3, 0), 3)[k] for k in range(3))
    stone = sh.library.srgb_from_linear(sh.library.rgb_from_hsv((hue, 0.4 + 0.4 * saturation, 0.3 + 0.5 * value)))
    np.testing.assert_allclose(mosaic[1, 9], np.asarray(stone), atol=1e-5)


@on_one_backend
def test_textures(backend):
    picture = example("textures").scene.compile(backend)(shape=(90, 160))
    assert picture.shape == (90, 160, 3)
    far = picture[34:37]  # below the horizon, beside the balls
    assert np.diff(far[:, :20], axis=1).std() > 5 * np.diff(far[:, -20:], axis=1).std()
    assert picture[0].argmax(axis=-1).min() == 2
    mirror, stone = picture[12:50, 90:128], picture[12:50, 32:70]
    assert mirror[2, 19].argmax() == 2
    assert mirror[:19].min(axis=-1).max() > 0.95  # the sun, which is behind the camera
    assert stone[..., 0].mean() > stone[..., 2].mean() + 0.1


@on_one_backend
def test_algebra(backend):
    m = example("algebra")
    blue, red, marble, dented = np.split(m.draw(40, backend), 4, axis=1)
    assert np.all(blue[0, 0] == 0)
    assert blue[20, 14].argmax() == 2
    assert red[20, 14].argmax() == 0
    at = np.float32([[0.2, -0.3]])
    normal = np.array([0.2, -0.3, np.sqrt(1 - 0.13)])
    lit = 0.08 + 0.92 * max(normal @ np.array([-0.5, 0.6, 0.62]) / np.sqrt(0.25 + 0.36 + 0.3844), 0)
    expected = np.array(m.blue.value) * lit
    np.testing.assert_allclose(m.BALLS[0].compile(backend)(at)[0], expected, rtol=1e-4)
    assert marble.std() > blue.std()
    assert np.abs(dented - red).max() > 0.2


def test_raymarch():
    m = example("raymarch")
    size = (64, 36)
    picture = pixels_of(m.raymarch, size)
    assert picture[0].argmax(axis=-1).min() == 2  # the sky
    reddish = picture[..., 0] > 1.3 * picture[..., 2]
    assert 0.15 < reddish.mean() < 0.5
    assert np.all(pixels_of(m.raymarch, size, clay=(0.05, 0.05, 0.9))[reddish].argmax(axis=-1) == 2)
    around = pixels_of(m.raymarch, size, mouse=(size[0], 0, 0, 0))
    assert np.mean(np.abs(around - picture) > 0.05) < 0.02  # a whole turn
    sharp, soft = (pixels_of(m.raymarch, size, blur=blur) for blur in (0.02, 0.5))
    assert not np.any(np.abs(sharp - soft)[0] > 0)
    # What a soft shadow covers in part is darker; its core stays as it is.
    assert soft.sum() < sharp.sum() - 1
    assert soft.max() <= sharp.max() + 1e-6


def test_voronoi():
    m = example("voronoi")
    size = (80, 40)
    share = {
        width: np.isclose(pixels_of(m.voronoi, size, width=width, cells=4), m.border.value, atol=1e-3)
        .all(axis=-1)
        .mean()
        for width in (0.0, 0.15, 0.3)
    }
    assert share[0.0] < 0.01 < share[0.15] < 0.5 * share[0.3]
    # A pixel is 0.1 wide: what numpy finds nearer to a border than 0.2 has its colour, and nothing beyond 0.4.
    y, x = (np.indices((40, 80)) + 0.5 - np.array([20, 40]).reshape(2, 1, 1)) / 40 * 4 + 40
    cell = np.stack(np.meshgrid(np.arange(25, 55), np.arange(30, 50)), axis=-1).reshape(-1, 2)

    @sh.program
    def point(cell: sh.Attrib2f) -> sh.Attrib2f:
        return m.point_in(cell, 0.0)

    where = point(cell.astype(np.float32))
    away = where[None] - np.stack([x, y], axis=-1).reshape(-1, 1, 2)
    nearest = away[np.arange(len(away)), np.argmin(np.sum(away**2, axis=-1), axis=1)]
    between = away - nearest[:, None]
    with np.errstate(invalid="ignore"):
        lines = np.sum(0.5 * (away + nearest[:, None]) * between, axis=-1) / np.linalg.norm(between, axis=-1)
    edge = np.nanmin(np.where(np.linalg.norm(between, axis=-1) > 1e-3, lines, np.nan), axis=1).reshape(40, 80)
    inked = np.isclose(pixels_of(m.voronoi, size, width=0.3, cells=4, rings=False), m.border.value, atol=1e-3).all(
        axis=-1
    )
    assert np.all(inked[edge < 0.19])
    assert not np.any(inked[(edge > 0.41) & (np.linalg.norm(nearest, axis=-1).reshape(40, 80) > 0.3)])


def test_warp():
    m = example("warp")
    plain, warped = (pixels_of(m.warp, (80, 45), strength=strength) for strength in (0, 4))
    steps = [np.abs(np.diff(picture, axis=1)).mean() for picture in (plain, warped)]
    assert steps[1] > 2 * steps[0]
    smooth = pixels_of(m.warp, (80, 45), octaves=1, strength=0)
    assert np.abs(np.diff(smooth, axis=1)).mean() < 0.6 * steps[0]
    assert plain.min() >= 0
    assert plain.max() <= 1


def test_occlusion():
    """A plain sees all of the sky; beside a wall of height h, at a distance d, it sees (1 + d / sqrt(d² + h²)) / 2."""
    m = example("occlusion")
    wall = box((2, 60, 60)).moved((-1, 0, 0))
    scene = Scene([floor(60), wall], camera=Camera((6, 2, 0), (6, 0, 0.1), (1, 0, 0), fov=2))  # d is 6, h is 30
    assert abs(m.occlusion(scene, (8, 8), 64, "numpy").mean() - 0.598) < 0.03  # four standard deviations
    plain = m.occlusion(Scene([floor(9)], camera=Camera((0, 3, 0.1), (0, 0, 0))), (8, 6), 16, "numpy")
    np.testing.assert_array_equal(plain, 1)


@on_one_backend
def test_whitted_gives_the_picture_of_the_integrator_to_the_bit(backend):
    picture = SHOWN["whitted"](example("whitted"), backend)
    np.testing.assert_array_equal(picture, render(BOXES, (24, 18), backend=backend).pixels)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 100


@on_one_backend
def test_raster_gives_the_traced_picture_where_both_see_the_same_triangle(backend):
    """Rays start up to 2**-13 of the distance beside the traced ones, and only at the edge of a light that shows."""
    size = (48, 36)
    buffer = example("raster").rasterise(BOXES, size)
    picture, traced = render(BOXES, primary=buffer, backend=backend), render(BOXES, size, backend="numpy")
    same = (buffer.object == traced.object_id) & np.isclose(buffer.normal, traced.normal, atol=1e-3).all(axis=-1)
    assert (same | ((buffer.object < 0) & (traced.object_id < 0))).mean() > 0.995
    assert (np.abs(picture.pixels - traced.pixels).max(axis=-1)[same] < 2e-4).mean() > 0.995
    np.testing.assert_allclose(picture.depth[same], traced.depth[same], rtol=2e-6)


def test_trace():
    m = example("trace")
    steps = m.cube_root.trace(a=2.0, start=0.01)
    step, _ = m.jump(steps)
    assert step.name in ("slope", "change", "x")
    assert abs(float(steps[-1].value) - 2 ** (1 / 3)) < 1e-6
    assert step.iterations == (2,)
    worst = int(np.argmax(m.slow.compile("numpy")(2.0, shape=1000)))
    counted = [s for s in m.slow.trace(a=2.0, shape=1000, at=worst) if s.name == "count" and s.iterations]
    assert [s.iterations for s in counted] == [(int(s.value),) for s in counted]
    assert int(counted[-1].value) == m.slow.compile("numpy")(2.0, shape=1000)[worst]
    slope, change = (next(s for s in steps if s.name == name) for name in ("slope", "change"))
    assert change.loc.line == slope.loc.line + 1
    assert float(slope.value) == np.float32(3) * np.float32(0.01) * np.float32(0.01)


@pytest.mark.slow
def test_fabrics():
    """Each cloth has its own colour, and its sheen makes it brighter than it is without."""
    m = example("fabrics")
    image = render(m.fabrics(), (60, 32), integrator=Path(samples=4), backend="numpy")
    assert (image.object_id >= 0).all()  # the wall closes the picture
    for k, channel in enumerate((0, 1, 2)):
        seen = image.pixels[image.object_id == 1 + 2 * k]
        assert len(seen) > 20
        assert seen.mean(axis=0).argmax() == channel


@pytest.mark.slow
def test_metals():
    """The balls have the colours of their metals, and sharp ones show the lamps."""
    m = example("metals")
    image = render(m.metals(), (90, 60), integrator=Path(samples=8), backend="numpy")
    gold, blue = (image.pixels[image.object_id == 1 + k].mean(axis=0) for k in (0, 3))
    assert gold[0] > 1.5 * gold[2]
    assert blue[2] > 1.3 * blue[0]
    sharp, rough = (image.pixels[image.object_id == 1 + 5 * row].max() for row in (0, 2))
    assert sharp > 2 * rough


@pytest.mark.slow
def test_meadow():
    """Tufts, poppies and stones share triangles."""
    renderer = Renderer(example("meadow").meadow(), backend="numpy")
    assert len(renderer.layout.triangles) < 10**5 < 10**7 < renderer.scene.triangles


@pytest.mark.slow
def test_studio():
    """Amber is yellow, paint is red, and the brushed disk has a bright fan, which a program without it has not."""
    m = example("studio")
    image = render(m.studio(), (60, 40), integrator=Path(samples=16, bounces=6), backend="opencl")
    amber, paint = (image.pixels[image.object_id == k].mean(axis=0) for k in (5, 4))
    assert amber[0] > 2 * amber[2]
    assert paint[0] > 3 * paint[1]
    disk = image.pixels[image.object_id == 2].mean(axis=1)
    assert disk.std() > 0.3 * disk.mean()


@pytest.mark.slow
def test_cube_maps_mirror_far_things_alone():
    """Beside exact rays a cube map is right but for what is near; a layered depth cube errs far less."""
    m = example("cubemap")
    mapped, layered, exact = (
        m.by_cube_map((48, 40), 64, 6, backend="numpy"),
        *(m.by_rays((48, 40), accel, 6, backend="numpy") for accel in ("ldc:128", "bvh")),
    )
    pot = exact.object_id == exact.object_id.max()
    assert pot.sum() > 200
    np.testing.assert_allclose(mapped.pixels[~pot], exact.pixels[~pot], atol=1e-5)
    off = [np.sqrt(((image.srgb[pot].astype(float) - exact.srgb[pot]) ** 2).mean()) for image in (mapped, layered)]
    assert off[1] < off[0] / 2
    right = abs(mapped.pixels[pot] - exact.pixels[pot]).max(axis=1) < 0.02
    assert 0.3 < right.mean() < 0.9, "the sky is mirrored right, the floor and the pot itself are not"


def test_the_faces_of_a_cube_map_are_what_is_seen_in_their_directions():
    """The pictures of six cameras have the colours of the directions to their pixels."""
    m = example("cubemap")
    scene = m.surroundings()
    sky = m.cube_map(scene, m.MIDDLE, 6, backend="numpy")
    ways = m.TextureCube.directions(6).reshape(-1, 3)

    @sh.program
    def read(way: sh.Vector3f) -> sh.Color3f:
        return sky(way)

    colors = read.compile("numpy")(ways)
    hits = Intersector(scene, backend="numpy").intersect(np.broadcast_to(m.MIDDLE, ways.shape), ways)
    nothing = hits.triangle < 0
    assert 0.2 < nothing.mean() < 0.6
    np.testing.assert_allclose(colors[nothing], np.broadcast_to(scene.background, (nothing.sum(), 3)), atol=1e-6)
    assert (abs(colors[~nothing] - scene.background).max(axis=1) > 0.02).all()


def test_a_fitted_texture_comes_nearer_to_its_picture_at_each_step():
    m = example("fitting")
    (target, *panels), errors = m.fitted(24, 6, "numpy")
    assert all(later < earlier for earlier, later in itertools.pairwise(errors))
    left = [float(np.sqrt(((panel - target) ** 2).sum(axis=-1).mean())) for panel in panels]
    assert left[1] < errors[-1] < left[0] * 1.01
