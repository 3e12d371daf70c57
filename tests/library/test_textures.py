"""Textures: against numpy, and the same bits on every backend."""

import numpy as np
import pytest
from backends.running import covering

import shpy as sh
from shpy import library

RNG = np.random.default_rng(6)
IMAGE = RNG.uniform(0, 1, (5, 7, 3)).astype(np.float32)
SPACE = RNG.uniform(0, 1, (3, 4, 5)).astype(np.float32)
ODD = [[0, 1], [-0.0, 0.5], [-1e9, 1e9], [np.nan, 0.5], [np.inf, -np.inf], [3e38, 1e-40]]
UV = np.concatenate([RNG.uniform(-2.5, 3.5, (80, 2)), ODD]).astype(np.float32)
UVW = np.concatenate([RNG.uniform(-2.5, 3.5, (80, 3)), [[np.nan, 1, -1], [np.inf, 1e9, -0.0]]]).astype(np.float32)
WRAPS = {
    "clamp": lambda i, n: np.clip(i, 0, n - 1),
    "repeat": lambda i, n: i % n,
    "mirror": lambda i, n: np.minimum(i % (2 * n), 2 * n - 1 - i % (2 * n)),
}
on_every_backend = pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])


def read(texture, type=sh.TexCoord2f, *more):
    def sampled(uv):
        return texture(uv, *more)

    sampled.__annotations__["uv"] = type
    return sh.program(sampled)


FLAT = ["mirror", ("repeat", "clamp"), ("clamp", "mirror"), "repeat", "clamp"]
DEEP = ["clamp", ("mirror", "repeat", "clamp")]
FILTERS = ["nearest", "linear", "cubic"]


@pytest.mark.sampled(18)
@pytest.mark.parametrize("wrap", FLAT)
@pytest.mark.parametrize("filter", FILTERS)
def test_all_backends_give_the_same_bits(filter, wrap):
    program = read(sh.Texture2D(IMAGE, filter=filter, wrap=wrap, name="image"))
    sh.testing.assert_equivalent(program, UV, backends=covering(FLAT.index(wrap) + FILTERS.index(filter)))


@pytest.mark.sampled(6)
@pytest.mark.parametrize("filter", FILTERS)
@pytest.mark.parametrize("wrap", DEEP)
def test_all_backends_give_the_same_bits_in_space(filter, wrap):
    program = read(library.Texture3D(SPACE, filter=filter, wrap=wrap, name="space"), sh.TexCoord3f)
    sh.testing.assert_equivalent(program, UVW, backends=covering(DEEP.index(wrap) + FILTERS.index(filter) + 1))


@pytest.mark.parametrize("kind", ["uint8", "uint16", ">u2", "int16", "uint32", "int64", "float16", "float64"])
def test_pictures_of_unsigned_levels_go_from_0_to_1(kind):
    """Other numbers stay: an index, a height."""
    dtype = np.dtype(kind)
    levels = np.array([[0, 1, 100, np.iinfo(dtype).max if dtype.itemsize < 4 and dtype.kind == "u" else 127]], dtype)
    most = {"uint8": 255, "uint16": 65535}.get(dtype.name, 1)
    wanted = levels.astype(np.float32) / np.float32(most)
    for image in (levels, np.repeat(levels[..., None], 3, axis=-1)):
        texture = sh.Texture2D(image, filter="nearest")
        found = read(texture).compile("numpy")(centers((1, 4)).astype(np.float32))
        assert np.array_equal(found if found.ndim == 2 else found[..., 0], wanted)
        texture.update(image[:, ::-1])
        found = read(texture).compile("numpy")(centers((1, 4)).astype(np.float32))
        assert np.array_equal(found if found.ndim == 2 else found[..., 0], wanted[:, ::-1])


def centers(shape):
    """Return the coordinates of an image's pixels, the first one along the last axis."""
    grid = np.meshgrid(*[(np.arange(n) + 0.5) / n for n in shape], indexing="ij")
    return np.stack(grid[::-1], axis=-1)


@pytest.mark.sampled(9)
@on_every_backend
@pytest.mark.parametrize("wrap", WRAPS)
def test_the_wrap_of_an_axis_is_a_sequence_of_indices(wrap, backend):
    row = np.arange(5, dtype=np.float32)
    indices = np.arange(-12, 18)
    uv = np.stack([(indices + 0.5) / 5, np.full(30, 0.5)], axis=-1)
    expected = WRAPS[wrap](indices, 5)
    if wrap == "mirror":
        assert expected[12:24].tolist() == [0, 1, 2, 3, 4, 4, 3, 2, 1, 0, 0, 1]
    nearest = sh.Texture2D(row[None], filter="nearest", wrap=wrap, name="row")
    linear, cubic = (
        sh.Texture2D(row[None], filter=filter, wrap=(wrap, "clamp"), name=filter) for filter in ("linear", "cubic")
    )
    upright = sh.Texture2D(row[:, None], filter="nearest", wrap=("clamp", wrap), name="upright")

    @sh.program
    def sampled(uv: sh.TexCoord2f):
        return nearest(uv), upright(uv.yx), linear(uv), cubic(uv)

    for n, found in enumerate(sampled.compile(backend)(uv)):
        np.testing.assert_allclose(found, row[expected], rtol=0, atol=2e-5 if n > 1 else 0)


KERNELS = {
    "linear": lambda x: np.maximum(1 - abs(x), 0),
    "cubic": lambda x: np.where(
        abs(x) < 1,
        1.5 * abs(x) ** 3 - 2.5 * x**2 + 1,
        np.where(abs(x) < 2, -0.5 * abs(x) ** 3 + 2.5 * x**2 - 4 * abs(x) + 2, 0),
    ),
}


def resampled(image, places, wraps, kernel):
    """The sum of all texels within reach, weighted by the distance along each axis (Keys 1981), in binary64."""
    shape = image.shape[: places.shape[-1]]
    total = 0
    for offset in np.ndindex(*[4] * len(shape)):
        index, weight = [], 1
        for axis, n in enumerate(shape):
            at = places[:, len(shape) - 1 - axis].astype(np.float64) * n - 0.5
            i = np.floor(at).astype(int) + offset[axis] - 1
            weight = weight * KERNELS[kernel](at - i)
            index.append(WRAPS[wraps[len(shape) - 1 - axis]](i, n))
        texels = image[tuple(index)]
        total = total + weight.reshape(-1, *[1] * (texels.ndim - 1)) * texels
    return total


@pytest.mark.sampled(3)
@on_every_backend
@pytest.mark.parametrize("filter", KERNELS)
def test_filters_are_convolutions(filter, backend):
    wraps = ("mirror", "repeat", "clamp")
    flat = sh.Texture2D(IMAGE, filter=filter, wrap=wraps[:2], name="image")
    np.testing.assert_allclose(
        read(flat).compile(backend)(UV[:80]), resampled(IMAGE, UV[:80], wraps, filter), atol=2e-5
    )
    deep = library.Texture3D(SPACE, filter=filter, wrap=wraps, name="space")
    found = read(deep, sh.TexCoord3f).compile(backend)(UVW[:80])
    np.testing.assert_allclose(found, resampled(SPACE, UVW[:80], wraps, filter), atol=2e-5)


@pytest.mark.sampled(6)
@on_every_backend
@pytest.mark.parametrize("filter", ["linear", "cubic"])
def test_smooth_filters_reproduce_texels_and_ramps(filter, backend):
    image = sh.Texture2D(IMAGE, filter=filter, name="image")
    np.testing.assert_allclose(read(image).compile(backend)(centers((5, 7))), IMAGE, atol=2e-6)
    rows, columns = np.mgrid[:9, :9]
    ramp = sh.Texture2D(0.25 * rows - 0.5 * columns + 3, filter=filter, name="ramp")
    uv = RNG.uniform(2 / 9, 7 / 9, (60, 2))  # where no texel of the border is in reach
    expected = 0.25 * (uv[:, 1] * 9 - 0.5) - 0.5 * (uv[:, 0] * 9 - 0.5) + 3
    np.testing.assert_allclose(read(ramp).compile(backend)(uv), expected, atol=1e-5)


@pytest.mark.sampled(3)
@on_every_backend
def test_a_texture_in_space_has_numpys_axes(backend):
    nearest = library.Texture3D(SPACE, filter="nearest", name="space")
    np.testing.assert_array_equal(read(nearest, sh.TexCoord3f).compile(backend)(centers(SPACE.shape)), SPACE)
    assert nearest.shape == (3, 4, 5)
    nearest.update(2 * SPACE)
    np.testing.assert_array_equal(read(nearest, sh.TexCoord3f).compile(backend)(centers(SPACE.shape)), 2 * SPACE)


# Mipmaps


@pytest.mark.sampled(3)
@on_every_backend
def test_level_0_is_the_image(backend):
    for wrap in ("clamp", ("mirror", "repeat")):
        plain, mipmap = sh.Texture2D(IMAGE, wrap=wrap, name="image"), library.Mipmap(IMAGE, wrap=wrap, name="mipmap")
        program = read(lambda uv, p=plain, m=mipmap: (p(uv), *(m(uv, level) for level in (0, -3.5, np.nan))))
        wanted, *levels = program.compile(backend)(UV)
        for found in levels:
            np.testing.assert_array_equal(found, wanted)


@pytest.mark.sampled(3)
@on_every_backend
def test_each_level_is_half_of_the_one_before(backend):
    image = RNG.uniform(0, 1, (12, 4))
    mipmap = library.Mipmap(image, name="mipmap")
    assert mipmap.count == 4
    assert mipmap.shape == (12, 4)
    halves = [image]
    for h, w in ((6, 2), (3, 1)):
        halves.append(halves[-1].reshape(h, 2, w, 2).mean(axis=(1, 3)))
    halves.append(halves[-1].mean(axis=0, keepdims=True))
    kernel = read(lambda uv: tuple(mipmap(uv, level) for level in (0, 1, 2, 3, 99, 2.25))).compile(backend)
    for level, half in enumerate(halves):
        np.testing.assert_allclose(kernel(centers(half.shape))[level], half, rtol=1e-6)
    assert kernel((0.3, 0.9))[4] == pytest.approx(image.mean(), rel=1e-6)
    assert kernel((0.5, 0.5))[5] == pytest.approx(0.75 * halves[2][1, 0] + 0.25 * halves[3][0, 0], rel=1e-6)


def test_odd_images_keep_their_mean_and_all_backends_give_the_same_bits():
    mipmap = library.Mipmap(IMAGE, wrap=("mirror", "repeat"), name="mipmap")

    @sh.program
    def sampled(uv: sh.TexCoord2f, dx: sh.Attrib2f, dy: sh.Attrib2f):
        level = mipmap.level(dx, dy)
        return mipmap(uv, level), level

    sh.testing.assert_equivalent(sampled, UV, *RNG.normal(size=(2, *UV.shape)), backends=covering(1))
    assert mipmap.count == 3
    last = read(mipmap, sh.TexCoord2f, 2).compile("numpy")((0.5, 0.5))
    np.testing.assert_allclose(last, IMAGE.mean(axis=(0, 1)), rtol=1e-6)
    assert sampled((0, 0), (2 / 7, 0), (0, 1 / 5))[1] == pytest.approx(1)
    assert sampled((0, 0), (0, 0), (0, 0))[1] == -np.inf


def test_a_mipmap_is_replaced():
    mipmap = library.Mipmap(IMAGE, name="mipmap")
    mipmap.update(np.ones_like(IMAGE))
    assert read(mipmap, sh.TexCoord2f, 1.5).compile("numpy")((0.2, 0.7)).tolist() == [1, 1, 1]
    with pytest.raises(sh.ShpyTypeError, match=r"keeps the shape: \(5, 7, 3\), not \(5, 7, 1\)"):
        mipmap.update(IMAGE[..., 0])


# Cubes

# OpenGL 4.6, table 8.19: the face, sc, tc and ma of each major direction.
FACES = {
    (1, 0, 0): (0, lambda x, y, z: (-z, -y, x)),
    (-1, 0, 0): (1, lambda x, y, z: (z, -y, x)),
    (0, 1, 0): (2, lambda x, y, z: (x, z, y)),
    (0, -1, 0): (3, lambda x, y, z: (x, -z, y)),
    (0, 0, 1): (4, lambda x, y, z: (x, -y, z)),
    (0, 0, -1): (5, lambda x, y, z: (-x, -y, z)),
}


@sh.program
def chosen(direction: sh.Vector3f):
    return library.cubemap(direction)


@on_every_backend
@pytest.mark.parametrize("major", FACES)
def test_faces_are_those_of_opengl(major, backend):
    face, coordinates = FACES[major]
    directions = np.array(major) * RNG.uniform(1, 9, (30, 1)) + RNG.uniform(-1, 1, (30, 3))
    directions = directions[np.abs(directions).argmax(axis=1) == np.abs(major).argmax()]
    faces, st = chosen.compile(backend)(directions)
    assert np.all(faces == face)
    s, t, reach = coordinates(*directions.T)
    expected = np.stack([(s / abs(reach) + 1) / 2, (t / abs(reach) + 1) / 2], axis=-1)
    np.testing.assert_allclose(st, expected, atol=1e-6)


@on_every_backend
def test_edges_of_a_cube_belong_to_the_first_axis(backend):
    given = [(0, 0, 0), (1, 1, 1), (-1, 1, -1), (0.5, -2, 2), (0, 0, -5), (-0.0, 0, 0)]
    faces, st = chosen.compile(backend)(given)
    assert faces.tolist() == [0, 0, 1, 3, 5, 0]
    assert st[[0, 4, 5]].tolist() == [[0.5, 0.5]] * 3


@pytest.mark.sampled(2)
@pytest.mark.parametrize("filter", ["nearest", "linear"])
def test_all_backends_give_the_same_bits_on_a_cube(filter):
    cube = library.TextureCube(RNG.uniform(0, 1, (6, 4, 4, 3)), filter=filter, name="cube")
    odd = [[0, 0, 0], [1, 1, 1], [-1, -1, 1], [np.inf, 1, 0], [np.nan, 0, 1], [3e38, -3e38, 1], [1e-30, 0, 1e-30]]
    for turn, program in enumerate((read(cube, sh.Vector3f), chosen), 2 * (filter == "linear")):
        given = np.concatenate([RNG.normal(size=(100, 3)), odd])
        sh.testing.assert_equivalent(program, given, backends=covering(turn))


@pytest.mark.sampled(3)
@on_every_backend
def test_a_cube_shows_its_pixels_and_has_no_seam(backend):
    faces = RNG.uniform(0, 1, (6, 8, 8)).astype(np.float32)
    directions = library.TextureCube.directions(8)
    for filter in ("nearest", "linear"):
        cube = library.TextureCube(faces, filter=filter, name="cube")
        np.testing.assert_allclose(read(cube, sh.Vector3f).compile(backend)(directions), faces, atol=2e-6)
    assert cube.shape == (6, 8, 8)
    along = RNG.uniform(-1, 1, 200)
    edges = np.stack([along, np.ones(200), np.ones(200)], axis=-1)[:, None]
    edges = np.concatenate(
        [np.roll(edges, k, axis=2) * s for k in range(3) for s in ((1, 1, 1), (1, -1, 1), (1, 1, -1))]
    )
    step = 1e-5 * RNG.normal(size=(len(edges), 2, 3))
    step[:, 1] = -step[:, 0]
    across = read(cube, sh.Vector3f).compile(backend)(edges + step)
    assert np.abs(across[:, 0] - across[:, 1]).max() < 1e-3
    cube.update(np.zeros_like(faces))
    assert np.all(read(cube, sh.Vector3f).compile(backend)(directions) == 0)


@pytest.mark.sampled(3)
@on_every_backend
def test_a_smooth_sky_stays_smooth(backend):
    directions = library.TextureCube.directions(32)
    units = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    sky = library.TextureCube(0.5 + 0.5 * units, name="sky")
    given = RNG.normal(size=(300, 3))
    given /= np.linalg.norm(given, axis=1, keepdims=True)
    np.testing.assert_allclose(read(sky, sh.Vector3f).compile(backend)(given), 0.5 + 0.5 * given, atol=0.02)


def test_mistakes_say_what_to_write():
    for wrong, said, cure in (
        (lambda: sh.Texture2D(IMAGE, filter="quintic"), "filter='quintic'", 'filter="cubic"'),
        (lambda: sh.Texture2D(IMAGE, wrap=("clamp", "mirrored")), "wrap='mirrored'", 'wrap="mirror"'),
        (lambda: sh.Texture2D(IMAGE, wrap=("clamp",)), "wrap=", "wrap=('repeat', 'clamp'), one for each coordinate"),
        (lambda: library.Texture3D(IMAGE[0]), r"\(d, h, w\) or \(d, h, w, c\)", "array"),
        (lambda: library.Mipmap(IMAGE, wrap="edge"), "wrap='edge'", 'wrap="clamp"'),
        (lambda: library.TextureCube(IMAGE), r"\(6, n, n\) or \(6, n, n, c\), not \(5, 7, 3\)", "np.stack"),
        (lambda: library.TextureCube(np.zeros((6, 2, 2)), filter="cubic"), "filter='cubic'", 'filter="linear"'),
    ):
        with pytest.raises(sh.ShpyTypeError, match=said) as error:
            wrong()
        assert cure in error.value.cure
        assert error.value.loc.file == __file__


KINDS = {sh.Texture2D: (2, 2), library.Texture3D: (2, 2, 2), library.Mipmap: (2, 2), library.TextureCube: (6, 2, 2)}


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_what_holds_no_numbers_is_no_texture(kind):
    for wrong, said in (
        (np.zeros(KINDS[kind], np.complex64), "a texture takes floats, not complex64"),
        (np.full(KINDS[kind], "a"), "a texture takes floats, not <U1"),
        (np.full(KINDS[kind], None), "a texture takes floats, not object"),
        (np.zeros(KINDS[kind], np.bool_), "a texture takes floats, not bool"),
        (np.ma.masked_all(KINDS[kind]), "a texture is a masked array"),
        (np.ma.masked_all(KINDS[kind], np.uint8), "a texture is a masked array"),
        (np.zeros((0, *KINDS[kind][1:])), "a texture cannot be empty"),
    ):
        with pytest.raises(sh.ShpyTypeError, match=said) as error:
            kind(wrong)
        assert error.value.loc.file == __file__


def test_a_cube_of_ints_is_that_of_floats():
    faces = np.arange(24).reshape(6, 2, 2)
    whole, split = library.TextureCube(faces), library.TextureCube(faces.astype(np.float64))
    corner = (1, 1, 1)  # three faces meet there, and 3 does not divide the sum of their pixels
    assert read(whole, sh.Vector3f)(corner) == read(split, sh.Vector3f)(corner) == pytest.approx(28 / 3)


def test_a_cube_is_replaced():
    cube = library.TextureCube(np.zeros((6, 2, 2)))
    cube.update(np.ones((6, 2, 2)))
    assert read(cube, sh.Vector3f)((1, 2, 3)) == 1
    with pytest.raises(sh.ShpyTypeError, match=r"keeps the shape: \(6, 2, 2, 1\), not \(6, 3, 3, 1\)"):
        cube.update(np.ones((6, 3, 3)))
    with pytest.raises(sh.ShpyTypeError, match=r"keeps the shape: \(6, 2, 2, 1\), not \(6, 2, 2, 3\)"):
        cube.update(np.ones((6, 2, 2, 3)))


def test_an_argument_has_the_wraps_and_filters_that_a_run_can_choose():
    @sh.program
    def sampled(image: sh.Texture2D[sh.Color3f], uv: sh.TexCoord2f) -> sh.Color3f:
        return image(uv)

    for texture in (sh.Texture2D(IMAGE, filter="cubic"), sh.Texture2D(IMAGE, wrap=("clamp", "repeat"))):
        with pytest.raises(sh.ShpyTypeError, match="a texture that is an argument is filtered"):
            sampled(texture, UV)
    once = sh.Texture2D(IMAGE, wrap=("repeat", "repeat"))
    np.testing.assert_array_equal(sampled(once, UV), sampled(sh.Texture2D(IMAGE, wrap="repeat"), UV))
