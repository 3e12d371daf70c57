"""A script in the language, feature by feature, that type checkers have to accept and Python has to run."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, assert_type

import numpy as np
from numpy.typing import NDArray

import shpy as sh
import shpy.library as lib
from shpy import (
    SH_BREAK,
    SH_CONTINUE,
    SH_DISCARD,
    SH_DO,
    SH_ELIF,
    SH_ELSE,
    SH_FOR,
    SH_IF,
    SH_RETURN,
    SH_UNTIL,
    SH_WHILE,
)

sky = sh.Param(sh.Color3f, (0.2, 0.4, 1.0), name="sky")
turn = sh.Param(sh.Matrix3f, np.eye(3), name="turn")
heights = sh.Table(np.zeros((4, 4)), sh.Attrib1f)
image = sh.Texture2D(np.zeros((4, 4, 3)), filter="linear", wrap="repeat")
smooth = sh.Texture2D(np.zeros((4, 4, 3)), filter="cubic", wrap=("mirror", "clamp"))


@sh.struct
class Ray:
    """A half-line."""

    o: sh.Point3f
    d: sh.Vector3f


class Shaded(NamedTuple):
    """Two outputs with names."""

    color: sh.Color3f
    depth: sh.Attrib1f


class Shader:
    """Programs of a class: one for each instance."""

    def __init__(self, gain: float) -> None:
        self.gain = gain

    @sh.program
    def shade(self, x: sh.Attrib1f) -> sh.Attrib1f:
        return self.gain * x

    @sh.program
    @classmethod
    def double(cls, x: sh.Attrib1f) -> sh.Attrib1f:
        return 2 * x

    @sh.program
    @staticmethod
    def half(x: sh.Attrib1f) -> sh.Attrib1f:
        return x / 2


@sh.program
def uses_a_method(x: sh.Attrib1f) -> sh.Attrib1f:
    doubled: sh.Attrib1f = Shader.double(x)
    return assert_type(Shader(2).shade(doubled), sh.Attrib1f) + assert_type(Shader.half(x), sh.Attrib1f)


@sh.program
def constructors(p: sh.Point3f, n: sh.Attrib1i) -> sh.Attrib4f:
    a = sh.Attrib3f(p.xy, 0)
    b = sh.vec3(1, p.yz)
    c = sh.Color3f(0.5)
    d = sh.Attrib2f((1.0, 2.0))
    e = sh.Attrib1f(n)
    f = sh.Attrib3i(p)
    g = sh.Attrib4f(a.x, c.gb, e) + sh.Attrib4f(sh.Attrib3f(f), 1) + sh.Attrib4f(d, 0, b.z)
    h = sh.Attrib1f()
    h[:] = sh.Attrib1f(n > 0)
    return g * h


@sh.program
def components(p: sh.Point3f) -> sh.Attrib3f:
    v = sh.Attrib3f(p)
    v.xz = v.zx
    v.y += 1
    v[0] = v[1]
    v[0, 2] = (1.0, 2.0)
    v[:] = (1, 2, 3)
    assert_type(v.x, sh.Attrib1f)
    assert_type(v.rg, sh.Attrib2f)
    assert_type(v.stp, sh.Attrib3f)
    assert_type(v.xxyy, sh.Attrib4f)
    assert_type(v[0], sh.Attrib1f)
    assert_type(v[0, 1], sh.Attrib2f)
    x, y, _ = v
    assert_type(x, sh.Attrib1f)
    return sh.Attrib3f(x, y, len(v))


@sh.program
def operators(a: sh.Attrib3f, c: sh.Color3f, p: sh.Point3f, q: sh.Point3f, n: sh.Attrib1i) -> sh.Color3f:
    assert_type(p - q, sh.Vector3f)
    assert_type(p + (p - q), sh.Point3f)
    assert_type((p - q) + p, sh.Point3f)
    assert_type(a * c, sh.Color3f)
    assert_type(c * a, sh.Color3f)
    assert_type(2 * c, sh.Color3f)
    assert_type(a.x * c, sh.Color3f)
    assert_type(n * a, sh.Attrib3f)
    assert_type(n / 2, sh.Attrib1f)
    assert_type(n // 2, sh.Attrib1i)
    assert_type(n * 0.5, sh.Attrib1f)
    assert_type((n << 1) & 7 | ~n, sh.Attrib1i)
    assert_type(-c, sh.Color3f)
    assert_type(a < 0.5, sh.Attrib3b)
    assert_type((a < 0.5) & ~(a > c), sh.Attrib3b)
    assert_type(n == 3, sh.Attrib1b)
    return c + (1, 2, 3) - a**2 / 3 % 0.5


@sh.program
def precisions(p: sh.Point3f, d: sh.Point3d, v: sh.Vector3h, i: sh.Attrib3i, m: sh.Matrix3f) -> sh.Point3d:
    assert_type(p - d, sh.Vector3d)
    assert_type(d - p, sh.Vector3d)
    assert_type(v + d, sh.Point3d)
    assert_type(sh.cross(p, d), sh.Point3d)
    assert_type(sh.cross(d, p), sh.Point3d)
    assert_type(sh.cross(i, i), sh.Attrib3f)
    assert_type(sh.normalize(i), sh.Attrib3f)
    assert_type(m @ d, sh.Point3d)
    assert_type(m @ v, sh.Vector3f)
    assert_type(m @ i, sh.Attrib3f)
    return p + (d - p)


@sh.program
def functions(a: sh.Attrib3f, c: sh.Color3f, i: sh.Attrib1i, u: sh.Attrib1u) -> sh.Color3f:
    assert_type(sh.sin(c), sh.Color3f)
    assert_type(sh.sqrt(2.0 * a.x), sh.Attrib1f)
    assert_type(sh.exp(i), sh.Attrib1f)
    assert_type(sh.min(c, 1), sh.Color3f)
    assert_type(sh.max(0.0, c), sh.Color3f)
    assert_type(sh.max(i, 3), sh.Attrib1i)
    assert_type(sh.mix(c, 0.0, a.x), sh.Color3f)
    assert_type(sh.clamp(a, 0, 1), sh.Attrib3f)
    assert_type(sh.smoothstep(0.0, 1.0, a.x), sh.Attrib1f)
    assert_type(sh.dot(a, c), sh.Attrib1f)
    assert_type(sh.cross(a, sh.Vector3f(a)), sh.Vector3f)
    assert_type(sh.normalize(sh.Normal3f(a)), sh.Normal3f)
    assert_type(sh.length(a.xy), sh.Attrib1f)
    assert_type(sh.any(a > 0) & sh.all(c > 0), sh.Attrib1b)
    assert_type(sh.cond(a.x > 0, c, 0.0), sh.Color3f)
    assert_type(sh.bits_from_float(a.x), sh.Attrib1u)
    assert_type(sh.unit_float(sh.hash(u, u)), sh.Attrib1f)
    assert_type(sh.noise(a), sh.Attrib1f)
    assert_type(sh.isnan(a), sh.Attrib3b)
    assert_type(abs(i), sh.Attrib1i)
    counts = sh.Attrib3i(1, 2, 3)
    assert_type(i << counts, sh.Attrib3i)
    assert_type(i / counts, sh.Attrib3f)
    assert_type(i**counts, sh.Attrib3f)
    assert_type(sh.cond(a > 0, a.x, 0.0), sh.Attrib3f)
    assert_type(sh.cond(a > 0, i, 0), sh.Attrib3i)
    assert_type(sh.max(sh.Attrib1h(1), 2), sh.Attrib1h)
    wider = sh.max(a, sh.Attrib3d(a))
    assert_type(wider, sh.Attrib3d)
    assert_type(sh.min(counts, 0.5 * wider.x), sh.Attrib3d)
    return sh.mix(c, sh.Color3f(1), sh.saturate(sh.atan2(a.y, a.x) + sh.pow(2.0, a.x)))


@sh.program
def matrices(p: sh.Point3f, v: sh.Vector3f, n: sh.Normal3f) -> sh.Point3f:
    m = sh.Matrix4f()
    m[0, 3] = 2.0
    assert_type(m @ p, sh.Point3f)
    assert_type(m @ v, sh.Vector3f)
    assert_type(m @ n, sh.Normal3f)
    assert_type(m @ m, sh.Matrix4f)
    assert_type(m[0], sh.Attrib4f)
    assert_type(m[1, 2], sh.Attrib1f)
    assert_type(turn @ v, sh.Vector3f)
    assert_type(sh.transpose(turn), sh.Matrix3f)
    assert_type(2 * m, sh.Matrix4f)
    assert_type(1 - m + p.x, sh.Matrix4f)
    assert_type(-turn @ turn + turn.copy(), sh.Matrix3f)
    return sh.inverse(m) @ p + sh.determinant(turn)


@sh.program
def control(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    total = sh.Attrib1f(0)
    with SH_IF(x > 1):
        total += 1
    with SH_ELIF(lambda: x > 0):
        total += 2
    with SH_ELSE():
        total += 3
    with SH_WHILE(lambda: total < 10):
        total *= 2.5
    with SH_DO():
        total += 1
        SH_UNTIL(total > 20)
    with SH_FOR(0, n, 2) as i:
        SH_CONTINUE(i == 2)
        total += sh.Attrib1f(i)
        SH_BREAK(sh.any_lane(total > 1e6) & (total > 1e6))
    SH_DISCARD(total < 0)
    SH_RETURN(total, n > 100)
    return total


@sh.subroutine
def advance(p: sh.Point3f, v: sh.Vector3f, by: float) -> sh.Attrib1f:
    p += v * by
    return sh.length(v)


class Scene:
    @sh.subroutine
    def distance(self, p: sh.Point3f) -> sh.Attrib1f:
        return sh.length(p)


@sh.subroutine
def height(p: sh.Point3f) -> sh.Attrib1f:
    return sh.length(p)


@height.tangent
def height_tangent(y: sh.Attrib1f, p: sh.Point3f, d_p: sh.Vector3f) -> sh.Attrib1f:
    return sh.dot(p, d_p) / y


@sh.program
def structs(ray: Ray) -> Shaded:
    moved = Ray(ray.o + ray.d, -ray.d)
    way = advance(moved.o, moved.d, 0.5) * Scene().distance(ray.o) * height(ray.o)
    assert_type(way, sh.Attrib1f)
    assert_type(moved.o, sh.Point3f)
    assert_type(moved.o.x, sh.Attrib1f)
    moved.d = sh.Vector3f(0, 0, 1)
    stack = sh.Array(sh.Attrib1i, 4)
    stack[0] = 3
    assert_type(stack[0], sh.Attrib1i)
    return Shaded(sh.Color3f(moved.o) + sky, way + stack[0])


@sh.program
def data(
    line: sh.Table[sh.Attrib4f], grid: sh.Table[sh.Attrib3f, Literal[2]], map: sh.Texture2D[sh.Color3f], i: sh.Attrib1i
) -> sh.Color3f:
    assert_type(line[i], sh.Attrib4f)
    assert_type(grid[i, 0], sh.Attrib3f)
    assert_type(map(sh.Attrib2f(0.5)), sh.Color3f)
    row, column = sh.grid_index(2)
    assert_type(sh.dFdx(sh.TexCoord2f(column, row)), sh.TexCoord2f)
    assert_type(sh.dFdy(sh.Point2f(column, row)), sh.Vector2f)
    assert_type(sh.dFdx(row), sh.Attrib1f)
    assert_type(row, sh.Attrib1i)
    return map((0.5, 0.5)) + heights[row, column] + sh.Color3f(grid[i, 0]) * line[i].w


def ball(p: sh.Point3f, radius: sh.Attrib1f) -> sh.Attrib1f:
    return sh.length(p) - radius


@sh.program
def derived(p: sh.Point3f, radius: sh.Attrib1f) -> sh.Normal3f:
    value, (by_p, by_radius) = sh.gradient(ball, (0, "radius"), value=True, mode="reverse", most=8)(p, radius)
    same, change = sh.jvp(ball, [p, radius], [sh.Vector3f(1, 0, 0), None])
    columns = sh.jacobian(lambda q: q * value)(p)
    normal: sh.Normal3f = sh.gradient(ball)(p, radius)
    return normal + sh.Normal3f(by_p * (by_radius * same * change) + columns[0])


along: sh.Program[..., Any] = derived.jvp("p", "radius")

sky_box = sh.library.TextureCube(np.zeros((6, 2, 2, 3)))


@sh.program
def library(c: sh.Color3f, p: sh.Point3f, uv: sh.TexCoord2f) -> sh.Color3f:
    assert_type(lib.fbm(p) + lib.turbulence(uv, 4, gain=0.6), sh.Attrib1f)
    assert_type(lib.worley(p), sh.Attrib1f)
    assert_type(lib.worley(p, count=2), sh.Attrib2f)
    assert_type(lib.worley(p, "manhattan", 3), sh.Attrib3f)
    assert_type(lib.cellnoise(uv), sh.Attrib1f)
    assert_type(lib.cellnoise(uv, 3), sh.Attrib3f)
    assert_type(lib.lerp(c, 0.0, uv.x), sh.Color3f)
    assert_type(lib.isfinite(p), sh.Attrib3b)
    assert_type(lib.log10(uv.x), sh.Attrib1f)
    assert_type(sh.log10(c), sh.Color3f)
    assert_type(lib.hypot(uv.x, 1), sh.Attrib1f)
    assert_type(lib.outer(p, c), sh.Matrix3f)
    assert_type(lib.rotate((0, 1, 0), 0.5) @ lib.look_at(p, (0, 0, 0)) @ p, sh.Point3f)
    assert_type(lib.rotate(uv.x) @ lib.scale(uv), sh.Matrix3f)
    assert_type(lib.perspective(1, 1.5, 0.1, 100) @ lib.translate(p), sh.Matrix4f)
    assert_type(lib.linear_from_srgb(c), sh.Color3f)
    assert_type(lib.luminance(c), sh.Attrib1f)
    face, place = lib.cubemap(p)
    assert_type(face, sh.Attrib1i)
    assert_type(place, sh.TexCoord2f)
    return lib.rgb_from_hsv(lib.hsv_from_rgb(c)) + sh.Color3f(sky_box(p))


def run() -> NDArray[Any]:
    """Programs are values, and run on arrays."""
    sky.value = (1, 1, 1)
    kernel = control.compile("numpy", precision="f32", math="strict", lanes="auto", loop_limit=1000)
    result = kernel.run(np.zeros(3, np.float32), np.arange(3))
    double = control.bind(n=3)
    print(kernel.source, result.count, double.inputs, structs.ir, sh.backends())
    tables = (np.zeros((4, 4)), np.zeros((2, 2, 3)), image)
    shaded = data(*tables, np.zeros((4, 4), np.int32))
    assert_type(sh.Attrib3f(1, 2, 3) + 1, sh.Attrib3f)
    return np.asarray(shaded)


@sh.program
def inlined(x: sh.Attrib1f) -> sh.Attrib1f:
    assert_type(control(x, sh.Attrib1i(2)), sh.Attrib1f)
    return control(x, sh.Attrib1i(2))
