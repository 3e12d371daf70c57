"""The sessions of `raytracer view`, without server and browser: pictures, camera, surfaces, materials, lights, time."""

import argparse
import math
import threading
import time
import types
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gltf_files import File
from pages import wait_until
from patience import HANGING
from PIL import Image as pillow

import raytracer as rt
from raytracer import viewing
from raytracer.cli import _parser
from raytracer.integrators.layers import unset
from raytracer.integrators.renderer import Renderer
from raytracer.view import refining
from raytracer.view.command import file_of, options_of, request_of
from raytracer.view.refining import Pace, Refinement
from raytracer.view.session import Session, explain_opening, eye_ray, surface

SIZE = (24, 16)
MOVING = """
import raytracer as rt
from raytracer.meshes.shapes import sphere

def scene(time):
    ball = sphere(0.5, rt.Material((0.9, 0.1, 0.1)), rings=8, segments=12).moved((time, 0, 0))
    return rt.Scene([ball], [rt.PointLight((0, 5, 5))], rt.Camera((0, 0, 5), (0, 0, 0)), background=(0, 0, 0))
"""

GROWING = """
import raytracer as rt
from raytracer.meshes.shapes import floor, sphere

def scene(time):
    look = rt.Material((0, 0, 0), specular=0, emission=(0, 0, 1) if time > 1 else (0, 0, 0))
    balls = [sphere(0.5, look, rings=8, segments=12).moved((1 - k, 0, 0)) for k in range(int(time))]
    still = [floor(9).moved((0, -9, 0)), sphere(0.3, look, rings=8, segments=12)]
    lights = [rt.PointLight((0, 5, 5))] * (1 + int(time))
    return rt.Scene([*still, *balls], lights, rt.Camera((0, 0, 5), (0, 0, 0)), background=(0, 0, 0))
"""


def opened(*words):
    options = _parser().parse_args(["view", *map(str, words)])
    return Session(request_of(options), lambda: None, lambda header: None)


def pictures(session):
    """Yield the frames until the picture is finished."""

    def drawn():
        session.woken()
        return session.next()

    finished = False
    while not finished:
        found = wait_until(drawn)
        yield found
        finished = found[0]["finished"]


def last(session):
    *_, found = pictures(session)
    return found


@pytest.fixture(scope="module")
def session():
    found = opened("boxes", "--backend", "numpy", "--samples", "4", "--size", "24x16")
    found.set({"size": list(SIZE)})
    last(found)
    return found


@pytest.fixture(autouse=True)
def as_at_first(request):
    """Undo what the test before has set."""
    if "session" in request.fixturenames:
        found = request.getfixturevalue("session")
        names = [
            control["name"]
            for one in [*found.describe()["materials"], *found.describe()["lights"]]
            for control in one["controls"]
        ]
        found.set({"size": list(SIZE), "scene": {}, "params": dict.fromkeys([*names, "exposure"])})


def image(scene, **options):
    return rt.render(scene, SIZE, backend="numpy", **options)


def turned(**changes):
    camera = {"position": [0, 3, 9], "target": [0, 0.5, 0], "up": [0, 1, 0], "fov": 50, "span": 2, **changes}
    return {"scene": {"camera": camera, "stamp": 7}}


def test_the_finished_picture_is_that_of_render(session):
    header, pixels = last(session)
    expected = image(rt.Scene.builtin("boxes"), samples=4).to_pil()
    assert (header["width"], header["height"], header["form"]) == (*SIZE, "Whitted on numpy")
    assert pixels[..., :3].tolist() == np.asarray(expected).tolist()


def test_a_turned_camera_is_shown_at_once_with_its_stamp(session):
    last(session)
    session.set(turned())
    assert session.next()[0]["stamp"] == 7
    scene = replace(rt.Scene.builtin("boxes"), camera=rt.Camera((0, 3, 9), (0, 0.5, 0), fov=50))
    assert last(session)[1][..., :3].tolist() == np.asarray(image(scene, samples=4).to_pil()).tolist()


@pytest.mark.parametrize(
    "wrong", [{"position": [0, 0.5, 0]}, {"fov": 0}, {"up": [1]}, {"target": "here"}, {"up": [0, 2.5, 9]}]
)
def test_a_camera_that_sees_nothing_is_refused_and_the_one_before_stays(session, wrong):
    session.set(turned())
    assert len(session.set(turned(**wrong))) == 1
    assert session.seen.position == (0, 3, 9)


def test_a_coarse_picture_comes_first_where_all_pixels_take_long(session):
    renderer = rt.Renderer(rt.Scene.builtin("boxes"), backend="numpy", samples=4)
    slow = Pace(rays=48 * 48, seconds=10.0)
    steps = list(Refinement(renderer, slow, (96, 64), renderer.scene.camera))
    assert steps[0].coarse
    assert [step.samples for step in steps if step.share == 1.0 and not step.coarse] == [1, 4]
    once = list(Refinement(renderer, Pace(rays=48 * 48, seconds=10.0), (96, 64), renderer.scene.camera, at_once=True))
    assert [step.coarse for step in once] == [True]


def test_the_time_of_a_picture_that_waited_for_the_optimized_kernel_is_forgotten(monkeypatch):
    kernel, now = types.SimpleNamespace(notes=("not optimized",)), [0.0]

    def rows(size, top, count, **_):
        now[0] += 2.0 if kernel.notes else 0.01
        kernel.notes = ()
        return unset(size[0], count)

    monkeypatch.setattr(refining, "time", types.SimpleNamespace(perf_counter=lambda: now[0]))
    renderer = types.SimpleNamespace(kernel=kernel, rows=rows, integrator=rt.Whitted(), params={})
    pace = Pace(seconds=0.06)
    for expected in (None, 0.01):
        piece = next(Refinement(renderer, pace, (96, 64), None, at_once=True))
        assert piece.coarse
        assert (pace.seconds and round(pace.seconds, 3), pace.plain) == (expected, False)


def test_a_path_traced_picture_is_refined_to_the_bits_of_render():
    scene = rt.Scene.builtin("cornell")
    renderer = rt.Renderer(scene, backend="numpy", integrator="path", samples=6, bounces=2)
    refinement = Refinement(renderer, Pace(), (12, 10), scene.camera)
    samples = [piece.samples for piece in refinement]
    assert samples == sorted(samples)
    assert samples[-1] == 6
    expected = renderer.render((12, 10))
    assert refinement.layers["pixels"].tobytes() == expected.pixels.tobytes()
    assert refinement.layers["object_id"].tobytes() == expected.object_id.tobytes()


@pytest.mark.sampled(3)
@pytest.mark.parametrize("projection", ["perspective", "orthographic", "panorama"])
def test_a_surface_is_where_the_intersector_finds_it(projection):
    scene = rt.Scene.builtin("boxes")
    camera = rt.Camera((4, 4, 8), (0, 0.7, 0), fov=50, projection=projection, span=6)
    renderer = rt.Renderer(scene, backend="numpy", bounces=0)
    at = (8, 12)
    hit = surface(renderer, camera, SIZE, at)
    origin, ray = eye_ray(camera, SIZE, at)
    hits = rt.Intersector(scene, backend="numpy").intersect([origin], [ray])
    assert hit["distance"] == pytest.approx(float(hits.t[0]), rel=1e-5)
    assert hit["position"] == pytest.approx(origin + float(hits.t[0]) * ray, abs=1e-4)
    ends = np.cumsum([len(mesh) for mesh in scene.meshes])
    assert hit["number"] == np.searchsorted(ends, hits.triangle[0], side="right")
    assert np.linalg.norm(hit["normal"]) == pytest.approx(1, abs=1e-5)


def test_a_pixel_tells_its_object_material_position_and_normal(session):
    last(session)
    found, _ = session.answer({"about": "surface", "at": [11, 12]})
    assert (found["object"], found["material"]) == ("box", session.edits.labels[found["number"]])
    assert found["normal"].tolist() == pytest.approx([0, 1, 0], abs=1e-6)
    assert found["position"][1] == pytest.approx(0, abs=1e-4)  # the top of the slab
    assert session.answer({"about": "object", "at": [11, 12]})[0]["number"] == found["number"]
    nothing = session.answer({"about": "surface", "at": [0, 0]})[0]
    assert nothing == {"at": [0, 0], "number": None}
    assert "no answer" in session.answer({"about": "weather", "at": [0, 0]})[0]["problem"]


def test_the_camera_is_saved_as_code_and_as_a_command_that_render_takes(session):
    session.set({**turned(position=[-1.5, 3, 9]), "params": {"exposure": [1.5]}})
    texts, _ = session.answer({"about": "camera"})
    assert texts["code"] == "Camera(position=(-1.5, 3.0, 9.0), target=(0.0, 0.5, 0.0), up=(0.0, 1.0, 0.0), fov=50.0)"
    assert eval(texts["code"], {"Camera": rt.Camera}) == session.seen
    command = (
        "raytracer render boxes --size 24x16 --backend numpy --samples 4 --camera -1.5,3,9 --target 0,0.5,0 --up 0,1,0"
    )
    assert texts["command"] == f"{command} --fov 50.0 --exposure 1.5"
    options = _parser().parse_args(viewing.joined(texts["command"].split()[1:]))
    assert viewing.scene_of(options).camera == session.seen


def test_a_calibrated_camera_stays_that_of_the_scene_until_it_is_turned(tmp_path):
    path = tmp_path / "calibrated.py"
    calibrated = "rt.Camera.from_intrinsics([[20, 0, 9], [0, 20, 9], [0, 0, 1]], [[1, 0, 0, 0], [0, -1, 0, 0], "
    calibrated += "[0, 0, -1, 5], [0, 0, 0, 1]], (24, 16))"
    path.write_text(MOVING.replace("rt.Camera((0, 0, 5), (0, 0, 0))", calibrated))
    session = opened(path, "--backend", "numpy")
    texts, _ = session.answer({"about": "camera"})
    assert texts["code"] == "scene.camera  # calibrated: the scene has its intrinsics"
    assert texts["animation"] == f"raytracer animate {path} --size 512x512"
    session.set(turned())
    assert "--camera 0,3,9" in session.answer({"about": "camera"})[0]["command"]
    assert session.seen.intrinsics is None


def test_a_glb_file_plays_its_animation(tmp_path):
    file = File()
    node = file.node(mesh=file.mesh(file.square()), translation=[0, 0, 0])
    channel = {"sampler": 0, "target": {"node": node, "path": "translation"}}
    steps = {"input": file.array([0, 2]), "output": file.array([[0, 0, 0], [9, 0, 0]]), "interpolation": "LINEAR"}
    file.add("animations", {"channels": [channel], "samplers": [steps]})
    path = tmp_path / "slide.glb"
    path.write_bytes(file.glb())
    session = opened(path, "--backend", "numpy", "--samples", "1", "--no-floor")
    session.set({"size": list(SIZE)})
    assert session.describe()["seconds"] == pytest.approx(2)
    first = last(session)[1].copy()
    session.set({"time": 1.0})
    later = last(session)[1].copy()
    assert not np.array_equal(first, later)
    session.reset()
    assert np.array_equal(last(session)[1], first)
    assert session.answer({"about": "camera"})[0]["animation"].startswith(f"raytracer animate {path} --size ")


def test_pictures_beside_a_scene_are_watched(tmp_path):
    (tmp_path / "t.mtl").write_text("newmtl paint\nmap_Kd wood.png\n")
    pillow.new("RGB", (2, 2), (200, 100, 0)).save(tmp_path / "wood.png")
    path = tmp_path / "t.obj"
    path.write_text("mtllib t.mtl\nusemtl paint\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n")
    watched = opened(path, "--backend", "numpy").files()
    assert {str(tmp_path / name) for name in ("t.obj", "t.mtl", "wood.png")} <= set(watched)


def test_numbers_of_a_material_and_a_light_change_the_picture(session):
    before = last(session)[1]
    label = session.edits.labels[0]
    assert session.set({"params": {f"material.{label}.color": [0.9, 0, 0], "light.0.color": [0, 0, 0]}}) == []
    scene = rt.Scene.builtin("boxes")
    meshes = list(scene.meshes)
    meshes[0] = meshes[0].with_material(replace(meshes[0].material, color=(0.9, 0, 0)))
    lights = [replace(scene.lights[0], color=(0, 0, 0)), scene.lights[1]]
    expected = image(replace(scene, meshes=meshes, lights=lights), samples=4)
    assert last(session)[1][..., :3].tolist() == np.asarray(expected.to_pil()).tolist()
    session.set({"params": {f"material.{label}.color": None, "light.0.color": None}})
    assert last(session)[1].tolist() == before.tolist()


def test_a_light_can_be_moved_to_twice_its_largest_coordinate(session):
    found = {control["name"]: control for control in session.describe()["lights"][0]["controls"]}["light.0.position"]
    most = 2 * max(map(abs, found["value"]))
    assert found["range"] == [-most, most]


def test_a_number_that_a_material_refuses_is_said_and_names_of_other_scenes_are_left_out(session):
    label = session.edits.labels[0]
    refused = session.set(
        {"params": {f"material.{label}.reflectivity": [3], "material.gone.color": [1, 0, 0], "light.9.color": [1]}}
    )
    assert refused == ["a reflectivity lies in [0, 1], not 3.0"]
    assert session.edits.applied(session._scene) is session._scene


def test_exposure_brightens_the_picture_that_there_is(session):
    before = last(session)[1].copy()
    session.set({"params": {"exposure": [1]}})
    header, pixels = session.next()
    assert header["milliseconds"] == 0  # no ray was traced
    assert (pixels.astype(int) >= before).all()
    assert (pixels.astype(int) > before).any()
    session.set({"params": {"exposure": None}})
    assert session.next()[1].tolist() == before.tolist()


def test_materials_are_named_by_their_meshes(session):
    described = session.describe()
    labels = [one["label"] for one in described["materials"]]
    assert labels == ["box", "box 2", "box 3"]
    assert [one["label"] for one in described["lights"]] == ["1: point", "2: point"]
    form = {one["name"]: one["form"] for one in described["materials"][0]["controls"]}
    assert (form["material.box.color"], form["material.box.ior"]) == ("color", "number")


def test_another_integrator_takes_the_place_of_the_one_before(session, monkeypatch):
    made = threading.Event()

    def make(*given, **options):
        assert made.wait(HANGING)
        return Renderer(*given, **options)

    monkeypatch.setattr(refining, "Renderer", make)
    session.set({"scene": {"integrator": "path"}})
    before = [header for header, _ in pictures(session)]
    assert {(header["form"], header["waiting"]) for header in before} == {("Whitted on numpy", "Path on numpy")}
    made.set()
    header, _ = next(pictures(session))  # all 256 samples take more than a minute
    assert (header["form"], header["waiting"]) == ("Path on numpy", None)
    assert session.set({"scene": {"integrator": "magic"}}) == ["the integrator is one of whitted, path, not 'magic'"]
    assert session.set({"scene": {"integrator": "whitted"}}) == []


def test_a_scene_of_a_python_file_moves_steps_and_begins_anew(tmp_path):
    path = tmp_path / "moving.py"
    path.write_text(MOVING)
    session = opened(path, "--backend", "numpy", "--samples", "1", "--seconds", "2")
    session.set({"size": [16, 16], "playing": False})
    assert session.describe()["seconds"] == 2
    middle = last(session)[1][8, 8].tolist()
    session.set({"time": 1.0})
    assert last(session)[1][8, 8].tolist() == [0, 0, 0, 255] != middle
    session.step()
    assert last(session)[0]["time"] == pytest.approx(1 + 1 / 24)
    session.set({"time": 1.99, "playing": True})
    time.sleep(0.05)
    frames = [session.next()[0] for _ in range(2)]
    assert all(0 <= frame["time"] < 2 for frame in frames)
    session.set({"playing": False})
    session.reset()
    assert last(session)[1][8, 8].tolist() == middle
    assert session.files() == [str(path)]
    assert session.answer({"about": "camera"})[0]["command"].startswith(f"raytracer render {path} --size 16x16 ")


def test_a_scene_may_get_more_meshes_and_other_materials_with_time(tmp_path):
    """Clicks on later meshes were errors, and so was any edit, which also stopped the changes of other materials."""
    path = tmp_path / "growing.py"
    path.write_text(GROWING)
    session = opened(path, "--backend", "numpy", "--size", "24x16", "--samples", "1")
    session.set({"size": list(SIZE), "time": 2.5})
    assert last(session)[1][8, 12].tolist() == [0, 0, 255, 255]
    found, _ = session.answer({"about": "surface", "at": [8, 12]})
    assert (found["number"], found["object"], found["material"]) == (3, "sphere", "sphere")
    session.set({"params": {"material.floor.specular": [0.0]}})
    assert last(session)[1][8, 12].tolist() == [0, 0, 255, 255]
    session.set({"params": {"material.sphere.emission": [1.0, 0.0, 0.0]}})
    assert last(session)[1][8, 12].tolist() == [255, 0, 0, 255]
    session.set({"time": 0.0})
    assert last(session)[1][8, 12].tolist() == [255, 0, 0, 255]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("wrong", [5000.0, -65.0, math.nan])
def test_an_exposure_beyond_that_of_the_command_is_refused(session, wrong):
    shown = last(session)[1].tolist()
    assert session.set({"params": {"exposure": [wrong]}}) == [f"an exposure is a number from -64 to 64, not {wrong:g}"]
    session.set(turned())
    session.set({"scene": {}})
    assert last(session)[1].tolist() == shown


ODD = "class Odd(Exception):\n    {}\ndef scene(time):\n    raise Odd('it is odd')\n"


@pytest.mark.parametrize(
    ("text", "message", "line"),
    [
        ("def scene(time):\n    return nothing\n", "name 'nothing' is not defined", 2),
        ("import raytracer as rt\ndef scene(time):\n    return rt.Scene(ambient=2)\n", "ambient lies in [0, 1]", 3),
        ("scene = (\n", "'(' was never closed", 1),
        ("x = 1\n", "defines no function scene", None),
        (ODD.format("def __str__(self): raise ValueError"), "str() failed", 4),
        (ODD.format("message, loc, cure = b'', 3, {}"), "it is odd", 4),
        ("def scene(time):\n    return 3\n", "returns int, not a raytracer.Scene", None),
    ],
)
def test_a_mistake_in_a_file_is_explained_with_its_line(tmp_path, text, message, line):
    path = tmp_path / "wrong.py"
    path.write_text(text)
    with pytest.raises(rt.SceneError) as error:
        opened(path)
    found = explain_opening(error.value, {"path": str(path), "options": {"environment": None}})
    assert message in found["message"]
    assert (found["line"], found["files"]) == (line, [str(path)])


def test_a_mistake_has_its_line_where_the_file_is_named_from_its_folder(tmp_path, monkeypatch):
    (tmp_path / "wrong.py").write_text("def scene(time):\n    return nothing\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(rt.SceneError) as error:
        opened("wrong.py")
    found = explain_opening(error.value, {"path": str(tmp_path / "wrong.py"), "options": {"environment": None}})
    assert (found["file"], found["line"]) == (str(tmp_path / "wrong.py"), 2)


def test_scenes_that_there_are_not(tmp_path):
    with pytest.raises(
        rt.SceneError, match=r"'nowhere' is neither a file nor a built-in scene; the scenes are boxes, .*, animated"
    ):
        file_of("nowhere")
    with pytest.raises(rt.SceneError, match="neither a file"):
        file_of(str(tmp_path / "gone.obj"))
    assert file_of("boxes").name == "scenes.py"
    assert file_of("animated").name == "animation.py"


def test_a_request_gives_the_options_back():
    words = ["view", "boxes", "--camera", "1,2,3", "--background", "#ffffff", "--environment", "sky.png"]
    options = _parser().parse_args(words)
    options.integrator = "path"
    found = options_of(request_of(options))
    expected = {name: value for name, value in vars(options).items() if name != "run"}
    assert found == argparse.Namespace(**expected)
    assert found.environment == Path("sky.png")
    assert found.camera == (1, 2, 3)
    assert math.isclose(found.background[0], 1)


@pytest.mark.slow
def test_the_page_may_switch_from_a_staged_tracer_to_path_tracing():
    session = opened("boxes", "--backend", "numpy", "--tracer", "staged", "--accel", "brute")
    session.set({"size": [8, 6]})
    shown = last(session)[0]
    assert shown["form"] == "Staged on numpy"
    names = [text["name"] for text in session.answer({"about": "text"})[0]["texts"]]
    assert {"generate", "traverse", "intersect", "shade"} <= set(names)
    session.set({"scene": {"integrator": "path"}})
    assert str(session.form) == "Path on numpy"
    assert session.form.integrator.accel == "brute"


def test_a_view_tells_at_every_opening_what_is_ignored_in_a_file(tmp_path):
    """Python itself shows the warning of a line once, and hides those that a filter ignores."""
    (tmp_path / "t.mtl").write_text("newmtl paint\nmap_Kd gone.png\n")
    path = tmp_path / "t.obj"
    path.write_text("mtllib t.mtl\nusemtl paint\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        told = [opened(path, "--backend", "numpy").describe()["notices"] for _ in range(2)]
    assert told == [["t.obj: ignored: pictures of meshes without uv coordinates (1)"]] * 2
