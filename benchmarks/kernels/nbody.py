"""Gravity: every body walks through all bodies; the same loop for each of them, one table.

Every version takes bodies (n, 4), position and mass, and gives the pull that each feels, (n, 3).
"""

import numpy as np

import shpy as sh
from benchmarks.peers import filled, launched
from benchmarks.work import Work
from shpy import SH_FOR

SOFTENING = 0.01
"""Added to each squared distance."""


def galaxy(size):
    rng = np.random.default_rng(1)
    return (np.column_stack([rng.normal(size=(size, 3)), rng.random(size) / size]).astype(np.float32),)


WORK = Work(
    "nbody", "Gravity between {size} bodies, all pairs", inputs=galaxy, size=4096, quick=200, within=1e-5
)  # fmt: skip


@WORK.ours
def ours(compiled, particles):
    bodies = sh.Table(particles, sh.Attrib4f)

    @sh.program
    def pull(x: sh.Point3f) -> sh.Vector3f:
        total = sh.Vector3f(0, 0, 0)
        with SH_FOR(len(particles)) as j:
            body = bodies[j]
            away = body.xyz - x
            near = sh.rsqrt(sh.dot(away, away) + SOFTENING)
            total += body.w * near * near * near * away
        return total

    kernel = compiled(pull)

    def run():
        bodies.update(particles)
        return kernel(particles[:, :3])

    return run


@WORK.version("masks")
def masks(particles):
    def run():
        x, y, z, mass = np.ascontiguousarray(particles.T)
        out = np.empty((len(particles), 3), np.float32)
        for start in range(0, len(particles), 64):  # the rows of pairs that fit a cache
            part = slice(start, start + 64)
            dx, dy, dz = x - x[part, None], y - y[part, None], z - z[part, None]
            r2 = dx * dx
            r2 += dy * dy
            r2 += dz * dz
            r2 += SOFTENING
            weight = mass / (r2 * np.sqrt(r2))
            for axis, d in enumerate((dx, dy, dz)):
                out[part, axis] = np.einsum("ij,ij->i", weight, d)
        return out

    return run


@WORK.version("drjit")
def drjit(particles):
    import drjit as dr
    from drjit.llvm import Array3f, Float, UInt32

    def run():
        x, y, z, mass = (Float(a) for a in particles.T)
        here = Array3f(x, y, z)

        def add(j, total):
            away = dr.gather(Array3f, here, j) - here
            near = dr.rsqrt(dr.fma(away.x, away.x, dr.fma(away.y, away.y, dr.fma(away.z, away.z, SOFTENING))))
            return j + 1, total + dr.gather(Float, mass, j) * near * near * near * away

        _, total = dr.while_loop(
            (UInt32(0), dr.zeros(Array3f, len(particles))), lambda j, total: j < len(particles), add
        )
        return total.numpy().T

    return run


@WORK.version("taichi")
def taichi(particles):
    import taichi as ti

    count = len(particles)

    @ti.kernel
    def kernel(bodies: ti.types.ndarray(dtype=ti.math.vec4, ndim=1), out: ti.types.ndarray(dtype=ti.math.vec3, ndim=1)):
        for i in range(count):
            total = ti.Vector([0.0, 0.0, 0.0])
            for j in range(count):
                away = bodies[j].xyz - bodies[i].xyz
                near = ti.rsqrt(away.dot(away) + SOFTENING)
                total += bodies[j].w * near * near * near * away
            out[i] = total

    return filled(kernel, (count, 3), particles)


@WORK.version("warp")
def warp(particles):
    import warp as wp

    softening = wp.constant(SOFTENING)

    @wp.kernel
    def kernel(bodies: wp.array(dtype=wp.vec4), out: wp.array(dtype=wp.vec3)):
        i = wp.tid()
        here = bodies[i]
        total = wp.vec3(0.0, 0.0, 0.0)
        for j in range(bodies.shape[0]):
            body = bodies[j]
            away = wp.vec3(body[0] - here[0], body[1] - here[1], body[2] - here[2])
            near = 1.0 / wp.sqrt(wp.dot(away, away) + softening)
            total += body[3] * near * near * near * away
        out[i] = total

    return launched(kernel, len(particles), lambda: [wp.array(particles, dtype=wp.vec4, copy=False)], wp.vec3)


@WORK.version("numba")
def numba(particles):
    from numba import njit, prange

    softening = np.float32(SOFTENING)

    @njit(parallel=True, fastmath=True)
    def kernel(x, y, z, mass):
        out = np.empty((len(x), 3), np.float32)
        for i in prange(len(x)):
            ax = ay = az = np.float32(0)
            for j in range(len(x)):
                dx, dy, dz = x[j] - x[i], y[j] - y[i], z[j] - z[i]
                r2 = dx * dx + dy * dy + dz * dz + softening
                weight = mass[j] / (r2 * np.sqrt(r2))
                ax, ay, az = ax + weight * dx, ay + weight * dy, az + weight * dz
            out[i, 0], out[i, 1], out[i, 2] = ax, ay, az
        return out

    return lambda: kernel(*np.ascontiguousarray(particles.T))


@WORK.version("jax")
def jax(particles):
    import jax
    import jax.numpy as jnp

    @jax.jit
    def kernel(bodies):
        def pull(here):
            away = bodies[:, :3] - here[:3]
            near = jax.lax.rsqrt(jnp.sum(away * away, axis=1) + SOFTENING)
            return (bodies[:, 3] * near * near * near) @ away

        return jax.lax.map(pull, bodies, batch_size=64)

    return lambda: np.asarray(kernel(particles))
