"""Test the framing of meshes, and the options of the command line for the camera."""

import argparse

import numpy as np
import pytest
from PIL import Image as pillow

from raytracer import Instance, Scene, SceneError, cli, render, viewing
from raytracer.image import Image
from raytracer.meshes.shapes import box, knot, sphere
from raytracer.scene.camera import Camera
from raytracer.scene.framing import FILLED, fitted, free_ways, upright

QUAD = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"
SHAPES = {
    "ball": sphere(3.0).moved((100, 7, -3)),
    "cube": box(),
    "tall": box((1, 8, 1)),
    "wide": box((8, 1, 1)),
    "deep": box((1, 1, 8)),
    "slab": box((5, 0.1, 5)),
    "knot": knot(segments=120, sides=12),
    "small": sphere(1e-6).moved((3, 3, 3)),
    "tiny": box().moved(scale=1e-200),
    "large": box().moved(scale=1e30),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", SHAPES)
def test_what_is_framed_spans_the_picture(name):
    image = render(Scene.framed(SHAPES[name]), (100, 100), backend="numpy", bounces=0)
    seen = np.argwhere(image.object_id == 0)
    spans = seen.max(axis=0) - seen.min(axis=0) + 1
    assert abs(spans.max() - 100 * FILLED) <= 2
    middle = (seen.max(axis=0) + seen.min(axis=0)) / 2
    assert abs(middle[spans.argmax()] - 49.5) <= 2
    assert seen.min() >= 5
    assert seen.max() <= 94


def test_a_ball_covers_three_fifths():
    image = render(Scene.framed(sphere()), (100, 100), backend="numpy", bounces=0)
    assert 0.58 < (image.object_id == 0).mean() < 0.63


@pytest.mark.parametrize("size", [(150, 60), (60, 150)])
def test_wide_and_high_pictures_show_all_of_it(size):
    image = render(Scene.framed(SHAPES["cube"]), size, backend="numpy", bounces=0)
    seen = np.argwhere(image.object_id == 0)
    assert seen.min() > 0
    assert (seen.max(axis=0) < np.array(size[::-1]) - 1).all()


@pytest.mark.parametrize("up", [(0, 0, 1), (0, -1, 0), (1, 0, 0), (0.3, -0.2, 5)])
def test_a_rotation_takes_y_to_what_is_up(up):
    turn = upright(up)
    np.testing.assert_allclose(turn @ (0, 1, 0), np.array(up) / np.linalg.norm(up), atol=1e-12)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) > 0


def test_a_mesh_whose_up_is_z_gives_the_picture_of_the_one_that_stands():
    mesh = knot(segments=60, sides=12)
    lying = Instance(mesh, np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])).placed
    one, other = (
        render(scene, (60, 60), backend="numpy") for scene in (Scene.framed(mesh), Scene.framed(lying, up=(0, 0, 1)))
    )
    assert (one.object_id == other.object_id).mean() > 0.995
    assert np.abs(one.pixels - other.pixels).mean() < 0.01


@pytest.mark.parametrize("inward", [True, False])
def test_the_lights_of_a_room_are_inside(inward):
    """Whichever way its walls face. Ambient light alone would leave 0.12 of the colour."""
    room = box((4, 3, 6), inward=inward).moved((0, 50, 0))
    scene = Scene.framed(room, camera=Camera((1.5, 50, 2.5), (0, 50, -3), fov=80), floor=False)
    image = render(scene, (40, 40), backend="numpy", bounces=0)
    assert (image.object_id == 0).all()
    assert np.median(image.pixels) > 0.3
    dark = render(Scene(room, Scene.framed(room).lights, scene.camera), (40, 40), backend="numpy", bounces=0)
    assert np.median(dark.pixels) < 0.11


def test_the_lights_of_a_place_under_the_sky_are_outside():
    walls = [box((0.1, 3, 6)).moved((x, 0, 0)) for x in (-2, 2)]
    street = [*walls, box((4, 0.1, 6)).moved((0, -1.5, 0))]
    scene = Scene.framed(street, camera=Camera((0, 0, 2.5), (0, 0, -3)))
    assert scene.lights == Scene.framed(street).lights


def test_free_ways():
    ways = np.array([(1, 0, 0), (0, -1, 0), (0.6, 0, 0.8)])
    np.testing.assert_allclose(free_ways([box((4, 2, 20))], np.array([1.0, 0, 0]), ways), [1, 1, 1 / 0.6])
    assert np.isinf(free_ways([box().moved((-5, 0, 0))], np.zeros(3), ways)).all()


def test_what_has_no_size_has_a_camera():
    rod = box((1, 1, 1)).transformed(np.diag([0, 0, 0, 1]))
    assert np.isfinite(fitted([rod], np.eye(3)).position).all()
    assert np.isfinite(fitted([], np.eye(3)).position).all()


def test_up_is_a_direction():
    with pytest.raises(SceneError, match="not all 0"):
        Scene.framed(box(), up=(0, 0, 0))


@pytest.fixture
def quad(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quad.obj").write_text(QUAD)
    pillow.fromarray(np.full((4, 8, 3), (0, 0, 255), np.uint8)).save("sky.png")
    return tmp_path


def rendered(*options, scene="quad.obj"):
    assert cli.main(["render", scene, "-o", "a.npy", "--size", "20x20", "--backend", "numpy", *options]) == 0
    return Image.load("a.npy")


def test_the_camera_of_a_file(quad):
    """A square of one unit, from in front and as high as the picture: then from behind, from -z."""
    image = rendered("--camera", "0.5,0.5,2", "--target", "0.5,0.5,0", "--fov", "28.07", "--no-floor")
    assert (image.object_id == 0).all()
    assert image.normal[0, 0, 2] > 0.9
    image = rendered("--camera", "-1.5,0.5,-2", "--target", "0.5,0.5,0", "--background", "1,0.5,0.25", "--no-floor")
    assert image.normal[10, 10, 2] < -0.9
    assert set(np.unique(image.object_id)) == {-1, 0}
    assert image.pixels[0, 0].tolist() == [1, 0.5, 0.25]


def test_the_camera_of_a_built_in_scene(quad):
    scene = Scene.builtin("boxes")
    image = rendered("--camera", "0,12,0.1", scene="boxes")
    moved = Scene(scene.meshes, scene.lights, Camera((0, 12, 0.1), scene.camera.target, fov=scene.camera.fov))
    assert np.array_equal(image.object_id, render(moved, (20, 20), backend="numpy").object_id)


@pytest.mark.parametrize(
    ("option", "value", "field"),
    [("camera", (0, 1, -3), "position"), ("target", (5, 0, 1), "target"), ("up", (1, 0, 0), "up"), ("fov", 90, "fov")],
)
def test_the_options_of_the_camera_count_where_a_calibrated_one_is_given(option, value, field):
    calibrated = Camera.from_intrinsics([[40, 0, 10], [0, 40, 12], [0, 0, 1]], np.eye(4), (32, 24))
    options = argparse.Namespace(**{"camera": None, "target": None, "up": None, "fov": None} | {option: value})
    names = ("position", "target", "up", "fov")
    wanted = Camera(**{name: getattr(calibrated, name) for name in names} | {field: value}).view(32, 24)
    for found, expected in zip(viewing._turned(calibrated, options).view(32, 24), wanted, strict=True):
        np.testing.assert_array_equal(found, expected)
    unset = argparse.Namespace(camera=None, target=None, up=None, fov=None)
    assert viewing._turned(calibrated, unset) is calibrated


def test_up_turns_the_picture(quad):
    options = ("--camera", "0.3,0.5,3", "--target", "0.3,0.5,0", "--no-floor", "--up")
    y, minus_y = rendered(*options, "0,1,0"), rendered(*options, "0,-1,0")
    assert np.array_equal(y.object_id, minus_y.object_id[::-1, ::-1])
    assert not np.array_equal(y.object_id, minus_y.object_id)
    z = rendered("--up", "z")
    assert z.normal[-1, 10].tolist() == pytest.approx([0, 0, 1])  # the floor


@pytest.mark.parametrize("stops", ["-1.", "-1e0"])
def test_an_exposure_below_0_is_written_as_any_number(quad, stops):
    for name, words in (("a.png", stops), ("b.png", "-1")):
        given = ["render", "quad.obj", "-o", name, "--size", "8x8", "--backend", "numpy", "--exposure", words]
        assert cli.main(given) == 0
    assert np.array_equal(np.asarray(pillow.open("a.png")), np.asarray(pillow.open("b.png")))


def test_exposure_doubles_the_light(quad):
    for stops in ("0", "1"):
        arguments = ["render", "quad.obj", "-o", f"{stops}.png", "--size", "8x8", "--exposure", stops]
        assert cli.main([*arguments, "--background", "0.25,0.1,0", "--camera", "0,0,-5", "--target", "0,0,-9"]) == 0
    pixels = [np.asarray(pillow.open(f"{stops}.png"))[0, 0].tolist() for stops in "01"]
    assert pixels == [[137, 89, 0], [188, 124, 0]]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("integrator", ["whitted", "path"])
def test_an_environment_takes_the_place_of_the_two_lights(integrator, quad):
    options = ("--integrator", integrator, "--samples", "4", "--environment", "sky.png", "--no-floor")
    image = rendered(*options)
    assert image.pixels[0, 0].tolist() == pytest.approx([0, 0, 1])
    square = image.pixels[image.object_id == 0]
    assert square[:, :2].max() == 0
    assert square[:, 2].mean() > 0.1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--environment", "gone.png"], "no picture gone.png: --environment is the path of"),
        (["--exposure", "1"], "--exposure is for .png; .exr and .npy hold the light as it is"),
        (["--camera", "1,1,1", "--target", "1,1,1"], "--camera is 1,1,1, --target is 1,1,1, --up is 0,1,0; choose"),
        (["--camera", "0,3,0", "--target", "0,0,0"], "must not be along its line of sight: --camera is 0,3,0"),
    ],
)
def test_options_that_do_not_go_together(options, words, quad, monkeypatch, capsys):
    monkeypatch.setattr(cli, "render", None)
    assert cli.main(["render", "quad.obj", "-o", "b.npy", *options]) == 1
    assert words in capsys.readouterr().err


def test_a_built_in_scene_keeps_its_floor(capsys):
    assert cli.main(["render", "boxes", "--no-floor"]) == 1
    assert "--no-floor is for files" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--camera", "1,2", "three numbers with commas between them, such as 1,0.5,-2, not '1,2'"),
        ("--target", "-1,nan,2", "not '-1,nan,2'"),
        ("--up", "0,0,0", "a direction that is not zero, such as 0,0,1, or z"),
        ("--fov", "180", "an angle between 0 and 180 degrees, such as 40, not '180'"),
        ("--background", "red", "'red'"),
        ("--background", "-1,0,0", "three linear numbers R,G,B from 0 on, or a picture such as sky.hdr, not '-1,0,0'"),
        ("--exposure", "1e9", "a number from -64 to 64, such as 1.5"),
    ],
)
def test_values_that_cannot_be_read(option, value, words, capsys):
    with pytest.raises(SystemExit):
        cli.main(["render", "boxes", option, value])
    assert words in capsys.readouterr().err


def test_a_colour_of_a_background_is_srgb_or_linear():
    assert viewing._color("#ff0000") == (1, 0, 0)
    assert viewing._color("#808080")[0] == pytest.approx(0.2158605)
    assert viewing._color("2,0,0.5") == (2, 0, 0.5)


def test_the_help_shows_examples(capsys):
    with pytest.raises(SystemExit):
        cli.main(["render", "--help"])
    said = capsys.readouterr().out
    assert "--camera 2,1,3 --target 0,0.5,0" in said
    assert "how the scene is seen" in said
