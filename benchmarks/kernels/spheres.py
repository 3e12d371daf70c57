"""A ray tracer of six spheres on a checkered plane, with shadows and three reflections: branches in a loop.

Every version makes a picture (n, n) of brightness from its size alone.
"""

import numpy as np

import shpy as sh
from benchmarks.kernels import spheres_of_peers
from benchmarks.work import Work
from shpy import SH_BREAK, SH_ELSE, SH_FOR, SH_IF

SPHERES = (
    (-1.7, 0.7, 0.6, 0.7), (0.0, 1.0, 1.0, 1.0), (1.8, 0.6, 0.2, 0.6),
    (-0.7, 0.35, -0.9, 0.35), (0.8, 0.4, -1.1, 0.4), (0.1, 0.25, -1.6, 0.25),
)  # fmt: skip
"""Centre and radius."""
LIGHT = (0.48, 0.8, -0.36)
"""The direction to the light, a unit vector."""
RAYS = 4
AWAY = 1e-3
"""The distance from a surface at which the next ray begins."""
FAR = 1e30

WORK = Work(
    "spheres",
    f"{len(SPHERES)} spheres on a plane, {{size}} x {{size}} pixels, shadows, {RAYS - 1} reflections",
    inputs=lambda size: (size,),
    size=1024,
    quick=48,
    within=1e-3,
    share=0.01,
    note="Pixels on edges, of shadows too, may fall to either side.",
)


def met(o, d, center, radius):
    """Half of what the square root is taken of, and the distance to where the ray enters, if that is not negative."""
    away = o - center
    b = sh.dot(away, d)
    inside = b * b - sh.dot(away, away) + radius * radius
    return inside, -b - sh.sqrt(sh.max(inside, 0))


@sh.program
def picture() -> sh.Attrib1f:
    row, column = sh.grid_index(2)
    height, width = sh.grid_shape(2)
    d = sh.normalize(sh.Vector3f(2 * (column + 0.5) / width - 1, 0.8 - 2 * (row + 0.5) / height, 1.6))
    o = sh.Point3f(0, 1.2, -4)
    value, weight = sh.Attrib1f(0), sh.Attrib1f(1)
    with SH_FOR(RAYS):
        nearest = sh.Attrib1f(FAR)
        normal = sh.Normal3f(0, 1, 0)
        tone, mirror = sh.Attrib1f(0), sh.Attrib1f(0.5)
        for k, (x, y, z, radius) in enumerate(SPHERES):
            inside, t = met(o, d, sh.Point3f(x, y, z), radius)
            with SH_IF((inside > 0) & (t > AWAY) & (t < nearest)):
                nearest[:] = t
                normal[:] = (o + t * d - sh.Point3f(x, y, z)) / radius
                tone[:] = 0.3 + 0.1 * k
        ground = -o.y / d.y
        with SH_IF((d.y < 0) & (ground < nearest)):
            nearest[:] = ground
            normal[:] = sh.Normal3f(0, 1, 0)
            at = o + ground * d
            tone[:] = 0.2 + 0.6 * sh.mod(sh.floor(at.x) + sh.floor(at.z), 2)
            mirror[:] = 0.2
        with SH_IF(nearest == FAR):
            value += weight * (0.4 + 0.6 * sh.max(d.y, 0))
            SH_BREAK()
        with SH_ELSE():
            o += nearest * d + AWAY * normal
        lit = sh.Attrib1f(sh.max(sh.dot(normal, sh.Vector3f(*LIGHT)), 0))
        for x, y, z, radius in SPHERES:
            inside, t = met(o, sh.Vector3f(*LIGHT), sh.Point3f(x, y, z), radius)
            lit *= sh.cond((inside > 0) & (t > 0), 0.0, 1.0)
        value += weight * (1 - mirror) * tone * (0.1 + 0.9 * lit)
        weight *= mirror
        d[:] = sh.reflect(d, normal)
    return value


@WORK.ours
def ours(compiled, size):
    kernel = compiled(picture)
    return lambda: kernel(shape=(size, size))


def followed(xp, o, d, weight):
    """One step of rays, (3, n) each, with numpy or JAX as `xp`: their light, whether they go on, and the next step."""

    def met(o, d, center, radius):
        x, y, z = (o[i] - xp.float32(center[i]) for i in range(3))
        b = x * d[0] + y * d[1] + z * d[2]
        inside = b * b - (x * x + y * y + z * z) + xp.float32(radius * radius)
        return inside > 0, -b - xp.sqrt(xp.maximum(inside, 0))

    nearest = xp.full_like(weight, FAR)
    tone, which = xp.zeros_like(weight), xp.zeros(weight.shape, xp.int32)
    for k, (*center, radius) in enumerate(SPHERES):
        hit, t = met(o, d, center, radius)
        closer = hit & (t > AWAY) & (t < nearest)
        nearest, which = xp.where(closer, t, nearest), xp.where(closer, k, which)
    ground = xp.where(d[1] < 0, -o[1] / d[1], FAR)
    plane = ground < nearest
    nearest = xp.where(plane, ground, nearest)
    goes_on = nearest < FAR
    nearest = xp.where(goes_on, nearest, 0)
    at = o + nearest * d
    balls = xp.asarray(np.float32(SPHERES))[which]
    normal = [xp.where(plane, i == 1, (at[i] - balls[..., i]) / balls[..., 3]) for i in range(3)]
    checker = (xp.floor(at[0]) + xp.floor(at[2])) % 2
    tone = xp.where(plane, 0.2 + 0.6 * checker, 0.3 + 0.1 * which.astype(xp.float32))
    mirror = xp.where(plane, xp.float32(0.2), xp.float32(0.5))
    normal = xp.stack(normal).astype(xp.float32)
    at = at + AWAY * normal
    lit = xp.maximum(sum(normal[i] * xp.float32(LIGHT[i]) for i in range(3)), 0)
    for *center, radius in SPHERES:
        hit, t = met(at, np.float32(LIGHT), center, radius)
        lit = xp.where(hit & (t > 0), 0, lit)
    light = xp.where(goes_on, (1 - mirror) * tone * (0.1 + 0.9 * lit), 0.4 + 0.6 * xp.maximum(d[1], 0))
    d = d - 2 * (d[0] * normal[0] + d[1] * normal[1] + d[2] * normal[2]) * normal
    return weight * light, goes_on, at, d, weight * mirror


def eye_rays(xp, size):
    """Origins and directions (3, size * size), weights (size * size,)."""
    along = 2 * (xp.arange(size, dtype=xp.float32) + 0.5) / size
    x, y = (a.ravel() for a in xp.meshgrid(along - 1, 0.8 - along))
    length = xp.sqrt(x * x + y * y + xp.float32(1.6 * 1.6))
    d = xp.stack([x, y, xp.full_like(x, 1.6)]) / length
    return xp.zeros_like(d) + xp.asarray(np.float32([[0], [1.2], [-4]])), d, xp.ones_like(x)


def all_rays(xp, size):
    """Return the picture, with every ray followed to its end."""
    o, d, weight = eye_rays(xp, size)
    value = xp.zeros_like(weight)
    for _ in range(RAYS):
        light, goes_on, o, d, weight = followed(xp, o, d, weight)
        value = value + light
        weight = xp.where(goes_on, weight, 0)
    return value.reshape(size, size)


@WORK.version("masks")
def masks(size):
    def run():
        with np.errstate(all="ignore"):
            return all_rays(np, size)

    return run


@WORK.version("jax")
def jax(size):
    import jax
    import jax.numpy as jnp

    def step(_, state):
        value, o, d, weight = state
        light, goes_on, o, d, weight = followed(jnp, o, d, weight)
        return value + light, o, d, jnp.where(goes_on, weight, 0)

    @jax.jit
    def kernel():
        o, d, weight = eye_rays(jnp, size)
        return jax.lax.fori_loop(0, RAYS, step, (jnp.zeros_like(weight), o, d, weight))[0]

    return lambda: np.asarray(kernel()).reshape(size, size)


for name, version in spheres_of_peers.VERSIONS.items():
    WORK.version(name)(lambda size, version=version: version(size, SPHERES, LIGHT, RAYS, AWAY, FAR))
