"""The oracle: every ray against every triangle in binary64, and the tracer written down again as plain recursion.

Independent of the kernels: Moller-Trumbore for the hit, and equation 5.1 of Christen 2005 unrolled over rays.
"""

import numpy as np

from raytracer import PointLight

OFFSET = 1e-7


def closest(corners, origins, directions, t_max=np.inf):
    """t (N,), triangle (N,), u, v: Moller-Trumbore 1997, no culling, all in f64."""
    n = len(origins)
    t, triangle, u, v = np.full(n, np.inf), np.full(n, -1), np.zeros(n), np.zeros(n)
    limit = np.broadcast_to(t_max, n)
    for k, (a, b, c) in enumerate(corners):
        e1, e2 = b - a, c - a
        p = np.cross(directions, e2)
        det = p @ e1
        with np.errstate(all="ignore"):
            s = origins - a
            uu = np.einsum("ij,ij->i", s, p) / det
            q = np.cross(s, e1)
            vv = np.einsum("ij,ij->i", directions, q) / det
            tt = (q @ e2) / det
            hit = (det != 0) & (uu >= 0) & (vv >= 0) & (uu + vv <= 1) & (tt >= 0) & (tt < limit) & (tt < t)
        t[hit], triangle[hit], u[hit], v[hit] = tt[hit], k, uu[hit], vv[hit]
    return t, triangle, u, v


def crossings(corners, origins, directions):
    """t (R, N) of every ray with every triangle, infinite where it misses: Moller-Trumbore 1997, all in f64."""
    a, b, c = corners.transpose(1, 0, 2)
    e1, e2 = b - a, c - a
    p = np.cross(directions[:, None], e2)
    s = origins[:, None] - a
    q = np.cross(s, e1)
    with np.errstate(all="ignore"):
        det = np.einsum("rni,ni->rn", p, e1)
        u = np.einsum("rni,rni->rn", s, p) / det
        v = np.einsum("ri,rni->rn", directions, q) / det
        t = np.einsum("rni,ni->rn", q, e2) / det
        return np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0), t, np.inf)


def distances(corners, points):
    """(P, N): how far every point is from every triangle: from its edges, or from its plane above the inside."""
    least = np.full((len(points), len(corners)), np.inf)
    inside = np.ones(least.shape, bool)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    for k in range(3):
        start, side = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        away = points[:, None] - start
        part = np.clip(np.einsum("pni,ni->pn", away, side) / np.einsum("ni,ni->n", side, side), 0, 1)
        least = np.minimum(least, np.linalg.norm(away - part[..., None] * side, axis=2))
        inside &= np.einsum("pni,ni->pn", np.cross(side, away), normal) >= 0
    height = np.abs(np.einsum("pni,ni->pn", points[:, None] - corners[:, 0], normal))
    return np.where(inside, np.minimum(least, height), least)


class Picture:
    """The picture of a scene, ray by ray in f64."""

    def __init__(self, scene):
        meshes = [m for m in scene.meshes if len(m)]
        self.scene = scene
        self.corners = np.concatenate([m.corners for m in meshes]).astype(np.float32).astype(np.float64)
        self.faces = np.concatenate([m.face_normals for m in meshes])
        flat = [np.repeat(m.face_normals[:, None], 3, axis=1) for m in meshes]
        self.normals = np.concatenate(
            [f if m.normals is None else m.normals for f, m in zip(flat, meshes, strict=True)]
        )
        plain = [np.broadcast_to(m.material.color, (len(m), 3, 3)) for m in meshes]
        self.colors = np.concatenate(
            [p if m.colors is None else m.colors * p for p, m in zip(plain, meshes, strict=True)]
        )
        self.materials = [m.material for m in meshes for _ in range(len(m))]

    def render(self, width, height, bounces):
        view = self.scene.camera.view(width, height)
        rows, columns = np.mgrid[:height, :width] + 0.5
        rays = view.corner + columns[..., None] * view.across + rows[..., None] * view.down
        rays = (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).reshape(-1, 3)
        return self.color(np.broadcast_to(view.eye, rays.shape), rays, bounces).reshape(height, width, 3)

    def color(self, origins, rays, bounces):
        t, triangle, u, v = closest(self.corners, origins, rays)
        result = np.tile(np.asarray(self.scene.background, dtype=float), (len(rays), 1))
        hit = np.flatnonzero(triangle >= 0)
        if not len(hit):
            return result
        k, ray = triangle[hit], rays[hit]
        weights = np.stack([1 - u[hit] - v[hit], u[hit], v[hit]], axis=1)[..., None]
        face = self.faces[k]
        face = np.where(np.einsum("ij,ij->i", face, ray)[:, None] > 0, -face, face)
        corner_normals = self.normals[k] * np.where(np.einsum("ij,ij->i", self.faces[k], ray) > 0, -1, 1)[:, None, None]
        normal = (weights * corner_normals).sum(axis=1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        normal = np.where(np.einsum("ij,ij->i", face, normal)[:, None] < 0, -normal, normal)
        point = origins[hit] + t[hit, None] * ray
        # Onto the smooth surface: by how much the point lies below the tangent plane of each corner.
        below = np.minimum(np.einsum("ikj,ikj->ik", point[:, None] - self.corners[k], corner_normals), 0)[..., None]
        point = point - (weights * below * corner_normals).sum(axis=1) + OFFSET * face
        own = self.lit(k, point, face, normal, -ray, (weights * self.colors[k]).sum(axis=1))
        mirror = np.array([self.materials[i].reflectivity for i in k])
        seen = (1 - mirror)[:, None] * own
        on = np.flatnonzero(mirror > 0) if bounces > 0 else []
        if len(on):
            out = ray - 2 * np.einsum("ij,ij->i", ray, normal)[:, None] * normal
            below = np.minimum(np.einsum("ij,ij->i", out, face), 0)[:, None]
            out = out - 2 * below * face
            seen[on] += mirror[on, None] * self.color(point[on], out[on], bounces - 1)
        result[hit] = seen
        return result

    def lit(self, k, point, face, normal, view, color):
        total = self.scene.ambient * color
        diffuse, specular, shininess = (
            np.array([getattr(self.materials[i], name) for i in k]) for name in ("diffuse", "specular", "shininess")
        )
        for light in self.scene.lights:
            if isinstance(light, PointLight):
                toward = np.asarray(light.position) - point
                distance = np.linalg.norm(toward, axis=1)
            else:
                toward = np.tile(-np.asarray(light.direction, dtype=float), (len(point), 1))
                distance = np.full(len(point), np.inf)
            toward /= np.linalg.norm(toward, axis=1, keepdims=True)
            cosine = np.einsum("ij,ij->i", normal, toward)
            facing = cosine > 0
            blocked = closest(self.corners, point, toward, distance)[1] >= 0
            mirrored = 2 * cosine[:, None] * normal - toward
            shine = np.maximum(np.einsum("ij,ij->i", mirrored, view), 0) ** shininess
            shade = (diffuse * np.maximum(cosine, 0))[:, None] * color
            shade += np.where(cosine > 0, specular * shine, 0)[:, None]
            total = total + np.where((facing & ~blocked)[:, None], shade, 0) * np.asarray(light.color)
        return total
