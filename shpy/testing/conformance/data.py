"""Conformance cases of data: arrays, params, tables, textures, matrices, structs, outputs, shapes and precisions."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

import shpy as sh
from shpy import SH_BREAK, SH_DISCARD, SH_DO, SH_ELSE, SH_FOR, SH_IF, SH_RETURN, SH_UNTIL, SH_WHILE
from shpy.ir.types import Base
from shpy.testing.conformance.cases import Case, by_decorator, data

CASES: list[Case] = []
case = by_decorator(CASES)
RNG = np.random.default_rng(5)
GLSL_HAS_NO_DOUBLES = {"glsl": "has no 64-bit floats"}


def _points(n: int, size: int = 3) -> Any:
    return RNG.uniform(-2, 2, (n, size)).astype(np.float32)


# Structures


@sh.struct
class Ray:
    """A struct of three fields."""

    o: sh.Point3f
    d: sh.Vector3f
    t: sh.Attrib1f


class Pair(NamedTuple):
    """Two outputs with names."""

    near: sh.Attrib1f
    hits: sh.Attrib1i


@case()
def a_struct_comes_in_and_goes_out(ray: Ray) -> Ray:
    ray.o += ray.d * ray.t
    ray.d = -ray.d
    with SH_IF(ray.t > 0):
        ray.t = sh.Attrib1f(0)
    return ray


@case()
def a_named_tuple_comes_in_and_goes_out(p: Pair) -> Pair:
    return Pair(p.near * 2, p.hits + 1)


@case()
def structs_in_an_array(i: sh.Attrib1i, x: sh.Attrib1f):
    rays = sh.Array(Ray, 3)
    with SH_FOR(3) as k:
        rays[k] = Ray(sh.Point3f(x, k, 0), sh.Vector3f(k), x + k)
    ray = rays[i]
    ray.t = ray.t + 100
    rays[1] = ray
    return rays[1].t, rays[2].o, rays[i].t


@case(outs=True)
def many_outputs_of_every_base(f: sh.Attrib1f, i: sh.Attrib3i, u: sh.Attrib2u, b: sh.Attrib4b, p: sh.Point3f):
    with SH_IF(f > 2):
        SH_DISCARD()
    return f, i, u, b, p, i.x, u.yx, b.wzyx, p.zy, f + 1, -i, sh.any(b), p * f, u.x


@case()
def inputs_of_every_type(a: sh.Attrib2f, b: sh.Attrib4f, c: sh.Attrib2i, d: sh.Attrib4i, e: sh.Attrib3u, g: sh.Attrib1b,
                         h: sh.Attrib2b, k: sh.Attrib3b):  # fmt: skip
    return a.y + b.w, c.x + d.w, e.zx, g & h.y & k.z, b.xyz * a.x, ~h


@case(
    outs=True, x=_points(40, 1)[:, 0] * 2, expected=lambda x: np.where(np.abs(x) < 2, x * np.float32(2), np.float32(7))
)
def a_discarded_element_keeps_what_out_held(x: sh.Attrib1f) -> sh.Attrib1f:
    SH_DISCARD(sh.abs(x) >= 2)
    return x * 2


@case(outs=True)
def everything_is_discarded(x: sh.Attrib1f) -> sh.Attrib1f:
    SH_DISCARD(sh.isnan(x) | (x == x))
    return x


# Shapes


@case(x=np.float32(3), y=np.int32(4), expected=np.float32(12))
def no_axes(x: sh.Attrib1f, y: sh.Attrib1i) -> sh.Attrib1f:
    return x * y


@case(x=_points(1, 3)[0], expected=lambda x: x[::-1])
def no_axes_of_vectors(x: sh.Attrib3f) -> sh.Attrib3f:
    return x.zyx


@case(x=np.zeros((0, 3), np.float32), y=np.float32(1))
def no_elements(x: sh.Attrib3f, y: sh.Attrib1f) -> sh.Attrib3f:
    return x + y


@case(x=_points(5, 7), y=np.arange(7, dtype=np.float32), z=np.float32(0.5), w=_points(5, 1),
      expected=lambda x, y, z, w: (x * y + z) / w)  # fmt: skip
def shapes_broadcast(x: sh.Attrib1f, y: sh.Attrib1f, z: sh.Attrib1f, w: sh.Attrib1f) -> sh.Attrib1f:
    return (x * y + z) / w


@case(p=_points(6).reshape(2, 1, 3, 3), q=_points(4).reshape(4, 1, 3), w=np.arange(3, dtype=np.int32))
def vectors_broadcast(p: sh.Point3f, q: sh.Point3f, w: sh.Attrib1i):
    return p - q, sh.distance(p, q), w + 1


@case(shape=(5, 7), expected=lambda: tuple(np.mgrid[:5, :7]) + (35,))
def a_shape_without_inputs():
    i, size = sh.grid_index(2), sh.grid_shape(2)
    return i.x, i.y, size.x * size.y


@case(shape=(3, 4), x=np.arange(4, dtype=np.float32), expected=lambda x: np.arange(3)[:, None] * 10 + x)
def a_shape_beside_an_input(x: sh.Attrib1f) -> sh.Attrib1f:
    return x + 10 * sh.grid_index(2).x


@case(
    shape=(9, 21),
    heights=np.arange(9 * 21, dtype=np.float32).reshape(9, 21),
    expected=lambda heights: (
        np.roll(heights, (-1, 2), (0, 1)),
        heights[np.clip(np.arange(9) - 1, 0, 8)][:, np.clip(np.arange(21) + 2, 0, 20)],
    ),
)
def reads_beside_the_own_place(heights: sh.Table[sh.Attrib1f, 2]):
    """On a board that wraps around, and up to the border of one that does not."""
    at = sh.grid_index(2)
    return heights[(at + (1, -2)) % sh.grid_shape(2)], heights[at + (-1, 2)]


@case(shape=(17, 5))
def mandelbrot() -> sh.Attrib1i:
    at = sh.Attrib2f(sh.grid_index(2)) / sh.Attrib2f(sh.grid_shape(2))
    c = at * 3 - sh.Attrib2f(1.5, 2)
    z, n = sh.Attrib2f(0, 0), sh.Attrib1i(0)
    with SH_DO():
        z[:] = sh.Attrib2f(z.x * z.x - z.y * z.y, 2 * z.x * z.y) + c
        n += 1
        SH_UNTIL((sh.dot(z, z) > 4) | (n >= 64))
    return n


# More elements than a tile of numpy holds, and no multiple of a work group.
@case(x=np.linspace(-3, 3, 70_001, dtype=np.float32)[::7], n=np.int32(3))
def many_elements_and_a_uniform(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    r = sh.Attrib1f(1)
    with SH_FOR(n) as i:
        SH_BREAK(r > 4)
        r *= x + i
    return r


# Params and tables

SCALE = sh.Param(sh.Attrib1f, 1.5, name="scale")
TINT = sh.Param(sh.Color3f, (0.25, 0.5, 1), name="tint")
TURN = sh.Param(sh.Matrix3f, [[0, -1, 0], [1, 0, 0], [0, 0, 2]], name="turn")
STEPS = sh.Param(sh.Attrib2i, (3, -4), name="steps")
BITS = sh.Param(sh.Attrib1u, 2**32 - 1, name="bits")
ON = sh.Param(sh.Attrib1b, True, name="on")


@case()
def params_of_every_kind(p: sh.Point3f, n: sh.Attrib1i):
    colour = TINT * SCALE
    with SH_FOR(STEPS.x) as i:
        colour += p * i
    with SH_IF(ON):
        colour.x = 0
    return TURN @ p, colour, STEPS + n, BITS >> 3, TURN[1, 0], ON


FLOATS_1D = sh.Table(data(Base.F, 1, 9, 1), sh.Attrib1f)
POINTS_2D = sh.Table(_points(12).reshape(3, 4, 3), sh.Point3f)
COLORS_3D = sh.Table(np.arange(2 * 3 * 5 * 4).reshape(2, 3, 5, 4) / 8, sh.Color4f)
BIG_INTS = sh.Table([2**31 - 1, -(2**31), 2**24 + 1, -(2**24) - 3, 0], sh.Attrib1i)
BIG_UINTS = sh.Table([[2**32 - 1, 2**31], [2**24 + 1, 7]], sh.Attrib2u)
FLAGS = sh.Table([True, False, False, True], sh.Attrib1b)


@case(i=data(Base.I, 1, 60, 2))
def tables_of_every_base(i: sh.Attrib1i):
    return FLOATS_1D[i], BIG_INTS[i], BIG_UINTS[i], FLAGS[i], BIG_UINTS[i].y & 255


@case(at=RNG.integers(-2, 6, (60, 3)).astype(np.int32))
def tables_of_every_rank(at: sh.Attrib3i):
    return POINTS_2D[at.x, at.y], POINTS_2D[at.yz], COLORS_3D[at.x, at.y, at.z], COLORS_3D[at], POINTS_2D[1, at.z]


@case(x=data(Base.F, 1, 40, 3), table=data(Base.F, 1, 11, 4))
def a_table_as_an_argument(table: sh.Table[sh.Attrib1f], x: sh.Attrib1f):
    n = table.shape[0]
    total = sh.Attrib1f(0)
    with SH_FOR(n) as i:
        total += table[i]
    return total, n, table[sh.Attrib1i(x * n)]


@case(image=_points(20, 4).reshape(4, 5, 4), p=RNG.integers(-3, 8, (30, 2)).astype(np.int32))
def a_two_dimensional_table_as_an_argument(image: sh.Table[sh.Color4f, 2], p: sh.Attrib2i):
    h, w = image.shape
    return image[p.x, p.y], image[p], h * 100 + w


@case(volume=data(Base.U, 2, 24, 6).reshape(2, 3, 4, 2), at=RNG.integers(-1, 5, (30, 3)).astype(np.int32))
def a_three_dimensional_table_as_an_argument(volume: sh.Table[sh.Attrib2u, 3], at: sh.Attrib3i):
    depth, rows, columns = volume.shape
    return volume[at], depth, rows, columns


# Wider than a texture may be: such tables are folded.
@case(table=np.arange(70_000, dtype=np.int32) * 30_011,
      i=np.array([0, 1, 16_383, 16_384, 16_385, 65_535, 69_999, 70_000, -1]),
      expected=lambda table, i: table[np.clip(i, 0, 69_999)])  # fmt: skip
def a_long_table(table: sh.Table[sh.Attrib1i], i: sh.Attrib1i) -> sh.Attrib1i:
    return table[i]


@case(first=np.array([3, 0, 2, 1, 4]), start=np.arange(5))
def a_table_read_at_what_was_read(first: sh.Table[sh.Attrib1i], start: sh.Attrib1i) -> sh.Attrib1i:
    at = sh.Attrib1i(start)
    with SH_FOR(3):
        at[:] = first[at]
    return at


@sh.subroutine
def lookup(i: sh.Attrib1i):
    """Read a table and a param in a subroutine."""
    return FLOATS_1D[i] * SCALE


@case(i=data(Base.I, 1, 30, 7))
def a_subroutine_reads_tables_and_params(i: sh.Attrib1i):
    return lookup(i) + lookup(i + 1)


# Textures

IMAGE = RNG.uniform(0, 1, (4, 6, 3)).astype(np.float32)
UV = np.concatenate([
    RNG.uniform(-1.5, 2.5, (80, 2)),
    [[0, 0], [1, 1], [0.5 / 6, 0.5 / 4], [5.5 / 6, 3.5 / 4], [-1e9, 1e9], [np.nan, 0.5]],
]).astype(np.float32)  # fmt: skip


def texture_case(filter: Any, wrap: Any, image: Any = IMAGE) -> None:
    """Add the case of a texture that is read in and out of range."""
    texture = sh.Texture2D(image, filter=filter, wrap=wrap, name="image")

    def sampled(uv: sh.TexCoord2f):
        return texture(uv)

    sampled.__name__ = f"texture_{filter}_{wrap}_of_{image.shape[2:]}"
    case(uv=UV)(sampled)


for _filter in ("nearest", "linear"):
    for _wrap in ("clamp", "repeat"):
        texture_case(_filter, _wrap)
texture_case("linear", "repeat", RNG.integers(0, 256, (5, 3), dtype=np.uint8))


def pixel_centers() -> Any:
    """Return where the pixels of IMAGE lie, (4, 6, 2)."""
    rows, columns = np.mgrid[:4, :6]
    return np.stack([(columns + 0.5) / 6, (rows + 0.5) / 4], -1).astype(np.float32)


NEAREST = sh.Texture2D(IMAGE, filter="nearest", name="nearest_image")


@case(uv=pixel_centers(), expected=IMAGE)
def a_texture_at_its_pixels_is_the_image(uv: sh.TexCoord2f) -> sh.Color3f:
    return NEAREST(uv)


def texture_argument(filter: Any, wrap: Any) -> None:
    """Add the case of a texture as an argument."""

    def sampled(image: sh.Texture2D[sh.Color3f], uv: sh.TexCoord2f):
        h, w = image.shape
        return image(uv), h, w

    sampled.__name__ = f"texture_argument_{filter}_{wrap}"
    case(uv=UV, image=sh.Texture2D(IMAGE, filter=filter, wrap=wrap))(sampled)


for _filter in ("nearest", "linear"):
    for _wrap in ("clamp", "repeat"):
        texture_argument(_filter, _wrap)

# Matrices


@case(m=_points(27).reshape(9, 3, 3), k=_points(27).reshape(9, 3, 3), v=_points(9), i=np.int32(1))
def matrices_of_three(m: sh.Matrix3f, k: sh.Matrix3f, v: sh.Attrib3f, i: sh.Attrib1i):
    product = m @ k
    product[1, 2] = v.x
    return product, m @ v, sh.transpose(m), sh.determinant(m), m[2], m[1, 0] + i, m * 2 - k, product[0].zyx


@case(m=RNG.uniform(-2, 2, (9, 4, 4)).astype(np.float32), p=_points(9), v=_points(9), n=_points(9))
def points_vectors_and_normals_are_moved(m: sh.Matrix4f, p: sh.Point3f, v: sh.Vector3f, n: sh.Normal3f):
    return m @ p, m @ v, m @ n


@case(m=RNG.uniform(-2, 2, (9, 4, 4)).astype(np.float32), k=RNG.uniform(-2, 2, (9, 2, 2)).astype(np.float32))
def inverses(m: sh.Matrix4f, k: sh.Matrix2f):
    return sh.inverse(m), sh.inverse(k), sh.determinant(m), m @ sh.inverse(m)


@case(i=RNG.integers(-1, 4, 12).astype(np.int32), x=_points(12, 1)[:, 0])
def matrices_in_an_array(i: sh.Attrib1i, x: sh.Attrib1f):
    a = sh.Array(sh.Matrix2f, 3)
    a[i] = sh.Matrix2f([[x, 1], [2, x]])
    return a[1], sh.determinant(a[i])


# Stores


@case()
def stores_into_parts(v: sh.Attrib4f, w: sh.Attrib3i, x: sh.Attrib1f):
    v.xz = v.zx
    v[1] = x
    v[-1] += 1
    w.zyx = w
    w[0, 2] = (7, 8)
    with SH_IF(x > 0):
        v.xy *= 2
    return v, w


@case()
def swaps(a: sh.Attrib3f, b: sh.Attrib3f):
    with SH_IF(a.x > b.x):
        sh.swap(a, b)
    return a, b


@case()
def components_at_run_time(v: sh.Attrib4f, b: sh.Attrib3b, u: sh.Attrib2u, i: sh.Attrib1i):
    return v[i], b[i], u[i], v[i + 1]


@case(x=_points(30, 1)[:, 0])
def arrays_sort(x: sh.Attrib1f):
    a = sh.Array(sh.Attrib1f, [x, -x, x * x, sh.Attrib1f(0.5), x + 1])
    with SH_FOR(4) as i:
        with SH_FOR(0, 4 - i) as j:
            low, high = sh.min(a[j], a[j + 1]), sh.max(a[j], a[j + 1])
            a[j] = low
            a[j + 1] = high
    return tuple(a[k] for k in range(5))


@case(n=np.arange(-2, 12, dtype=np.int32))
def an_array_as_a_stack(n: sh.Attrib1i):
    stack, top = sh.Array(sh.Attrib1i, 16), sh.Attrib1i(0)
    with SH_FOR(n) as i:
        stack[top] = i * i
        top += 1
    total = sh.Attrib1i(0)
    with SH_WHILE(lambda: top > 0):
        top -= 1
        total[:] = total * 3 + stack[top]
        SH_RETURN((total, top), total > 100_000)
    return total, top


@case()
def arrays_of_bools_and_vectors(i: sh.Attrib1i, v: sh.Attrib3f, c: sh.Attrib1b):
    seen, kept = sh.Array(sh.Attrib1b, 4), sh.Array(sh.Attrib3f, 2)
    seen[i] = c
    kept[i] = v
    kept[1] += v
    return seen[0], seen[i], kept[1], kept[i].zy


# hash, noise


@case()
def hashes(u: sh.Attrib3u):
    return sh.hash(u.x), sh.hash(u.x, u.y), sh.hash(u.x, u.y, u.z), sh.unit_float(sh.hash(u.z)), sh.unit_float(u)


@case(p=_points(60) * 50)
def noises(p: sh.Point3f):
    return sh.noise(p.x), sh.noise(p.xy), sh.noise(p)


# Doubles, halves, and other working precisions


@case(refused=GLSL_HAS_NO_DOUBLES)
def doubles_beside_floats(x: sh.Attrib1d, v: sh.Attrib3d, f: sh.Attrib1f, i: sh.Attrib1i):
    return x + f, v * x, sh.dot(v, v), sh.sqrt(sh.abs(x)) / 3, x * 0.1 + i, sh.Attrib1i(x), sh.Attrib1f(x)


@case()
def halves_beside_floats(x: sh.Attrib1h, v: sh.Attrib3h, f: sh.Attrib1f, i: sh.Attrib1i):
    total = sh.Attrib1h(0)
    with SH_FOR(5) as k:
        total += x * 0.1 + sh.Attrib1h(k)
    return total, x + f, v * x, sh.sqrt(sh.abs(x)) / 3, x * 0.1, sh.Attrib1i(x), sh.Attrib1h(f), v.zx, sh.Attrib1h(i)


HALF_TABLE = sh.Table(np.arange(8) / 3, sh.Attrib1h, name="halves")
HALF_PARAM = sh.Param(sh.Attrib2h, (0.1, 65504), name="half_param")


@case(i=RNG.integers(-2, 10, 20).astype(np.int32))
def halves_in_tables_params_and_arrays(i: sh.Attrib1i):
    a = sh.Array(sh.Attrib1h, 3)
    a[i] = HALF_TABLE[i]
    return HALF_TABLE[i], HALF_PARAM * 2, a[0] + a[i]


@sh.subroutine
def mixed(a, b, x):
    """Change the first argument in place."""
    a += b * x
    return sh.length(b)


def _at_any_precision(v: sh.Attrib3f, x: sh.Attrib1f, n: sh.Attrib1i):
    total = sh.Attrib3f(0.1)
    r = mixed(total, v, x)
    with SH_WHILE(lambda: (sh.dot(total, total) < 1e3) & (n > 0)):
        n -= 1
        total += v / 3
        SH_DISCARD(total.x > 100)
    with SH_IF(x > 0.1):
        total.y = FLOATS_1D[n] * SCALE
    with SH_ELSE():
        total.z = sh.smoothstep(0, 1, x)
    return total, r, sh.reflect(v, total), sh.Attrib1i(total.x), sh.mix(total, v, x)


case(options={"precision": "f16"}, outs=True)(_at_any_precision)
case(options={"precision": "f64"}, outs=True, refused=GLSL_HAS_NO_DOUBLES)(_at_any_precision)
CASES[-2].name, CASES[-1].name = "at_f16", "at_f64"


@case(options={"loop_limit": None}, x=np.array([1, 5, 100], np.float32), expected=lambda x: np.array([64, 80, 100]))
def a_loop_without_a_limit(x: sh.Attrib1f) -> sh.Attrib1f:
    with SH_WHILE(lambda: x < 64):
        x *= 2
    return x


def cases() -> list[Case]:
    """Return every form of data."""
    return CASES
