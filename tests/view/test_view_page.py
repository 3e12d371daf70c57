"""The page of `shpy view` in a browser: saving, errors, controls, pixels, traces, comparisons, chains."""

import json
import re

import numpy as np
import pytest
import views
from pages import wait_until
from patience import PAGE
from PIL import Image
from views import viewed

GOOD = """
import shpy as sh

gain = sh.Param(sh.Attrib1f, {gain}, range=(0, 1), title="Gain", description="of the light")
tint = sh.Param(sh.Color3f, (1, 0.5, 0))
negative = sh.Param(sh.Attrib1b, False)

@sh.program
def picture(uv: sh.TexCoord2f) -> sh.Color3f:
    level = gain * sh.Attrib1f(0.5)
    with sh.SH_FOR(0, 3) as k:
        level += 0.01 * k
    color = level * tint
    return sh.cond(negative, 1 - color, color)
"""
EVOLVING = """
import numpy as np
import shpy as sh

@sh.program
def grow(u: sh.Attrib1f):
    return {"u": u + 1}

def start(height, width):
    return {"u": np.zeros((height, width))}

@sh.program
def show(u: sh.Attrib1f) -> sh.Attrib1f:
    return u / 255
"""


@pytest.fixture(scope="module")
def view(tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "shader.py"
    path.write_text(GOOD.format(gain=1))
    with viewed(path, "--backend", "numpy", "--size", "48x32") as found:
        yield found


@pytest.fixture(autouse=True)
def as_at_first(view):
    """Reset the page's settings after the previous test."""
    views.as_at_first(view, "gain", "tint", "negative")


@pytest.fixture
def shown(browser, view):
    """Return a page that shows the file as the previous test has left it: each version costs a process, 1.3 CPU s."""
    with views.watched(browser, view, width=1000, height=700) as page:
        page.wait_for_selector("body[data-form]")
        yield page


@pytest.fixture
def page(shown, view):
    """Return a page that shows the good file."""
    if view.path.read_text() != GOOD.format(gain=1):
        views.save(view, GOOD.format(gain=1))
    shown.wait_for_selector("[aria-label='Gain, number']")
    shows(shown, (135, 68, 0))
    return shown


def shows(page, color):
    """Wait until the picture has a colour in its middle."""
    page.evaluate(
        """(color) => new Promise((resolve, reject) => {
            const picture = document.getElementById("picture");
            let looks = 0;
            const look = () => {
                const data = picture.getContext("2d").getImageData(picture.width >> 1, picture.height >> 1, 1, 1).data;
                if (color.every((part, k) => Math.abs(part - data[k]) <= 1)) return resolve();
                if (++looks > 6000) return reject(`it shows ${data}, not ${color}`);
                requestAnimationFrame(look);
            };
            look();
        })""",
        list(color),
    )


def test_sliders_colours_and_switches_change_the_picture(page):
    slider = page.get_by_label("Gain", exact=True)
    slider.focus()
    page.keyboard.press("Home")
    shows(page, (8, 4, 0))
    page.wait_for_selector("#comparing")  # once the page knows which other backends there are
    page.keyboard.press("c")  # a slider takes arrows, and leaves the other keys to the page
    page.wait_for_selector("#difference")
    page.keyboard.press("Escape")
    assert page.input_value("[aria-label='Gain, number']") == "0"
    page.get_by_label("tint", exact=True).fill("#00ff00")
    page.get_by_label("negative", exact=True).check()
    shows(page, (255, 247, 255))
    for undo in page.query_selector_all("button.undo:not([hidden])"):
        undo.click()
    shows(page, (135, 68, 0))


def test_a_pixel_shows_its_value_and_its_trace(page):
    page.hover("#picture")
    page.wait_for_selector("#pixel b")
    assert page.inner_text("#pixel b") == "0.53, 0.265, 0"
    page.click("#picture")
    page.wait_for_selector("#panel table")
    rows = [row.inner_text().split("\t") for row in page.query_selector_all("#panel tbody tr")]
    assert ["shader.py:10", "", "level", "0.5", "level = gain * sh.Attrib1f(0.5)"] in rows
    assert [row[1:4] for row in rows if row[1] == "3" and row[2] == "level"] == [["3", "level", "0.53"]]
    page.keyboard.press("Escape")
    assert page.is_hidden("#panel")
    assert page.is_hidden("#odd")


@pytest.mark.slow
def test_a_lost_question_about_a_pixel_is_followed_by_that_about_the_next_frame(browser, view):
    """A worker that is replaced answers nothing; its successor's frame comes while the page waits for the answer."""
    lost = []

    def pass_on(route):
        server = route.connect_to_server()

        def forward(message):
            if '"about":"value"' in message and not lost:
                lost.append(message)
                server.send(json.dumps({"do": "set", "changes": {"params": {"gain": [0.5]}}}))  # another frame
            else:
                server.send(message)

        route.on_message(forward)

    page = views.new_page(browser)
    page.route_web_socket(re.compile("/view$"), pass_on)
    page.goto(view.url)
    page.wait_for_selector("[aria-label='Gain, number']")
    shows(page, (135, 68, 0))
    page.hover("#picture")
    page.wait_for_selector("#pixel b")
    assert len(lost) == 1
    page.close()


def test_the_picture_is_saved_and_its_texts_are_shown(page, view, tmp_path):
    with page.expect_download() as found:
        page.click("#save")
    assert found.value.suggested_filename == "picture.png"
    found.value.save_as(tmp_path / "saved.png")
    saved = np.asarray(Image.open(tmp_path / "saved.png"))
    assert saved.shape == (32, 48, 4)
    assert saved[16, 24].tolist() == [135, 68, 0, 255]
    page.click("#recipe")
    page.wait_for_selector("#panel pre")
    assert page.inner_text("#panel pre") == f"shpy draw {view.path} --size 48x32 --backend numpy"
    page.click("#text")
    page.wait_for_selector("#panel pre.emitted:has-text('def ')")
    page.locator("h1").click()
    page.keyboard.press("f")
    page.wait_for_function("() => document.fullscreenElement?.id === 'frame'")
    page.keyboard.press("f")
    page.wait_for_function("() => !document.fullscreenElement")


def test_the_keyboard_chooses_pixels(page):
    page.focus("#picture")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowDown")
    page.wait_for_selector("#mark:not([hidden])")
    page.keyboard.press("Enter")
    page.wait_for_selector("#panel table")
    assert "25, 26" in page.inner_text("#panel-title").lower()


def test_nothing_sticks_out_on_a_telephone_and_each_value_of_a_trace_has_a_line(browser, view):
    if view.path.read_text() != GOOD.format(gain=1):
        view.save(GOOD.format(gain=1))
    with views.watched(browser, view, width=360, height=740) as page:
        page.wait_for_selector("[aria-label='Gain, number']")
        shows(page, (135, 68, 0))  # a frame of the file before has no trace
        assert page.evaluate("() => document.documentElement.scrollWidth") <= 360
        unnamed = page.evaluate(
            """() => [...document.querySelectorAll("input, select, button")].filter((element) =>
                !element.textContent && !element.getAttribute("aria-label") && !element.labels?.length
            ).map((e) => e.id)"""
        )
        assert unnamed == []
        each_value_of_a_trace_has_a_line_of_its_own(page)


def each_value_of_a_trace_has_a_line_of_its_own(page):
    page.click("#picture")
    page.wait_for_selector("#panel table")
    heights = page.evaluate(
        """() => [...document.querySelectorAll("#panel td.value")].map((value) => [
            value.getBoundingClientRect().height, parseFloat(getComputedStyle(value).lineHeight),
            value.closest("#panel").scrollWidth - value.closest("#panel").clientWidth])"""
    )
    assert heights
    assert all(height < 1.6 * line and beyond <= 0 for height, line, beyond in heights), heights


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("wrong", "cause", "line"),
    [
        ("level = gain *", "invalid syntax", 10),
        ("level = gain if uv.x else 0", "is decided while recording", 10),
        ("level = sh.Attrib1f(1 / 0)", "division by zero", 10),
        ("level = sh.Attrib1f(gain).nothing", "nothing", 10),
    ],
)
def test_an_error_shows_with_its_line_and_the_last_good_picture_stays(page, view, wrong, cause, line):
    view.save(GOOD.format(gain=1).replace("level = gain * sh.Attrib1f(0.5)", wrong))
    page.wait_for_selector("#problem:not([hidden])")
    text = page.inner_text("#problem")
    assert cause in text
    assert f"shader.py:{line}" in text
    assert wrong in page.inner_text("#problem .here")
    shows(page, (135, 68, 0))
    page.fill("[aria-label='Gain, number']", "0.5")
    page.keyboard.press("Tab")
    shows(page, (71, 36, 0))  # the version before is still drawn, and its sliders move
    assert page.is_visible("#problem")
    view.save(GOOD.format(gain=1))
    page.wait_for_selector("#problem", state="hidden")


def test_an_endless_loop_is_said_and_stopped_and_a_process_that_dies_is_replaced(page, view):
    view.save("level = (")
    page.wait_for_selector("#problem:not([hidden])")
    view.save("while True: pass")
    page.wait_for_selector("#busy:not([hidden])")
    assert page.inner_text("#busy").startswith("Recording the new version, ")
    assert not page.is_visible("#problem")  # of the version before
    shows(page, (135, 68, 0))
    page.click("text=Stop it")
    page.wait_for_selector("#problem:not([hidden])")
    view.save("import os; os.abort()")
    page.wait_for_selector("text=ended by signal 6")
    view.save(GOOD.format(gain=0.5))
    shows(page, (71, 36, 0))
    page.wait_for_selector("#busy", state="hidden")


def test_two_forms_are_compared(shown, view):
    shown.select_option("#other-backend", "numpy")
    shown.click("#compare")
    shown.wait_for_selector("#difference")
    assert shown.inner_text("#difference") == "All 1536 pixels are the same to the bit."
    view.save(GOOD.format(gain=1).replace("level = gain", "level = sh.exp(3 * uv.x) * gain"))
    shown.wait_for_selector("body[data-full]")
    shown.select_option("#other-math", "fast")
    shown.click("#compare")
    shown.wait_for_selector(".sides canvas >> nth=2")
    shown.wait_for_selector("#divergence:has-text('part at')")
    assert "exp(" in shown.inner_text("#divergence")
    assert " part at shader.py:10," in shown.inner_text("#divergence")
    assert str(view.path.parent) not in shown.inner_text("#panel")
    shown.select_option("#other-math", "strict")


@pytest.mark.slow
def test_a_comparison_that_is_open_says_that_the_file_was_saved_since(page, view):
    page.select_option("#other-backend", "numpy")
    page.click("#compare")
    page.wait_for_selector("#difference")
    assert page.query_selector("#stale") is None
    view.save(GOOD.format(gain=0.5))
    page.wait_for_selector("#stale:has-text('of the version before')")
    shows(page, (71, 36, 0))
    page.click("#compare")
    page.wait_for_selector("#stale", state="detached")
    page.wait_for_selector("#difference")


def test_a_target_that_refuses_is_said_and_another_draws(shown, view):
    view.save(GOOD.format(gain=1).replace("return", "color[:] = sh.Attrib3f(sh.Attrib3d(color) * 1.0)\n    return"))
    shows(shown, (135, 68, 0))
    shown.select_option("#backend", "glsl")
    shown.wait_for_selector("#problem:not([hidden])")
    assert "GLSL 3.30 has no 64-bit floats" in shown.inner_text("#problem")
    assert shown.inner_text("#status") == "glsl refuses it; numpy draws in its place."
    shown.select_option("#backend", "numpy")
    shown.wait_for_selector("#problem", state="hidden")


REFUSING = """
import shpy as sh
from shpy.programs import Program

compiled = Program.compile

def refuse(program, target, **options):
    if target == "glsl":
        raise sh.CompileError(f"the GLSL driver refused the kernel: {__file__}:17: no such word")
    return compiled(program, target, **options)

Program.compile = refuse
"""


def test_what_a_driver_refuses_is_said_by_the_file_name_with_a_way_out(shown, view):
    view.save(REFUSING + GOOD.format(gain=0.5))
    shows(shown, (71, 36, 0))
    shown.select_option("#backend", "glsl")
    shown.wait_for_selector("#problem:not([hidden])")
    text = shown.inner_text("#problem")
    assert "the GLSL driver refused the kernel: shader.py:17: no such word" in text
    assert "another backend" in text
    shown.select_option("#backend", "numpy")
    shown.wait_for_selector("#problem", state="hidden")


MOUSED = """
import shpy as sh

@sh.program
def picture(uv: sh.TexCoord2f, mouse: sh.Attrib4f) -> sh.Color3f:
    root = sh.sqrt(uv.x - 0.25)
    return sh.Color3f(mouse.x / 48, 0.25, root)
"""


def test_a_click_leaves_the_mouse_alone_and_a_drag_moves_it(shown, view):
    view.save(MOUSED)
    shows(shown, (0, 64, 130))
    box = shown.locator("#picture").bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    shown.mouse.click(*middle)
    shown.wait_for_selector("#panel td:has-text('mouse')")
    assert ["mouse", "0, 0, 0, 0"] in [row[2:4] for row in rows_of(shown)]
    shown.keyboard.press("Escape")  # the panel takes room from the picture
    shown.wait_for_selector("#panel", state="hidden")
    box = shown.locator("#picture").bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    shown.mouse.move(*middle)
    shown.mouse.down()
    shown.mouse.move(middle[0] + box["width"] / 4, middle[1], steps=4)
    shows(shown, (191, 64, 130))
    shown.mouse.up()
    shown.mouse.click(*middle)
    shown.wait_for_selector("#panel td:has-text('36, ')")
    shows(shown, (191, 64, 130))
    wait_until(lambda: shown.inner_text("#pixel b").startswith("0.75, "))
    assert rows_of(shown)[-1][3] == shown.inner_text("#pixel b")  # the trace and the footer are of one frame


def rows_of(page):
    return [row.inner_text().split("\t") for row in page.query_selector_all("#panel tbody tr")]


def test_pixels_that_are_no_colours_are_counted_marked_and_traced(shown, view):
    if view.path.read_text() != MOUSED:
        view.save(MOUSED)
    shown.wait_for_selector("#odd-count:has-text('384 NaN pixels')")
    shown.click("#trace-odd")
    shown.wait_for_selector("#panel tr.odd")
    assert shown.inner_text("#panel tr.odd").split("\t")[2:4] == ["root", "nan"]
    assert "0, 0" in shown.inner_text("#panel-title")
    shown.check("#mark-odd")
    shows(shown, (0, 16, 32))  # the others are dark
    shown.uncheck("#mark-odd")
    shows(shown, (0, 64, 130))


def test_a_saved_file_is_recorded_again_and_its_picture_measured(shown, view):
    view.save(GOOD.format(gain=0.5))
    shows(shown, (71, 36, 0))
    shown.wait_for_selector("body[data-full]")
    assert 0 < int(shown.get_attribute("body", "data-first")) <= int(shown.get_attribute("body", "data-full"))
    assert "first picture after" in shown.inner_text("#status")


SLOW = (
    GOOD.replace("(0, 3)", "(0, 3000)")
    .replace("0.01", "1e-12")
    .replace("level = gain", "level = sh.exp(3 * uv.x) * gain")
)
"""A program whose first diverging statement is found after minutes."""


def search_begins(shown, view):
    """Compare the modes of a program for which the search takes long, and wait until it has begun."""
    view.save(SLOW.format(gain=1))
    shown.wait_for_selector("body[data-full]")
    shown.select_option("#other-backend", "numpy")
    shown.select_option("#other-math", "fast")
    shown.click("#compare")
    shown.wait_for_selector("#divergence.searching")
    shown.select_option("#other-math", "strict")


def test_a_search_is_cancelled_by_its_button_and_by_a_save(shown, view):
    search_begins(shown, view)
    assert "Searching for the first statement at which they diverge …" in shown.inner_text("#divergence")
    shown.click("text=Cancel the search")
    assert shown.inner_text("#divergence") == "The search was cancelled."
    assert shown.query_selector("#cancel") is None
    shown.select_option("#other-math", "fast")
    shown.click("#compare")
    shown.wait_for_selector("#divergence.searching")
    shown.select_option("#other-math", "strict")
    view.save(GOOD.format(gain=0.5))
    shown.wait_for_selector("#divergence:has-text('The search ended: the file is recorded again.')")
    shows(shown, (71, 36, 0))


@pytest.mark.slow
def test_a_search_is_cancelled_by_closing_its_panel(shown, view):
    search_begins(shown, view)
    sent = []

    def note(text):
        sent.append(text)

    shown.expose_function("sent", note)
    shown.evaluate(
        """() => {
            const send = WebSocket.prototype.send;
            WebSocket.prototype.send = function (text) { sent(text); send.call(this, text); };
        }"""
    )
    shown.keyboard.press("Escape")
    shown.wait_for_function("document.getElementById('panel').hidden")
    wait_until(lambda: '{"do":"cancel"}' in sent)


def test_a_chain_runs_on_pauses_steps_and_begins_anew(shown, view):
    view.save(EVOLVING)
    shown.wait_for_selector("#clock:not([hidden])")
    shown.wait_for_selector("#time:text-matches('frame [1-9]')")
    shown.keyboard.press("Space")
    shown.wait_for_selector("text=Play")
    shown.keyboard.press("r")
    shows(shown, (0, 0, 0))
    shown.keyboard.press(".")
    shows(shown, (1, 1, 1))
    shown.fill("#steps", "50")
    shown.keyboard.press("Enter")
    shown.locator("h1").click()
    shown.keyboard.press(".")
    shows(shown, (51, 51, 51))
    shown.fill("#steps", "1")
    shown.keyboard.press("Enter")
    shown.locator("h1").click()
    shown.keyboard.press("Space")
    shown.wait_for_selector("text=Pause")


@pytest.mark.slow
def test_tabs_show_one_view(browser, view):
    view.save(EVOLVING)
    context = browser.new_context()
    context.set_default_timeout(PAGE)
    tabs = [context.new_page() for _ in range(10)]
    for tab in tabs:
        tab.goto(view.url)
    for tab in tabs:
        tab.bring_to_front()  # the browser draws the tab in front alone, and the others take no frames
        tab.wait_for_selector("#time:text-matches('frame [1-9]')")
    context.close()


@pytest.mark.slow
def test_a_lost_connection_is_seen_wherever_a_telephone_has_scrolled(browser, tmp_path):
    path = tmp_path / "shader.py"
    path.write_text(GOOD.format(gain=1))
    page = views.new_page(browser, viewport={"width": 360, "height": 400})
    with viewed(path, "--backend", "numpy", "--size", "48x32") as ended:
        page.goto(ended.url)
        page.wait_for_selector("body[data-form]")
        page.evaluate("() => scrollTo(0, document.documentElement.scrollHeight)")
    page.wait_for_selector("#problem:has-text('The server has ended')")
    top, bottom = page.evaluate(
        """() => {
            const { top, bottom } = document.getElementById("problem").getBoundingClientRect();
            return [top, bottom];
        }"""
    )
    assert page.evaluate("() => scrollY") > 0
    assert 0 <= top < bottom <= 400
    page.close()
