"""Materials of files that shine, are clear, or have holes: glTF's extensions, alpha, and the statements of MTL."""

import dataclasses
import math
import warnings

import numpy as np
import pytest
import trimesh
from gltf_files import SQUARE, File, png
from PIL import Image as pillow
from test_microfacets import check_gains_nothing, furnace

import shpy as sh
from raytracer import Camera, Material, Mesh, MetallicRoughness, Scene, SceneError, Texture, render
from raytracer.meshes.shapes import box

AHEAD = Camera((0, 0, 4), (0, 0, 0), projection="orthographic", span=2)
MATT = {"specular": {"specularFactor": 0}}
"""The extensions of a material that mirrors nothing."""
WALL = Mesh(5 * SQUARE - (0, 0, 1), [[0, 1, 2], [0, 2, 3]], material=Material((0, 1, 0), 1.0, 0.0))
OUTSIDE = "factors of materials outside of 0 to 1 (1)"
HALF = png(np.full((1, 1, 4), 128))


def loaded(path, *ignored):
    """The first material of a file, which warns of just this."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = Scene.load(path)
    assert [str(w.message) for w in caught] == [f"{path.name}: ignored: {text}" for text in ignored]
    return scene.meshes[0].material


def gltf(folder, *ignored, file=None, **entry):
    """The material of a GLB file with one material; `extensions` are those of KHR_materials."""
    file = file or File()
    extensions = {f"KHR_materials_{name}": found for name, found in entry.pop("extensions", {}).items()}
    file.tree["extensionsUsed"] = list(extensions)
    entry.setdefault("pbrMetallicRoughness", {}).setdefault("metallicFactor", 0)
    file.node(mesh=file.mesh(file.square(material=file.material(extensions=extensions, **entry))))
    return loaded(file.save(folder / "one.glb"), *ignored)


def written(folder, text, **pictures):
    """An OBJ file whose library has these statements."""
    for name, data in pictures.items():
        (folder / f"{name}.png").write_bytes(data)
    (folder / "one.mtl").write_text(f"newmtl one\n{text}\n")
    path = folder / "one.obj"
    path.write_text("mtllib one.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl one\nf 1/1 2/2 3/3\n")
    return path


def obj(folder, text, *ignored, **pictures):
    """The material of such a file."""
    return loaded(written(folder, text, **pictures), *ignored)


def before_green(material, mesh=None):
    """Render a square of a material in front of a green wall, without lights; return the colours (8, 8, 3)."""
    square = mesh or Mesh(SQUARE, [[0, 1, 2], [0, 2, 3]], uv=[[0, 0], [1, 0], [1, 1], [0, 1]])
    scene = Scene([square.with_material(material), WALL], (), AHEAD, ambient=1.0, background=(0, 0, 0))
    return render(scene, (8, 8), backend="numpy", bounces=2).pixels


def test_emission_of_gltf(tmp_path):
    strong = gltf(tmp_path, emissiveFactor=[1, 0.5, 0], extensions={"emissive_strength": {"emissiveStrength": 4}})
    assert strong.emission == (4, 2, 0)
    file = File()
    picture = file.picture([[[255, 255, 255], [0, 0, 0]]], magFilter=9728)
    shown = gltf(tmp_path, file=file, emissiveFactor=[0, 0.5, 1], emissiveTexture={"index": picture})
    np.testing.assert_allclose(shown.emission.image, [[[0, 0.5, 1], [0, 0, 0]]])
    black = dataclasses.replace(shown, base_color=(0, 0, 0), specular=0.0)
    seen = before_green(black)[4]
    np.testing.assert_allclose(seen[[1, 6]], [[0, 0.5, 1], [0, 0, 0]])
    assert gltf(tmp_path, emissiveTexture={"index": 0}, file=with_picture()).emission == (0, 0, 0)


def with_picture(pixels=((0, 0, 0),)):
    file = File()
    file.picture(np.array([pixels]))
    return file


def test_thin_walls_of_gltf_let_light_go_straight_on(tmp_path):
    glass = gltf(tmp_path, pbrMetallicRoughness={"roughnessFactor": 0}, extensions={
        "transmission": {"transmissionFactor": 1}})  # fmt: skip
    assert (glass.transmission, glass.ior, glass.roughness) == (1, 1.5, 0)
    np.testing.assert_allclose(before_green(glass), np.broadcast_to([0, 0.96, 0], (8, 8, 3)), atol=2e-4)
    dense = gltf(tmp_path, pbrMetallicRoughness={"roughnessFactor": 0}, extensions={
        "transmission": {"transmissionFactor": 0.5}, "ior": {"ior": 2.0}})  # fmt: skip
    assert (dense.transmission, dense.ior) == (0.5, 2)
    metal = gltf(tmp_path, pbrMetallicRoughness={"metallicFactor": 1, "roughnessFactor": 0}, extensions={
        "transmission": {"transmissionFactor": 1}})  # fmt: skip
    assert metal.metallic == 1
    np.testing.assert_allclose(before_green(metal), np.zeros((8, 8, 3)), atol=1e-6)  # it mirrors the black background


def test_a_thin_wall_tints_what_is_behind_it(tmp_path):
    look = {"baseColorFactor": [1, 0.25, 0.5, 1], "roughnessFactor": 0.0}
    tinted = gltf(tmp_path, pbrMetallicRoughness=look, extensions={"transmission": {"transmissionFactor": 1}})
    assert tinted.base_color == (1, 0.25, 0.5)
    np.testing.assert_allclose(before_green(tinted), np.broadcast_to([0, 0.25 * 0.96, 0], (8, 8, 3)), atol=2e-4)


def test_what_bodies_leave_out_is_ignored_aloud(tmp_path):
    file = File()
    metal = file.picture([[[0, 255, 0], [0, 255, 255]]])
    look = {"baseColorFactor": [1, 0.25, 0.5, 1], "roughnessFactor": 0.5, "metallicFactor": 0.5}
    look["metallicRoughnessTexture"] = {"index": metal}
    ignored = "pictures of the metal of clear bodies (1), coats and specular factors of clear bodies (1)"
    extensions = {"transmission": {"transmissionFactor": 1}, "volume": {"thicknessFactor": 1}}
    extensions |= {"clearcoat": {"clearcoatFactor": 1}}
    body = gltf(tmp_path, ignored, file=file, pbrMetallicRoughness=look, extensions=extensions)
    assert (body.base_color, body.roughness, body.metallic) == ((1, 0.25, 0.5), 0.5, 0.25)


def test_bodies_of_gltf_refract_and_absorb(tmp_path):
    volume = {"thicknessFactor": 1, "attenuationColor": [0.5, 0.25, 1], "attenuationDistance": 2}
    body = gltf(tmp_path, pbrMetallicRoughness={"roughnessFactor": 0}, extensions={
        "transmission": {"transmissionFactor": 1}, "volume": volume, "ior": {"ior": 1.4}})  # fmt: skip
    assert (body.transmission, body.ior, body.is_body) == (1, 1.4, True)
    np.testing.assert_allclose(body.absorption, [math.log(2) / 2, math.log(4) / 2, 0])
    slab = dataclasses.replace(body, ior=1.0)
    seen = before_green(slab, box((9, 9, 1)))
    np.testing.assert_allclose(seen, np.broadcast_to([0, 0.25**0.5, 0], seen.shape), atol=1e-6)
    plain = gltf(tmp_path, pbrMetallicRoughness={"roughnessFactor": 0}, extensions={
        "transmission": {"transmissionFactor": 1}, "volume": {"thicknessFactor": 0.1}})  # fmt: skip
    assert (plain.absorption, plain.ior) == ((0, 0, 0), 1.5)


def test_pictures_of_transmission(tmp_path):
    """The red channel times the factor, beside a picture of metal that is smaller."""
    file = File()
    clear = file.picture([[[255, 0, 0], [51, 0, 0]]])
    metal = file.picture([[[0, 255, 0]]])
    look = {"metallicRoughnessTexture": {"index": metal}, "metallicFactor": 1}
    extensions = {"transmission": {"transmissionFactor": 0.5, "transmissionTexture": {"index": clear}}}
    material = gltf(tmp_path, file=file, pbrMetallicRoughness=look, extensions=extensions)
    np.testing.assert_allclose(material.transmission.image[0, :, 0], [0.5, 0.1], rtol=1e-6)
    assert (material.metallic, material.roughness) == (0, 1)


def test_specular_and_coats_of_gltf(tmp_path):
    """Factors and pictures: an alpha, a colour, and the red and the green channel."""
    factors = {
        "specular": {"specularFactor": 0.5, "specularColorFactor": [2, 1, 0.5]},
        "clearcoat": {"clearcoatFactor": 0.25, "clearcoatRoughnessFactor": 0.75},
    }
    plain = gltf(tmp_path, extensions=factors)
    assert (plain.specular, plain.specular_color) == (0.5, (2, 1, 0.5))
    assert (plain.clearcoat, plain.clearcoat_roughness) == (0.25, 0.75)
    file = File()
    index = {"index": file.picture([[[255, 0, 0, 51], [0, 255, 0, 255]]], magFilter=9728)}
    factors["specular"] |= {"specularTexture": index, "specularColorTexture": index}
    factors["clearcoat"] |= {"clearcoatTexture": index, "clearcoatRoughnessTexture": index}
    factors["clearcoat"]["clearcoatNormalTexture"] = index
    material = gltf(tmp_path, "normal maps of coats (1)", file=file, extensions=factors)
    np.testing.assert_allclose(material.specular.image[0, :, 0], [0.1, 0.5], rtol=1e-6)
    np.testing.assert_allclose(material.specular_color.image[0], [[2, 0, 0], [0, 1, 0]], rtol=1e-6)
    np.testing.assert_allclose(material.clearcoat.image[0, :, 0], [0.25, 0], rtol=1e-6)
    np.testing.assert_allclose(material.clearcoat_roughness.image[0, :, 0], [0, 0.75], rtol=1e-6)


def test_masks_of_gltf_cut_out(tmp_path):
    """A surface exists where alpha is at least the cutoff: 0.4 * 128 / 255 = 0.2008."""
    pixels = [[[255, 0, 0, 0], [255, 0, 0, 128]]]
    look = {"baseColorFactor": [1, 1, 1, 0.4], "roughnessFactor": 1}
    seen = {}
    for cutoff in (0.2, 0.202):
        file = File()
        base = file.picture(pixels, magFilter=9728)
        entry = {"pbrMetallicRoughness": look | {"baseColorTexture": {"index": base}}, "alphaMode": "MASK"}
        entry["extensions"] = MATT
        seen[cutoff] = before_green(gltf(tmp_path, file=file, alphaCutoff=cutoff, **entry))[4, [1, 6]]
    np.testing.assert_allclose(seen[0.2], [[0, 1, 0], [1, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(seen[0.202], [[0, 1, 0], [0, 1, 0]], atol=1e-6)
    file = with_picture(((9, 9, 9, 200),))
    look = {"baseColorTexture": {"index": 0}}
    assert gltf(tmp_path, file=file, alphaMode="MASK", pbrMetallicRoughness=look).cutout is None
    for entry in (
        {"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.4]}},
        {"alphaCutoff": 1.5},
        {"alphaCutoff": 1.5, "pbrMetallicRoughness": look},
    ):
        with pytest.raises(SceneError, match=r"no triangles; ignored: primitives of which a mask leaves nothing \(1\)"):
            gltf(tmp_path, file=with_picture(((9, 9, 9, 255),)), alphaMode="MASK", **entry)
    opaque = gltf(tmp_path, alphaMode="OPAQUE", file=with_picture(((9, 9, 9, 0),)), pbrMetallicRoughness=look)
    assert (opaque.cutout, opaque.alpha) == (None, 1)


def test_blended_materials_of_gltf(tmp_path):
    """A constant alpha blends, and so does a picture of it, times the factor; what is 0 or 1 cuts out."""
    look = {"baseColorFactor": [1, 0, 0, 0.25], "roughnessFactor": 1}
    blended = gltf(tmp_path, alphaMode="BLEND", pbrMetallicRoughness=dict(look), extensions=MATT)
    np.testing.assert_allclose(before_green(blended), np.broadcast_to([0.25, 0.75, 0], (8, 8, 3)), atol=1e-6)
    for factor in (1, 0.5):
        file = File()
        base = file.picture([[[255, 255, 255, 204], [255, 255, 255, 51], [0, 0, 0, 2], [0, 0, 0, 0]]], magFilter=9728)
        look = {"baseColorTexture": {"index": base}, "baseColorFactor": [1, 0, 0, factor]}
        material = gltf(tmp_path, file=file, alphaMode="BLEND", pbrMetallicRoughness=look, extensions=MATT)
        colors = before_green(material)[4, [0, 2, 4, 7]]
        for color, alpha in zip(colors, (0.8 * factor, 0.2 * factor, 0, 0), strict=True):
            np.testing.assert_allclose(color, [alpha, 1 - alpha, 0], atol=1e-6)
    look = {"baseColorTexture": {"index": 0}}
    pixels = np.full((1, 20, 4), 255)
    pixels[:, 10:, 3] = 0
    pixels[:, 10, 3] = 100  # an edge that is soft
    leaf = File()
    leaf.picture(pixels)
    ignored = "partial transparency at the edges of pictures (1)"
    soft = gltf(tmp_path, ignored, file=leaf, alphaMode="BLEND", pbrMetallicRoughness=look)
    assert soft.cutout.image[0, 9:12, 0].tolist() == pytest.approx([1, 100 / 255, 0])
    assert soft.alpha == 1
    file = with_picture(((255, 0, 0, 255), (255, 0, 0, 0)))
    assert gltf(tmp_path, file=file, alphaMode="BLEND", pbrMetallicRoughness=look).alpha == 1


def test_alpha_of_vertex_colours_is_ignored_aloud(tmp_path):
    for mode, ignored in (("BLEND", ["alpha of vertex colours (1)"]), ("OPAQUE", [])):
        file = File()
        colors = {"COLOR_0": file.array([[1, 1, 1, 0.5]] * 4)}
        file.node(mesh=file.mesh(file.square(attributes=colors, material=file.material(alphaMode=mode))))
        assert loaded(file.save(tmp_path / "one.glb"), *ignored).cutout is None


@pytest.mark.parametrize("kind", ["vertex", "face"])
@pytest.mark.parametrize("alpha", [255, 100])
def test_alpha_of_the_colours_of_ply_files_and_of_trimesh_is_ignored_aloud(kind, alpha, tmp_path):
    made = trimesh.creation.icosahedron()
    setattr(made.visual, f"{kind}_colors", [255, 0, 0, alpha])
    made.export(tmp_path / "one.ply")
    ignored = [f"alpha of {kind} colours (1)"] if alpha < 255 else []
    loaded(tmp_path / "one.ply", *ignored)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        Mesh.from_trimesh(made)
    assert [str(w.message) for w in caught] == [f"mesh: ignored: {text}" for text in ignored]


def test_trimesh_materials_shine_and_have_holes():
    made = trimesh.creation.box()
    uv = np.zeros((len(made.vertices), 2))
    image = pillow.fromarray(np.array([[[255, 0, 0, 255], [0, 0, 0, 0]]], np.uint8))
    look = trimesh.visual.material.PBRMaterial(
        baseColorTexture=image, metallicFactor=0.0, alphaMode="MASK", alphaCutoff=0.25, emissiveFactor=[0, 0.5, 1]
    )
    made.visual = trimesh.visual.TextureVisuals(uv=uv, material=look)
    material = Mesh.from_trimesh(made).material
    np.testing.assert_array_equal(material.cutout.image[0, :, 0], [2, 0])
    assert material.emission == (0, 0.5, 1)
    look.alphaMode, look.baseColorTexture, look.baseColorFactor = "BLEND", None, [255, 255, 255, 51]
    assert Mesh.from_trimesh(made).material.alpha == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Ke 2 1 0", {"emission": (2, 1, 0)}),
        ("d 0.25", {"transmission": 0.75, "ior": 1.0}),
        ("Tr 0.25\nNi 1.7", {"transmission": 0.25, "ior": 1.0}),
        ("d 1.0\nTr 1.0", {"transmission": 0.0}),
        ("illum 7\nNi 1.7\nKs 0.125", {"transmission": 1.0, "ior": 1.7, "reflectivity": 0.125}),
        ("illum 6\nTf 0.5 0.5 0.5", {"transmission": 0.5, "ior": 1.5}),
        ("illum 7\nd 0.25\nNi 1.3", {"transmission": 0.75, "ior": 1.3}),
        ("illum 4\nd 0.5\nNi 1.3", {"transmission": 0.5, "ior": 1.0}),
        ("illum 2\nNi 1.45\nTf 0 1 0", {"transmission": 0.0}),
        ("illum 10\nKs 0.125", {"reflectivity": 0.0}),
    ],
)
def test_statements_of_mtl(tmp_path, text, expected):
    material = obj(tmp_path, text)
    assert {name: getattr(material, name) for name in expected} == expected


BEYOND = "light beyond what surfaces receive (1)"


@pytest.mark.slow
@pytest.mark.sampled(8)
@pytest.mark.parametrize(
    ("text", "diffuse", "specular"),
    [
        ("Kd 0.5 0.25 0\nKs 0.5", 1, 0.5),
        ("Kd 1 1 0.5\nKs 1\nNs 9", 1 / 2, 1 / 2),
        ("Kd 0.8 0.8 0.8\nKs 0 0.7 0.8\nNs 100", 1 / 1.3, 0.5 / 1.3),
        ("Kd 0 0 0\nKs 4", 1 / 4, 1),
        ("Kd 2 1 0", 1 / 2, 0),
        ("Kd 1 1 1\nKs 1\nillum 3", 1 / 2, 1 / 2),
        ("Kd 1 1 1\nKs 1\nillum 1", 1, 0),
    ],
)
def test_mtl_sends_out_no_more_light_than_it_receives(tmp_path, text, diffuse, specular):
    ignored = [BEYOND] if diffuse < 1 else []
    material = obj(tmp_path, text, *ignored)
    assert (material.diffuse, material.specular) == pytest.approx((diffuse, specular), rel=1e-6)
    check_gains_nothing(furnace(material, backend="opencl"))


@pytest.mark.parametrize(
    ("text", "ignored", "expected"),
    [
        ("Kd 1 0.5 0\nPr 0.25", [], MetallicRoughness((1, 0.5, 0), 0, 0.25)),
        ("Pm 1\nPr 0\nKe 1 2 3", [], MetallicRoughness(metallic=1, roughness=0, emission=(1, 2, 3))),
        ("Pc 0.5\nPcr 0.25\nNi 2", [], MetallicRoughness(ior=2, clearcoat=0.5, clearcoat_roughness=0.25)),
        ("Pr 2\nPm -1\nKd 4 1 0", [OUTSIDE], MetallicRoughness((1, 1, 0), 0, 1)),
        ("Pr 0.5\nKs 1 1 1\nNs 9\nillum 3\nd 0.25", [], MetallicRoughness(alpha=0.25)),
        ("Pr 0.5\nTr 1", ["Tr 1 of materials without d, which are opaque (1)"], MetallicRoughness()),
        ("Pr 0.5\nPs 0\naniso 0\nanisor 0.0", [], MetallicRoughness()),
        (
            "Pr 0.5\nPs 0.5\nanisor 0.1",
            [],
            MetallicRoughness(sheen_color=(0.5,) * 3, sheen_roughness=0.5),
        ),
        ("Ps 0.0\nPcr 0\nKs 0.125", [], Material(diffuse=1, specular=0.125)),
        (
            "illum 7\nPr 0.5\nPm 0\nNi 1.4",
            [],
            MetallicRoughness(transmission=1, thickness=1, ior=1.4),
        ),
    ],
)
def test_physical_statements_of_mtl(tmp_path, text, ignored, expected):
    assert obj(tmp_path, text, *ignored) == expected


def test_physical_pictures_of_mtl(tmp_path):
    """They multiply their numbers, as map_Kd does, and are linear."""
    picture = png([[[51, 51, 51], [255, 255, 255]]])
    material = obj(tmp_path, "Pr 0.5\nmap_Pr grey.png\nmap_Pm grey.png\nmap_Kd grey.png\nKd 1 1 1", grey=picture)
    np.testing.assert_allclose(material.roughness.image[0, :, 0], [0.1, 0.5], rtol=1e-6)
    np.testing.assert_allclose(material.metallic.image[0, :, 0], [0.2, 1], rtol=1e-6)
    np.testing.assert_allclose(material.base_color.image[0, :, 0], [((0.2 + 0.055) / 1.055) ** 2.4, 1], rtol=1e-5)
    brushed = obj(tmp_path, "Pr 0.5\nmap_Pr grey.png\naniso 1", "aniso of materials with map_Pr (1)", grey=picture)
    assert brushed.anisotropy == 0
    ignored = "pictures of the metal of clear bodies (1)"
    body = obj(tmp_path, "illum 7\nd 0.25\nmap_Pr grey.png\nmap_Pm grey.png", ignored, grey=picture)
    assert (body.is_body, body.ior, body.transmission, body.metallic) == (True, 1.5, 0.75, pytest.approx(0.6))


@pytest.mark.parametrize(("text", "field"), [("", "normal_map"), ("Pr 0.5\n", "normal")])
def test_normals_of_mtl(tmp_path, text, field):
    picture = png([[[128, 128, 255], [255, 128, 128]]])
    texture = getattr(obj(tmp_path, f"{text}norm lean.png", lean=picture), field)
    np.testing.assert_allclose(texture.image, [[[0.5, 0.5, 1], [1, 0.5, 0.5]]], atol=0.003)


@pytest.mark.parametrize(
    ("options", "transform"),
    [
        ("-s 2 3 1 -o 0.5 -1 0", ((2, 0, 0.5), (0, 3, -1))),
        ("-s 4", ((4, 0, 0), (0, 1, 0))),
        ("-o 0.25 0.5", ((1, 0, 0.25), (0, 1, 0.5))),
        ("-clamp on", None),
    ],
)
def test_pictures_of_mtl_are_scaled_and_moved(tmp_path, options, transform):
    material = obj(tmp_path, f"map_Kd {options} half.png\nKd 1 1 1", half=HALF)
    assert material.color.transform == transform


@pytest.mark.parametrize("look", [{"metallicFactor": 2}, {"roughnessFactor": -1}, {"baseColorFactor": [5, 0, 0, 1]}])
def test_factors_of_gltf_beyond_their_range_are_named(tmp_path, look):
    material = gltf(tmp_path, OUTSIDE, pbrMetallicRoughness=look)
    assert max(material.metallic, material.roughness, *material.base_color) <= 1


def test_the_brightest_pixel_of_a_picture_bounds_what_mtl_sends_out(tmp_path):
    grey = png([[[188, 188, 188], [9, 9, 9]]])
    material = obj(tmp_path, "Kd 1 1 1\nmap_Kd grey.png\nKs 0.25", grey=grey)
    assert (material.diffuse, material.specular) == (1, 0.25)
    material = obj(tmp_path, "Kd 1 1 1\nmap_Kd grey.png\nKs 1", BEYOND, grey=grey)
    assert (
        material.diffuse == material.specular == pytest.approx(1 / (1 + ((188 / 255 + 0.055) / 1.055) ** 2.4), rel=1e-5)
    )


OPAQUE = "Tr 1 of materials without d, which are opaque (1)"


@pytest.mark.parametrize(
    ("text", "clear", "ignored"),
    [
        ("illum 2\nTr 1.000000", 0.0, [OPAQUE]),  # as MeshLab writes it
        ("Kd 1 0 0\nTr 1", 0.0, [OPAQUE]),
        ("illum 3\nTr 1", 0.0, [OPAQUE]),
        ("illum 2\nTr 0.75", 0.75, []),
        ("illum 2\nd 0\nTr 1", 1.0, []),
        ("illum 4\nTr 1", 1.0, []),
        ("illum 7\nTr 1", 1.0, []),
        ("illum 9\nTr 1", 1.0, []),
    ],
)
def test_a_transparency_of_1_is_opaque_in_models_without_transparency(tmp_path, text, clear, ignored):
    assert obj(tmp_path, text, *ignored).transmission == clear


def test_an_exponent_of_0_is_no_highlight(tmp_path):
    """A surface of Ns 0 and Ks 1 looks as one of Ks 0 in a Whitted picture: its lobe would make all of it white."""
    shiny = written(tmp_path, "Kd 0.5 0.25 0.125\nKs 1 1 1\nNs 0")
    with pytest.warns(sh.ShpyWarning, match=r"ignored: highlights of exponent 0 \(1\)"):
        scene = Scene.load(shiny)
    matt = Scene.load(written(tmp_path, "Kd 0.5 0.25 0.125\nKs 0 0 0\nNs 0"))
    one, other = (render(scene, (16, 16), backend="numpy") for scene in (scene, matt))
    assert (one.object_id == 0).any()
    np.testing.assert_array_equal(one.pixels, other.pixels)
    assert obj(tmp_path, "illum 1\nKs 1 1 1\nNs 0").specular == 0
    assert obj(tmp_path, "Kd 0 0 0\nKs 1 1 1\nNs 0.5").specular == 1
    made = trimesh.creation.box()
    look = trimesh.visual.material.SimpleMaterial(diffuse=[9, 9, 9], specular=[255, 255, 255], glossiness=0.0)
    made.visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(made.vertices), 2)), material=look)
    with pytest.warns(sh.ShpyWarning, match=r"highlights of exponent 0 \(1\)"):
        assert Mesh.from_trimesh(made).material.specular == 0


def test_dissolved_materials_of_mtl_are_mixed_with_what_is_behind(tmp_path):
    material = obj(tmp_path, "Kd 1 0 0\nd 0.25")
    np.testing.assert_allclose(before_green(material), np.broadcast_to([0.25, 0.75, 0], (8, 8, 3)), atol=1e-6)


def test_pictures_of_mtl(tmp_path):
    """map_d is the alpha of a picture that has some, or else its grey."""
    leaf = np.array([[[255, 0, 0, 255], [255, 0, 0, 0]]])
    grey = np.array([[[0, 0, 0], [255, 255, 255]]])
    pictures = {"leaf": png(leaf), "grey": png(grey)}
    material = obj(tmp_path, "map_Kd leaf.png\nmap_d leaf.png\nmap_Ke grey.png", **pictures)
    np.testing.assert_array_equal(material.cutout.image[0, :, 0], [1, 0])
    np.testing.assert_array_equal(material.emission.image[0], [[0] * 3, [1] * 3])
    material = obj(tmp_path, "map_d grey.png\nd 0.5", **pictures)
    np.testing.assert_array_equal(material.cutout.image[0, :, 0], [0, 1])
    assert material.transmission == 0.5
    assert isinstance(obj(tmp_path, "map_Kd leaf.png", **pictures).color, Texture)
    half = obj(tmp_path, "map_d half.png", "partial transparency of pictures (1)", half=HALF)
    assert half.cutout is None  # 128 / 255 is all there
    halo = "d -halo 0.5\nTf 1 0.5 1"
    assert obj(tmp_path, halo, "tints of clear materials (1), halos of materials (1)").transmission == 0.5


def test_a_mask_that_cannot_be_read_leaves_the_surface_whole(tmp_path):
    path = written(tmp_path, "map_d gone.png")
    with pytest.warns(sh.ShpyWarning, match=r"plain colours: gone.png \(there is no such file\)"):
        scene = Scene.load(path)
    assert scene.meshes[0].material.cutout is None


def test_large_masks_are_made_smaller(tmp_path, monkeypatch):
    monkeypatch.setattr("raytracer.meshes.pictures.MOST", 256)
    mask = np.zeros((32, 32, 4))
    mask[:, 16:] = 255
    path = written(tmp_path, "map_d mask.png", mask=png(mask))
    with pytest.warns(sh.ShpyWarning, match="detail of pictures beyond 256 pixels"):
        scene = Scene.load(path)
    image = scene.meshes[0].material.cutout.image
    height, width = image.shape[:2]
    assert height * width <= 128
    np.testing.assert_array_equal(image[0, :, 0], np.arange(width) >= width // 2)
