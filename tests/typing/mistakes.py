"""Mistakes that type checkers have to find: each line that ends in `# mistake` is one, and no other line is."""

from typing import Literal

import numpy as np

import shpy as sh
from shpy import SH_FOR, SH_IF, SH_WHILE


@sh.program
def values(c: sh.Color3f, p: sh.Point3f, n: sh.Attrib1i, u: sh.Attrib1u) -> sh.Color3f:
    c.foo()  # mistake
    c.w  # mistake
    c.xq = 1  # mistake
    c.xx = p.xy  # mistake
    c + "a"  # mistake
    c + p.xy  # mistake
    c & c  # mistake
    n + u  # mistake
    _ = n < u  # mistake
    _ = n == u  # mistake
    n += 0.5  # mistake
    (c > 0) + 1  # mistake
    sh.Attrib3f(c, 1)  # mistake
    sh.Attrib4f(c)  # mistake
    sh.Color3f(1, 2)  # mistake
    len(c.x)  # mistake
    return p - p  # mistake


@sh.program
def functions(c: sh.Color3f, n: sh.Attrib1i) -> sh.Attrib1f:
    sh.lerp(c, c, 0.5)  # mistake
    sh.max(c, c.xy)  # mistake
    sh.mix(c.xyz, c.xy, 0.5)  # mistake
    sh.dot(c)  # mistake
    sh.sin("x")  # mistake
    sh.any(c)  # mistake
    sh.cond(c.x, 1, 2)  # mistake
    sh.cross(c.xy, c.xy)  # mistake
    sh.normalize(c.x)  # mistake
    sh.noise(sh.Attrib4f(1))  # mistake
    sh.popcount(1.5)  # mistake
    sh.any_lane(c > 0)  # mistake
    sh.transpose(c)  # mistake
    sh.library.worley(c, "taxicab")  # mistake
    sh.library.fbm(sh.Attrib4f(1))  # mistake
    sh.library.outer(c, c.xy)  # mistake
    sh.library.translate(c.x)  # mistake
    sh.library.hsv_from_rgb(c.xy)  # mistake
    return c  # mistake


@sh.program
def blocks(x: sh.Attrib1f) -> sh.Attrib1f:
    with SH_IF(x):  # mistake
        x += 1
    with SH_WHILE(x > 0):  # mistake
        x -= 1
    with SH_FOR(0, 1.5):  # mistake
        x += 1
    with SH_FOR(3) as i:
        i.y  # mistake
    return x + sh.Matrix3f()  # mistake


@sh.struct
class Ray:
    o: sh.Point3f
    d: sh.Vector3f


@sh.program
def data(ray: Ray, table: sh.Table[sh.Attrib4f], grid: sh.Table[sh.Attrib1f, Literal[2]]) -> sh.Attrib4f:
    ray.length  # mistake
    Ray(ray.o)  # mistake
    Ray(ray.o, 1, 2)  # mistake
    table["a"]  # mistake
    table[0.5]  # mistake
    table.size  # mistake
    return grid[0, 0].xyz  # mistake


sh.Texture2D(np.zeros((4, 4)), filter="quintic")  # mistake
sh.Table(np.zeros(4))  # mistake
sh.Array(sh.Attrib1f, "8")  # mistake
values.compile(precision="f128")  # mistake
values.compile("numpy", math="exact")  # mistake
values.sources  # mistake
sh.Attrib5f  # mistake
sh.vec5(0)  # mistake
