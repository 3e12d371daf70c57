"""The page of `raytracer view` in a browser: the camera, surfaces, materials and lights, time, errors."""

import json
import math

import numpy as np
import pytest
from patience import PAGE
from views import new_page, viewed, watched
from websockets.sync.client import connect

import raytracer as rt

SCENE = """
import raytracer as rt
from raytracer.meshes.shapes import sphere

def scene(time):
    ball = sphere(1, rt.Material({color}, specular=0), rings=8, segments=12)
    camera, light = rt.Camera((0, 1, 6), (0, 0, 0), aspect=1.5), rt.PointLight((0, 5, 5))
    return rt.Scene([ball.moved((time, 0, 0))], [light], camera, background=(0, 0, 0), ambient=0)
"""
RED, BLUE = "(0.9, 0, 0)", "(0, 0, 0.9)"


@pytest.fixture(scope="module")
def view(tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "ball.py"
    path.write_text(SCENE.format(color=RED))
    options = ("--backend", "numpy", "--size", "40x40", "--samples", "1", "--bounces", "0", "--seconds", "3")
    with viewed(path, *options, command=("raytracer", "view")) as found:
        yield found


@pytest.fixture
def shown(browser, view):
    """Return a page that shows the file as the previous test has left it: each version costs a process."""
    with connect(view.url.replace("http", "ws") + "view", origin=view.url.rstrip("/")) as line:
        names = ("material.sphere.color", "light.0.color", "exposure")
        changes = {"scene": {}, "params": dict.fromkeys(names), "playing": False, "time": 0}
        line.send(json.dumps({"do": "set", "changes": changes}))
    with watched(browser, view, width=1000, height=800) as page:
        page.wait_for_selector("#code:text-matches('Camera')")
        yield page


@pytest.fixture
def page(shown, view):
    """Return a page that shows the scene as it is at first."""
    if view.path.read_text() != SCENE.format(color=RED):
        view.save(SCENE.format(color=RED))
    settles(shown, ("red", True))
    return shown


PLANES = {"red": 0, "green": 1, "blue": 2}


def settles(page, *expected):
    """Wait until the picture is finished and its middle has, or has not, the colours."""
    page.wait_for_function(
        """(expected) => {
            const picture = document.getElementById("picture");
            const data = picture.getContext("2d").getImageData(picture.width >> 1, picture.height >> 1, 1, 1).data;
            return document.body.dataset.finished === "true" && expected.every(([k, is]) => (data[k] > 60) === is);
        }""",
        arg=[[PLANES[name], there] for name, there in expected],
    )


def camera(page):
    """Return the camera of the code that the page shows."""
    page.wait_for_selector("#camera-section[aria-busy=false]")  # the text follows when the camera is at rest
    return eval(page.inner_text("#code"), {"Camera": rt.Camera})


def middle(page):
    box = page.locator("#picture").bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def drag(page, button="left"):
    x, y = middle(page)
    page.mouse.move(x, y)
    page.mouse.down(button=button)
    page.mouse.move(x + 60, y + 20, steps=3)
    page.mouse.up(button=button)


def distance(one):
    return float(np.linalg.norm(np.subtract(one.position, one.target)))


@pytest.mark.slow
def test_a_drag_turns_the_camera_about_its_target(page):
    before = camera(page)
    drag(page)
    after = camera(page)
    assert after.target == before.target
    assert distance(after) == pytest.approx(distance(before), rel=1e-4)
    assert after.position[0] < -0.5  # the scene follows the pointer
    assert after.position[1] > before.position[1]
    assert int(page.get_attribute("body", "data-answer")) > 0
    page.click("#home")
    assert camera(page) == before


@pytest.mark.slow
def test_the_right_button_moves_the_wheel_zooms_and_keys_do_both(page):
    before, sides = camera(page), [page.locator("#picture").bounding_box()["width"]]
    drag(page, "right")
    moved = camera(page)
    sides.append(page.locator("#picture").bounding_box()["width"])
    offset = np.subtract(moved.target, before.target)
    assert offset == pytest.approx(np.subtract(moved.position, before.position), abs=1e-4)
    assert offset[0] < 0 < offset[1]
    span = 1.5 * 2 * distance(before) * math.tan(math.radians(before.fov) / 2)  # across the square picture
    assert sides[0] == sides[1]  # a line of text that comes or goes must not move the picture under the pointer
    assert float(np.linalg.norm(offset)) == pytest.approx(math.hypot(60, 20) / sides[0] * span, rel=0.01)
    height = page.input_value("[aria-label='position y']")
    page.mouse.wheel(0, -200)  # which returns before the page has heard of it
    page.wait_for_function("(y) => document.querySelector(\"[aria-label='position y']\").value !== y", arg=height)
    nearer = camera(page)
    assert distance(nearer) < 0.8 * distance(moved)
    page.focus("#picture")
    page.keyboard.press("-")
    assert distance(camera(page)) == pytest.approx(1.15 * distance(nearer), rel=1e-4)
    page.keyboard.press("ArrowRight")
    assert camera(page).position[0] > nearer.position[0]
    page.keyboard.press("Shift+ArrowUp")
    assert camera(page).target[1] != nearer.target[1]
    page.keyboard.press("h")
    assert camera(page) == before


def test_two_fingers_move_and_zoom(page):
    before = camera(page)
    page.evaluate(
        """() => {
            const picture = document.getElementById("picture"), box = picture.getBoundingClientRect();
            picture.setPointerCapture = () => {};
            const [x, clientY] = [box.left + box.width / 2, box.top + box.height / 2];
            const rest = { pointerType: "touch", buttons: 1 };
            const touch = (kind, pointerId, aside) =>
                picture.dispatchEvent(new PointerEvent(kind, { pointerId, clientX: x + aside, clientY, ...rest }));
            touch("pointerdown", 1, -50); touch("pointerdown", 2, 50);
            touch("pointermove", 2, 100); touch("pointermove", 1, -100);
            touch("pointerup", 1, -100); touch("pointerup", 2, 100);
        }"""
    )
    after = camera(page)
    assert distance(after) == pytest.approx(distance(before) / 2, rel=1e-4)
    assert after.target == pytest.approx(before.target, abs=0.1)
    assert page.is_visible("#unpicked")  # no finger has clicked


def test_a_click_picks_a_surface_and_the_camera_turns_about_it(page):
    page.mouse.click(*middle(page))
    page.wait_for_selector("#found:not([hidden])")
    texts = page.eval_on_selector_all("#found dd", "(all) => all.map((one) => one.textContent)")
    assert texts[:2] == ["sphere (number 0)", "sphere"]
    place = [float(part) for part in texts[2].split(", ")]
    assert np.linalg.norm(place) == pytest.approx(1, abs=0.1)
    assert page.is_visible("#mark")
    assert page.input_value("#material") == "sphere"
    page.keyboard.press("t")
    assert camera(page).target == pytest.approx(place, abs=1e-5)
    assert page.is_hidden("#mark")
    page.mouse.click(middle(page)[0], page.locator("#picture").bounding_box()["y"] + 3)
    page.wait_for_selector("#unpicked:text-matches('background')")
    assert page.is_disabled("#aim")


def test_a_material_a_light_and_the_exposure_change_the_picture(page):
    page.select_option("#material", "sphere")
    page.get_by_label("color", exact=True).first.fill("#00ff00")
    settles(page, ("red", False), ("green", True))
    assert page.inner_text("#material-controls code") == "0, 1, 0"
    page.get_by_label("exposure, number").fill("-6")
    page.keyboard.press("Tab")
    settles(page, ("green", False))
    page.wait_for_selector("#command:text-matches('--exposure -6')")
    for undo in page.query_selector_all("button.undo:not([hidden])"):
        undo.click()
    settles(page, ("red", True), ("green", False))
    page.locator("#light-controls").get_by_label("color", exact=True).fill("#000000")
    settles(page, ("red", False))


def test_time_plays_steps_and_is_chosen(page):
    assert page.inner_text("#time") == "0.00 s"
    page.get_by_label("Time in seconds").fill("2.5")
    settles(page, ("red", False))  # the ball has gone
    assert page.inner_text("#time") == "2.50 s"
    page.locator("h1").click()
    page.keyboard.press(".")
    page.wait_for_selector("#time:text-is('2.54 s')")
    page.keyboard.press("0")
    settles(page, ("red", True))
    page.keyboard.press("Space")
    page.wait_for_selector("#play:text-is('Pause')")
    page.wait_for_selector("#time:text-matches('[1-9]')")
    page.keyboard.press("Space")


def test_a_mistake_shows_with_its_line_and_the_last_good_picture_stays(page, view):
    view.save(SCENE.format(color="(0.9, 0, nothing)"))
    page.wait_for_selector("#problem:not([hidden])")
    assert "NameError at ball.py:6" in page.inner_text("#problem")
    assert "nothing" in page.inner_text("#problem .here")
    assert page.inner_text("#status").endswith(" triangles")  # those that are shown: nothing is read any more
    settles(page, ("red", True))
    view.path.unlink()
    drag(page)  # the version before goes on without its file
    page.wait_for_selector("body:not([data-stamp=''])")
    view.save(SCENE.format(color=BLUE))
    page.wait_for_selector("#problem", state="hidden")
    settles(page, ("blue", True))


def test_a_saved_file_is_read_again_and_the_camera_stays(shown, view):
    """The one before is blue, or red where this test runs alone."""
    old, new = (("blue", BLUE), ("red", RED))[:: 1 if BLUE in view.path.read_text() else -1]
    settles(shown, (old[0], True))
    drag(shown)
    turned = camera(shown)
    view.save(SCENE.format(color=new[1]))
    settles(shown, (new[0], True), (old[0], False))
    assert camera(shown) == turned


@pytest.mark.slow
def test_a_view_that_ends_or_never_had_a_picture_says_so(browser, tmp_path):
    path = tmp_path / "broken.py"
    path.write_text("def scene(time):\n    return nothing\n")
    page = new_page(browser)
    with viewed(path, "--backend", "numpy", command=("raytracer", "view")) as view:
        page.goto(view.url)
        page.wait_for_selector("#problem:not([hidden])")
        assert page.inner_text("#empty") == "There is no picture yet."
        assert page.locator("aside > section:visible").count() == 0  # nothing is known of the scene
        assert page.inner_text("#status") == ""
        view.end()
        page.wait_for_selector("text=The server has ended")
        assert page.inner_text("#problem code") == f"raytracer view {path}"
    page.close()


def test_the_code_is_copied(browser, view):
    context = browser.new_context(permissions=["clipboard-read", "clipboard-write"])
    context.set_default_timeout(PAGE)
    page = context.new_page()
    page.goto(view.url)
    page.wait_for_selector("#code:text-matches('Camera')")
    page.click("#copy-command")
    page.wait_for_selector("#copy-command:text-is('Copied')")
    assert page.evaluate("() => navigator.clipboard.readText()").startswith("raytracer ")
    context.close()


def test_nothing_sticks_out_on_a_telephone(browser, view):
    with watched(browser, view, width=360, height=740) as page:
        page.wait_for_selector("body[data-form]")
        page.wait_for_selector("#material-controls fieldset")
        assert page.evaluate("() => document.documentElement.scrollWidth") <= 360
        unnamed = page.evaluate(
            """() => [...document.querySelectorAll("input, select, button")].filter((element) =>
                !element.textContent && !element.getAttribute("aria-label") && !element.labels?.length
            ).map((e) => e.id)"""
        )
        assert unnamed == []
