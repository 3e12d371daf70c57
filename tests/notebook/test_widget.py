"""Pictures and widgets of programs in a notebook; the widget's page runs in the installed Chromium."""

import base64
import io
import json
import sys
import threading

import numpy as np
import pytest
from pages import wait_until
from patience import HANGING
from PIL import Image as pillow
from views import new_page

import shpy as sh
from shpy.display.screen import Moment, drawn, pixels
from shpy.view.kernels import Form

WANTED = Form("opencl", "strict")

gain = sh.Param(sh.Attrib1f, 0.5, name="gain", range=(0, 1), title="Gain", description="How bright it is")
tint = sh.Param(sh.Color3f, (1, 0.5, 0.25), name="tint", range=(0, 1))
on = sh.Param(sh.Attrib1b, True, name="on")
rate = sh.Param(sh.Attrib1f, 0.125, name="rate", range=(0, 1))


@sh.program
def lamp(uv: sh.TexCoord2f, time: sh.Attrib1f, mouse: sh.Attrib4f) -> sh.Color3f:
    return sh.cond(on, gain * tint, sh.Color3f(uv, sh.fract(time))) + 0.001 * mouse.x


@sh.program
def grid() -> sh.Attrib1f:
    row, column = sh.grid_index(2)
    return (row + column) / 800


@sh.program
def grow(u: sh.Attrib1f):
    return {"u": u + rate}


@sh.program
def shades(u: sh.Attrib1f) -> sh.Color3f:
    return gain * sh.Color3f(u, 0, 1)


@sh.program
def of_points(p: sh.Point3f) -> sh.Color3f:
    return sh.Color3f(p.x)


@sh.program
def turned(uv: sh.TexCoord2f) -> sh.Matrix2f:
    return sh.Matrix2f(uv, -uv)


@pytest.fixture(autouse=True)
def _params_stay():
    before = [(param, param.value) for param in (gain, tint, on, rate)]
    yield
    for param, value in before:
        param.value = value


def shown(png):
    return np.asarray(pillow.open(io.BytesIO(png)))


def test_programs_of_pixels_and_streams_of_colors_show_themselves():
    moment = Moment((384, 384))
    assert np.array_equal(shown(lamp._repr_png_()), pixels(drawn(lamp, moment)))
    assert shown(grid._repr_png_())[..., 0].max() == round(255 * 766 / 800)
    assert of_points._repr_png_() is None
    assert turned._repr_png_() is None
    colors = np.random.default_rng(1).random((5, 7, 3), np.float32)
    assert np.array_equal(shown(sh.Stream(colors, sh.Color3f)._repr_png_()), pixels(colors))
    assert sh.Stream(colors, sh.Vector3f)._repr_png_() is None
    assert sh.Stream(colors[0], sh.Color3f)._repr_png_() is None


def test_without_pillow_a_program_is_shown_by_its_text(monkeypatch):
    monkeypatch.setitem(sys.modules, "PIL", None)
    assert lamp._repr_png_() is None


def test_a_widget_answers_with_the_frame_that_is_asked_for(monkeypatch):
    widget = sh.widget(lamp, size=(np.int64(6), 4), backend="numpy")
    assert [c["name"] for c in widget.controls] == ["gain", "tint", "on"]
    assert (widget.moves, widget.extent, widget.title) == (True, [6, 4], "lamp")
    sent = []
    monkeypatch.setattr(widget, "send", lambda told, buffers=(): sent.append((told, buffers)))
    widget._answer(widget, {"time": 0.5, "params": {"gain": [0.25], "on": [False]}}, [])
    told, (frame,) = sent.pop()
    assert (gain.value, on.value) == (0.25, False)
    assert told["params"] == {"gain": [0.25], "on": [False], "tint": [1, 0.5, 0.25]}
    assert frame == pixels(drawn(lamp, Moment((6, 4), time=0.5))).tobytes()
    widget._answer(widget, {"params": {"gain": [7], "on": None}}, [])
    told, _ = sent.pop()
    assert told["error"] == "the Param gain: 7.0 is outside of its range, 0 to 1"
    assert (gain.value, on.value) == (0.25, True)  # None brings the first value back


def test_numpy_draws_until_the_driver_of_the_wanted_backend_has_compiled(monkeypatch):
    ready, asked, compiled = threading.Event(), [], lamp.compile

    def compile(target, **options):
        asked.append(target)
        if target == "opencl":
            assert ready.wait(HANGING)
        return compiled(target, **options)

    monkeypatch.setattr(lamp, "compile", compile)
    widget = sh.widget(lamp, size=(6, 4), backend="opencl", time=0.25)
    first = widget.frame()
    assert asked == ["numpy"]
    ready.set()
    wait_until(lambda: np.array_equal(widget.frame(), first) and widget._shown._kernels.best(WANTED)[1] == WANTED)
    assert asked == ["numpy", "opencl"]
    assert np.array_equal(widget.frame(), first)


def test_a_backend_that_refuses_the_program_says_so(monkeypatch):
    def compile(target, **options):
        raise sh.ShpyError(f"{target} refuses")

    monkeypatch.setattr(
        lamp, "compile", lambda target, c=lamp.compile, **o: (compile if target == "glsl" else c)(target, **o)
    )
    widget = sh.widget(lamp, size=(6, 4), backend="glsl")

    def error():
        try:
            widget.frame()
        except sh.ShpyError as refused:
            return str(refused)

    wait_until(lambda: error() is not None)
    assert error() == "glsl refuses"


def test_what_shows_no_widgets_shows_the_picture():
    widget = sh.widget(lamp, size=(6, 4), backend="numpy")
    bundle = widget._repr_mimebundle_()
    data = bundle[0] if isinstance(bundle, tuple) else bundle
    assert np.array_equal(shown(data["image/png"]), widget.frame())
    assert "application/vnd.jupyter.widget-view+json" in data


def test_a_frame_that_fails_shows_why_and_the_widget_goes_on(monkeypatch):
    @sh.program
    def endless(uv: sh.TexCoord2f) -> sh.Attrib1f:
        x = sh.Attrib1f(uv.x)
        with sh.SH_DO():
            x += 1
            sh.SH_UNTIL((x > 3) & (gain < 0.9))
        return x

    widget, sent = sh.widget(endless, size=(2, 2), backend="numpy"), []
    monkeypatch.setattr(widget, "send", lambda told, buffers=(): sent.append((told, buffers)))
    gain.value = 1
    monkeypatch.setattr(endless, "compile", lambda *a, compiled=endless.compile, **k: compiled(*a, loop_limit=9, **k))
    bundle = widget._repr_mimebundle_()
    data = bundle[0] if isinstance(bundle, tuple) else bundle
    assert "application/vnd.jupyter.widget-view+json" in data
    assert "image/png" not in data
    for value in (1, 0.5):
        widget._answer(widget, {"params": {"gain": [value]}}, [])
    assert "took more than 9 iterations" in sent[0][0]["error"]
    assert len(sent[1][1]) == 1


def test_a_chain_goes_on_with_each_frame_and_begins_anew(monkeypatch):
    widget, sent = sh.widget(sh.repeat(grow, 1), show=shades, backend="numpy", u=np.zeros((3, 4), np.float32)), []
    assert ([c["name"] for c in widget.controls], widget.extent) == (["gain", "rate"], [4, 3])
    assert (widget.moves, widget.evolves, widget.steps) == (True, True, 1)
    monkeypatch.setattr(widget, "send", lambda told, buffers=(): sent.append(buffers[0][0]))
    for asked in (
        {"frame": 0},
        {"frame": 1, "steps": 3},
        {"frame": 1, "params": {"gain": [1]}},
        {"frame": 2, "steps": 1, "params": {"rate": [0.5]}},
        {"frame": 0},
    ):
        widget._answer(widget, asked, [])
    # gain * u: 0.125 after one step, 0.5 after three more, which are drawn again, 1 after a longer one, then anew.
    assert sent == [round(255 * red) for red in (0.5 * 0.125, 0.5 * 0.5, 0.5, 1.0, 0.5)]


@pytest.mark.parametrize(
    ("program", "given", "what"),
    [
        (3, {}, "3 is neither a program nor a chain"),
        (lamp, {"show": lamp}, "show= makes colours of the streams of a chain"),
        (sh.repeat(grow, 1), {"w": 1}, "w is no stream of repeat"),
        (sh.repeat(grow, 1), {"math": "fast"}, "the kernels of a chain have their own"),
        (of_points, {}, "of_points is no program of pixels"),
        (lamp, {"size": (0, 1)}, "is no width and height"),
        (lamp, {"gain": 1}, "gain is a Param of lamp, for which the widget has a control"),
        (lamp, {"backend": "cuda"}, "backend='cuda' names no backend"),
        (lamp, {"spede": 1}, "spede is neither an input nor a Param of lamp"),
    ],
)
def test_mistakes_are_named(program, given, what):
    with pytest.raises(sh.ShpyTypeError, match=what):
        sh.widget(program, **given)


def test_anywidget_is_asked_for_by_its_command(monkeypatch):
    monkeypatch.delitem(sys.modules, "shpy.notebook.canvas", raising=False)
    monkeypatch.setitem(sys.modules, "anywidget", None)
    with pytest.raises(sh.ShpyError, match=r"widgets need anywidget: .*install '?anywidget"):
        sh.widget(lamp)


HARNESS = """
(async ([script, css, traits]) => {
  const style = document.createElement("style");
  style.textContent = css;
  document.head.append(style);
  document.documentElement.style.colorScheme = "light dark";
  const heard = [];
  const model = {
    get: (name) => traits[name],
    on: (_, hear) => heard.push(hear),
    off: () => {},
    send: async (asked) => {
      const [told, frame] = JSON.parse(await window.ask(JSON.stringify(asked)));
      const buffers = frame === null ? [] : [new DataView(Uint8Array.from(atob(frame), (c) => c.charCodeAt(0)).buffer)];
      heard.forEach((hear) => hear(told, buffers));
    },
  };
  const module = await import(URL.createObjectURL(new Blob([script], { type: "text/javascript" })));
  module.default.render({ model, el: document.body });
})
"""


def open_page(browser, widget, **options):
    """Return a page that shows the widget; the widget runs in this process."""

    def ask(asked):
        sent = []
        widget.send = lambda told, buffers=(): sent.append((told, buffers))
        widget._answer(widget, json.loads(asked), [])
        told, buffers = sent[0]
        return json.dumps([told, base64.b64encode(buffers[0]).decode() if buffers else None])

    page = new_page(browser, **options)
    page.expose_function("ask", ask)
    traits = {name: getattr(widget, name) for name in ("title", "extent", "controls", "moves", "evolves", "steps")}
    page.evaluate(HARNESS, [widget._esm, widget._css, traits])
    page.wait_for_function("document.querySelector('canvas').dataset.frame !== undefined")
    return page


COLOR = "[...document.querySelector('canvas').getContext('2d').getImageData(3, 2, 1, 1).data]"


def test_a_slider_changes_the_picture(browser):
    widget = sh.widget(lamp, size=(96, 64), backend="numpy")
    page = open_page(browser, widget, viewport={"width": 700, "height": 420}, reduced_motion="reduce")
    assert page.evaluate(COLOR) == [128, 64, 32, 255]
    page.get_by_label("Gain", exact=True).fill("1")
    page.wait_for_function(f"{COLOR}[0] === 255")
    assert gain.value == 1
    page.get_by_label("tint", exact=True).fill("#00ff00")
    page.wait_for_function(f"{COLOR}.join() === '0,255,0,255'")
    page.get_by_label("Gain: back to the value in the file").click()
    page.wait_for_function(f"{COLOR}.join() === '0,128,0,255'")
    assert gain.value == 0.5
    page.get_by_role("switch").click()
    page.wait_for_function(f"{COLOR}[2] === 0")
    gain.value = 0.75  # in another cell: the slider follows
    on.value = True
    page.get_by_role("button", name="Reset").click()
    page.wait_for_function("document.querySelector('[aria-label=\"Gain, number\"]').value === '0.75'")
    page.close()


def test_a_chain_runs_on_in_the_page_and_is_reset(browser):
    widget = sh.widget(sh.repeat(grow, 1), show=shades, steps=2, backend="numpy", u=np.zeros((8, 8), np.float32))
    gain.value, rate.value = 1, 1 / 255
    page = open_page(browser, widget, reduced_motion="reduce")
    assert page.evaluate(COLOR) == [2, 0, 255, 255]
    page.get_by_label("Steps a frame").fill("5")
    page.get_by_role("button", name="Play").click()
    page.wait_for_function(f"{COLOR}[0] > 12")
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Reset").click()
    page.wait_for_function(f"{COLOR}[0] === 5")
    page.close()


def test_time_goes_on_while_it_plays(browser):
    on.value = False
    page = open_page(browser, sh.widget(lamp, size=(8, 8), backend="numpy"))
    page.wait_for_function("Number(document.querySelector('canvas').dataset.frame) > 2")
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Play").wait_for()
    page.wait_for_timeout(100)
    held = page.evaluate("document.querySelector('canvas').dataset.frame")
    page.wait_for_timeout(150)
    assert page.evaluate("document.querySelector('canvas').dataset.frame") == held
    page.close()


def test_a_widget_without_a_backend_has_the_users_default(monkeypatch):
    monkeypatch.setenv("SHPY_BACKEND", "auto")
    widget = sh.widget(grid, size=(400, 400))
    expected = pixels(drawn(grid, Moment((400, 400)), backend="numpy"))
    wait_until(lambda: widget._shown._kernels.best(Form("auto", "strict"))[1].backend == "auto")
    for _ in range(3):
        assert np.array_equal(widget.frame(), expected)
