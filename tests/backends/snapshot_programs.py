"""Small programs, one feature each, whose texts are kept under tests/snapshots. New ones go to the end."""

import numpy as np

import shpy as sh
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
)  # fmt: skip


@sh.program
def arithmetic(a: sh.Attrib1f, b: sh.Attrib1f, v: sh.Vector3f):
    quadratic = (a * a + 2 * a * b - b * b) / (1 - a * b)
    scaled = -v * (a - (b - 1)) + 0.5
    return quadratic, scaled


@sh.program
def swizzles(p: sh.Point4f, k: sh.Attrib1i):
    p.xz = p.zx
    p.w += p.x
    q = sh.Point4f(p.wy, 0, p.y)
    return q.zyx, q[k]


@sh.program
def mandelbrot(c: sh.Point2f) -> sh.Attrib1f:
    z = sh.Attrib2f(0, 0)
    n = sh.Attrib1f(0)
    with SH_DO():
        z[:] = sh.Attrib2f(z.x * z.x - z.y * z.y, 2 * z.x * z.y) + c
        n += 1
        SH_UNTIL((sh.dot(z, z) > 4) | (n >= 256))
    return n


@sh.program
def branches(x: sh.Attrib1f) -> sh.Color3f:
    color = sh.Color3f(0)
    with SH_IF(x < 0):
        color.r = -x
    with SH_ELIF(x > 1):
        color.g = x
        with SH_IF(x > 2):
            color *= 0.5
    with SH_ELSE():
        color.b = 1 - x
    return color


@sh.program
def collatz(n: sh.Attrib1i) -> sh.Attrib1i:
    steps = sh.Attrib1i(0)
    with SH_WHILE(lambda: n > 1):
        n[:] = sh.cond(n % 2 == 0, n // 2, 3 * n + 1)
        steps += 1
    return steps


@sh.program
def counting(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    total = sh.Attrib1f(0)
    with SH_FOR(n) as i:
        SH_CONTINUE(i % 3 == 0)
        total += x * i
        SH_BREAK(total > 100)
    with SH_FOR(8, 0, -2) as j:
        total -= j
    return total


@sh.program
def leaving(x: sh.Attrib1f):
    SH_DISCARD(sh.isnan(x))
    with SH_FOR(4) as i:
        with SH_FOR(i) as j:
            with SH_IF(x < i * j):
                SH_RETURN((i, j))
    return -1, -1


@sh.subroutine
def bounce(position, velocity, floor):
    with SH_IF(position.y > floor):
        SH_RETURN(False)
    position.y = 2 * floor - position.y
    velocity.y = -velocity.y
    return True


@sh.program
def bouncing(position: sh.Point2f, velocity: sh.Vector2f):
    hits = sh.Attrib1i(0)
    with SH_FOR(10):
        position += velocity * 0.1
        with SH_IF(bounce(position, velocity, sh.Attrib1f(0))):
            hits += 1
    return position, hits


@sh.program
def reversing(x: sh.Attrib4f, n: sh.Attrib1i):
    stack = sh.Array(sh.Attrib1f, 4)
    with SH_FOR(4) as i:
        stack[i] = x[i]
    return stack[3 - n]


heights = sh.Table(np.zeros((4, 6)), sh.Attrib1f)
names = sh.Table([3, 1, 2], sh.Attrib1i)


@sh.program
def lookups(i: sh.Attrib1i, row: sh.Attrib1i, path: sh.Table[sh.Point3f]):
    return heights[row, names[i]], path[i] - path[0], path.shape[0]


@sh.program
def textured(image: sh.Texture2D[sh.Color3f], uv: sh.TexCoord2f) -> sh.Color3f:
    return image(uv * 2)


turn = sh.Param(sh.Matrix3f, np.eye(3), name="turn")
light = sh.Param(sh.Vector3f, (0, 0, 1))


@sh.program
def lit(p: sh.Point3f, n: sh.Normal3f):
    return turn @ p, sh.max(sh.dot(sh.normalize(n), light), 0)


@sh.struct
class Ray:
    o: sh.Point3f
    d: sh.Vector3f


@sh.program
def ray_to_plane(ray: Ray, height: sh.Attrib1f):
    t = (height - ray.o.y) / ray.d.y
    SH_DISCARD(t < 0)
    return Ray(ray.o + t * ray.d, -ray.d)


@sh.program
def whole_numbers(a: sh.Attrib1i, b: sh.Attrib1i, u: sh.Attrib1u):
    return a // b, a % b, (a << 2) ^ (b & ~a), u >> 7, sh.unit_float(sh.hash(u)), -2147483648 - a


@sh.program
def edges(x: sh.Attrib1f, y: sh.Attrib1f):
    return sh.min(x, y), sh.sign(x), sh.round(x), sh.Attrib1i(x), x % y, sh.clamp(x, 0, y), sh.bits_from_float(x)


@sh.program
def packets(x: sh.Attrib1f) -> sh.Attrib1f:
    y = sh.Attrib1f(x)
    with SH_IF(sh.any_lane(x > 1)):
        y[:] = sh.cond(x > 1, sh.sqrt(x), y)
    return y


@sh.program
def checkered() -> sh.Color3f:
    i = sh.grid_index(2)
    uv = sh.Attrib2f(i) / sh.Attrib2f(sh.grid_shape(2))
    return sh.Color3f(uv, sh.Attrib1f((i.x ^ i.y) & 1))


@sh.program
def halves(x: sh.Attrib1h, f: sh.Attrib1f):
    return x * x + 0.1, f + x


@sh.program
def bisection(x: sh.Attrib1f) -> sh.Attrib1f:
    low, high = sh.Attrib1f(0), sh.max(x, 1)
    with SH_DO():
        middle = (low + high) / 2
        with SH_IF(middle * middle < x):
            low[:] = middle
        with SH_ELSE():
            high[:] = middle
        SH_UNTIL(high - low <= 1e-6 * high)
    return low
