"""The ray tracer of `spheres` as Dr.Jit, Taichi, Warp and numba write it.

Each takes the size, the spheres and the light, how many rays follow each other, how far from a surface a ray begins,
and what counts as infinitely far; and gives what is timed.
"""

import numpy as np

from benchmarks.peers import filled, launched


def drjit(size, spheres, light, rays, away, far):
    import drjit as dr
    from drjit.llvm import Array3f, Bool, Float, UInt32

    def met(o, d, center, radius):
        to = o - Array3f(*center)
        b = dr.dot(to, d)
        inside = b * b - dr.dot(to, to) + radius * radius
        return inside > 0, -b - dr.sqrt(dr.maximum(inside, 0))

    def follow(ray, live, o, d, value, weight):
        nearest, normal, tone, mirror = Float(far), Array3f(0, 1, 0), Float(0), Float(0.5)
        for k, (*center, radius) in enumerate(spheres):
            hit, t = met(o, d, center, radius)
            closer = hit & (t > away) & (t < nearest)
            nearest = dr.select(closer, t, nearest)
            normal = dr.select(closer, (o + t * d - Array3f(*center)) / radius, normal)
            tone = dr.select(closer, 0.3 + 0.1 * k, tone)
        ground = -o.y / d.y
        plane = (d.y < 0) & (ground < nearest)
        nearest = dr.select(plane, ground, nearest)
        normal = dr.select(plane, Array3f(0, 1, 0), normal)
        at = o + nearest * d
        cell = dr.floor(at.x) + dr.floor(at.z)
        tone = dr.select(plane, 0.2 + 0.6 * (cell - 2 * dr.floor(cell / 2)), tone)
        mirror = dr.select(plane, 0.2, mirror)
        live = nearest < far
        at += away * normal
        lit = dr.maximum(dr.dot(normal, Array3f(*light)), 0)
        for *center, radius in spheres:
            hit, t = met(at, Array3f(*light), center, radius)
            lit = dr.select(hit & (t > 0), 0, lit)
        sky = 0.4 + 0.6 * dr.maximum(d.y, 0)
        value += weight * dr.select(live, (1 - mirror) * tone * (0.1 + 0.9 * lit), sky)
        return ray + 1, live, at, d - 2 * dr.dot(d, normal) * normal, value, weight * mirror

    def run():
        i = dr.arange(UInt32, size * size)
        x, y = 2 * (Float(i % size) + 0.5) / size - 1, 0.8 - 2 * (Float(i // size) + 0.5) / size
        start = UInt32(0), Bool(True), Array3f(0, 1.2, -4), dr.normalize(Array3f(x, y, 1.6)), Float(0), Float(1)
        state = dr.while_loop(start, lambda ray, live, *_: live & (ray < rays), follow)
        return np.asarray(state[4]).reshape(size, size)

    return run


def taichi(size, spheres, light, rays, away, far):
    import taichi as ti

    vec3, count = ti.math.vec3, len(spheres)

    @ti.func
    def met(o, d, center, radius):
        to = o - center
        b = to.dot(d)
        inside = b * b - to.dot(to) + radius * radius
        return inside, -b - ti.sqrt(ti.max(inside, 0.0))

    @ti.kernel
    def kernel(out: ti.types.ndarray(dtype=ti.f32, ndim=2)):
        for i, j in out:
            sun = vec3(*light)
            d = vec3(2 * (j + 0.5) / size - 1, 0.8 - 2 * (i + 0.5) / size, 1.6).normalized()
            o = vec3(0, 1.2, -4)
            value, weight = 0.0, 1.0
            for _ in range(rays):
                nearest, normal, tone, mirror = far, vec3(0, 1, 0), 0.0, 0.5
                for k in ti.static(range(count)):
                    center = vec3(spheres[k][0], spheres[k][1], spheres[k][2])
                    inside, t = met(o, d, center, spheres[k][3])
                    if inside > 0 and away < t < nearest:
                        nearest, normal, tone = t, (o + t * d - center) / spheres[k][3], 0.3 + 0.1 * k
                ground = -o.y / d.y
                if d.y < 0 and ground < nearest:
                    at = o + ground * d
                    cell = ti.floor(at.x) + ti.floor(at.z)
                    nearest, normal, mirror = ground, vec3(0, 1, 0), 0.2
                    tone = 0.2 + 0.6 * (cell - 2 * ti.floor(cell / 2))
                if nearest == far:
                    value += weight * (0.4 + 0.6 * ti.max(d.y, 0.0))
                    break
                o += nearest * d + away * normal
                lit = ti.max(normal.dot(sun), 0.0)
                for k in ti.static(range(count)):
                    inside, t = met(o, sun, vec3(spheres[k][0], spheres[k][1], spheres[k][2]), spheres[k][3])
                    if inside > 0 and t > 0:
                        lit = 0.0
                value += weight * (1 - mirror) * tone * (0.1 + 0.9 * lit)
                weight *= mirror
                d -= 2 * d.dot(normal) * normal
            out[i, j] = value

    return filled(kernel, (size, size))


def warp(size, spheres, light, rays, away, far):
    import warp as wp

    ball_array = wp.array(np.float32(spheres), dtype=wp.vec4)

    @wp.func
    def met(o: wp.vec3, d: wp.vec3, ball: wp.vec4):
        to = o - wp.vec3(ball[0], ball[1], ball[2])
        b = wp.dot(to, d)
        inside = b * b - wp.dot(to, to) + ball[3] * ball[3]
        return inside, -b - wp.sqrt(wp.max(inside, 0.0))

    @wp.kernel
    def kernel(
        balls: wp.array(dtype=wp.vec4), sun: wp.vec3, rays: int, away: float, far: float, out: wp.array2d(dtype=float)
    ):
        i, j = wp.tid()
        size = wp.float32(out.shape[0])
        up = wp.vec3(0.0, 1.0, 0.0)
        x, y = 2.0 * (wp.float32(j) + 0.5) / size - 1.0, 0.8 - 2.0 * (wp.float32(i) + 0.5) / size
        d = wp.normalize(wp.vec3(x, y, 1.6))
        o = wp.vec3(0.0, 1.2, -4.0)
        value, weight = wp.float32(0.0), wp.float32(1.0)
        for _ in range(rays):
            nearest, normal = wp.float32(far), wp.vec3(0.0, 1.0, 0.0)
            tone, mirror = wp.float32(0.0), wp.float32(0.5)
            for k in range(balls.shape[0]):
                inside, t = met(o, d, balls[k])
                if inside > 0.0 and t > away and t < nearest:
                    nearest = t
                    normal = (o + t * d - wp.vec3(balls[k][0], balls[k][1], balls[k][2])) / balls[k][3]
                    tone = 0.3 + 0.1 * wp.float32(k)
            ground = -o[1] / d[1]
            if d[1] < 0.0 and ground < nearest:
                nearest = ground
                normal = up
                cell = wp.floor(o[0] + ground * d[0]) + wp.floor(o[2] + ground * d[2])
                tone = 0.2 + 0.6 * (cell - 2.0 * wp.floor(cell / 2.0))
                mirror = 0.2
            if nearest == far:
                value += weight * (0.4 + 0.6 * wp.max(d[1], 0.0))
                break
            o = o + nearest * d + away * normal
            lit = wp.max(wp.dot(normal, sun), 0.0)
            for k in range(balls.shape[0]):
                inside, t = met(o, sun, balls[k])
                if inside > 0.0 and t > 0.0:
                    lit = 0.0
            value += weight * (1.0 - mirror) * tone * (0.1 + 0.9 * lit)
            weight *= mirror
            d = d - 2.0 * wp.dot(d, normal) * normal
        out[i, j] = value

    return launched(kernel, (size, size), lambda: [ball_array, wp.vec3(*light), rays, away, far])


def numba(size, spheres, light, rays, away, far):
    from numba import njit, prange

    f, balls, sun = np.float32, np.float32(spheres), np.float32(light)
    away, far = f(away), f(far)

    @njit(fastmath=True)
    def met(ox, oy, oz, dx, dy, dz, k):
        x, y, z = ox - balls[k, 0], oy - balls[k, 1], oz - balls[k, 2]
        b = x * dx + y * dy + z * dz
        inside = b * b - (x * x + y * y + z * z) + balls[k, 3] * balls[k, 3]
        return inside, -b - np.sqrt(max(inside, f(0)))

    @njit(fastmath=True)
    def light_of(ox, oy, oz, dx, dy, dz):
        value, weight = f(0), f(1)
        for _ in range(rays):
            nearest, nx, ny, nz, tone, mirror = far, f(0), f(1), f(0), f(0), f(0.5)
            for k in range(len(balls)):
                inside, t = met(ox, oy, oz, dx, dy, dz, k)
                if inside > 0 and away < t < nearest:
                    nearest, tone = t, f(0.3) + f(0.1) * f(k)
                    nx, ny, nz = ox + t * dx - balls[k, 0], oy + t * dy - balls[k, 1], oz + t * dz - balls[k, 2]
                    nx, ny, nz = nx / balls[k, 3], ny / balls[k, 3], nz / balls[k, 3]
            ground = -oy / dy
            if dy < 0 and ground < nearest:
                nearest, nx, ny, nz, mirror = ground, f(0), f(1), f(0), f(0.2)
                cell = np.floor(ox + ground * dx) + np.floor(oz + ground * dz)
                tone = f(0.2) + f(0.6) * (cell - f(2) * np.floor(cell / f(2)))
            if nearest == far:
                return value + weight * (f(0.4) + f(0.6) * max(dy, f(0)))
            ox += nearest * dx + away * nx
            oy += nearest * dy + away * ny
            oz += nearest * dz + away * nz
            lit = max(nx * sun[0] + ny * sun[1] + nz * sun[2], f(0))
            for k in range(len(balls)):
                inside, t = met(ox, oy, oz, sun[0], sun[1], sun[2], k)
                if inside > 0 and t > 0:
                    lit = f(0)
            value += weight * (f(1) - mirror) * tone * (f(0.1) + f(0.9) * lit)
            weight *= mirror
            along = f(2) * (dx * nx + dy * ny + dz * nz)
            dx, dy, dz = dx - along * nx, dy - along * ny, dz - along * nz
        return value

    @njit(parallel=True, fastmath=True)
    def kernel():
        out = np.empty((size, size), np.float32)
        for i in prange(size):
            for j in range(size):
                x, y = f(2) * (f(j) + f(0.5)) / f(size) - f(1), f(0.8) - f(2) * (f(i) + f(0.5)) / f(size)
                length = np.sqrt(x * x + y * y + f(1.6) * f(1.6))
                out[i, j] = light_of(f(0), f(1.2), f(-4), x / length, y / length, f(1.6) / length)
        return out

    return kernel


VERSIONS = {"drjit": drjit, "taichi": taichi, "warp": warp, "numba": numba}
