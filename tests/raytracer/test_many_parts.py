"""Scenes of many meshes, materials and textures: the work is proportional to their number."""

from collections import Counter

import numpy as np
import pytest
from effort import calls

from raytracer import Material, Mesh, Path, Scene, SceneError, Texture
from raytracer.integrators import origin as origins
from raytracer.kernels.appearance import Appearance
from raytracer.kernels.path import PathTracer
from raytracer.meshes import obj
from raytracer.meshes.folder import Notices
from raytracer.meshes.shapes import floor
from raytracer.scene.layout import Layout


def scene_of(materials):
    return Scene([floor(1, look).moved((k, 0, 0)) for k, look in enumerate(materials)])


def plain(count):
    return scene_of([Material(shininess=float(k)) for k in range(count)])


def test_a_layout_takes_time_by_the_number_of_materials():
    few, many = plain(100), plain(400)
    assert calls(lambda: Layout.of(many)) < 6 * calls(lambda: Layout.of(few))


def test_a_mesh_without_uv_coordinates_is_named_by_its_material():
    bare = [Mesh(np.eye(3) + k, [[0, 1, 2]], name=name) for k, name in enumerate(("a", "b", "c", ""))]
    looks = [Material(shininess=1), Material(shininess=2)]
    meshes = [floor(1, looks[0]), bare[0].with_material(looks[1]), bare[1].with_material(looks[0]), bare[2]]
    layout = Layout.of(Scene([*meshes, bare[0].with_material(looks[0]), bare[3].with_material(Material(shininess=3))]))
    assert layout.materials[:2] == tuple(looks)
    assert layout.without_uv == ("b", "a", "c", "a mesh")
    picture = Material(Texture(np.ones((1, 1))))
    with pytest.raises(SceneError, match="a mesh: a Texture needs uv coordinates"):
        Appearance(Layout.of(Scene([bare[3].with_material(picture)])))


class Compared(Texture):
    """A texture that counts comparisons."""

    count = 0

    def __eq__(self, other):
        Compared.count += 1
        return self is other

    __hash__ = Texture.__hash__


def test_textures_are_found_without_comparing_all():
    textures = [Compared(np.full((1, 1), 0.5)) for _ in range(200)]
    layout = Layout.of(scene_of([Material(texture) for texture in textures]))
    Compared.count = 0
    Appearance(layout)
    assert Compared.count < 10 * len(textures)


def test_parts_of_an_obj_file_do_not_each_read_all_numbers(monkeypatch):
    count, reads = 50, Counter()
    for name in ("_split", "_table"):
        real = getattr(obj, name)
        monkeypatch.setattr(obj, name, lambda rows, name=name, real=real: reads.update([name]) or real(rows))
    text = "".join(
        f"o part{k}\nv {k} 0 0\nv {k} 1 0\nv {k} 0 1\nvn 0 0 1\nvt {k} 1\n" + "f 1/1/1 2/1/1 3/1/1\n".replace("1", "-1")
        for k in range(count)
    )
    numbered = text.replace("-1/-1/-1 2/-1/-1 3/-1/-1", "-3/-1/-1 -2/-1/-1 -1/-1/-1")
    parts, _ = obj.read_obj(numbered.encode(), "", Notices("parts.obj"))
    meshes = [mesh for _, mesh in parts]
    assert [mesh.vertices[0, 0] for mesh in meshes] == list(range(count))
    assert [mesh.uv[0, 0, 0] for mesh in meshes] == list(range(count))
    assert reads == {"_split": 1, "_table": 2}


def test_the_digest_of_a_picture_reads_a_texture_once(monkeypatch):
    taken = []
    real = origins.hashlib.sha256

    class Digest:
        def __init__(self, first=b""):
            self.real = real(first)

        def update(self, data):
            taken.append(memoryview(data).nbytes)
            self.real.update(data)

        def hexdigest(self):
            return self.real.hexdigest()

    monkeypatch.setattr(origins.hashlib, "sha256", Digest)
    one, other = (Texture(np.full((64, 64, 3), value, np.float32)) for value in (0.25, 0.75))

    def origin(*looks):
        scene = scene_of(looks)
        layout = Layout.of(scene)
        taken.clear()
        return origins.origin_of(scene, layout, PathTracer(layout, scene, 1, "numpy"), scene.camera, Path(), "numpy")

    origin(*(Material(one, shininess=float(k)) for k in range(50)))
    assert sum(taken) < 3 * one.image.nbytes
    first = origin(Material(one), Material(one, 0.5), Material(other, 0.25))
    assert first == origin(Material(one), Material(one, 0.5), Material(other, 0.25))
    assert first != origin(Material(one), Material(other, 0.5), Material(other, 0.25))
    assert origin(Material(reflectivity=one)) != origin(Material(diffuse=one))
