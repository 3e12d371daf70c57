"""Questions about the frame that a page shows: its trace, its odd pixels, its file, and the texts that repeat it."""

import io
import shlex

import numpy as np
import pytest
from pages import wait_until
from pictured_chains import CHAINS, HEAD
from PIL import Image as pillow

import shpy as sh
from shpy.cli import main
from shpy.display.screen import pixels
from shpy.view import hub, oddities, wire
from shpy.view.questions import _kept
from shpy.view.session import Session

READING = """
import shpy as sh

gain = sh.Param(sh.Attrib1f, 0.5, range=(0, 1))
tint = sh.Param(sh.Color3f, (1, 0.5, 0.25))
on = sh.Param(sh.Attrib1b, False)
count = sh.Param(sh.Attrib1i, 3, range=(0, 9))


@sh.program
def other(uv: sh.TexCoord2f) -> sh.Attrib1f:
    return uv.x


@sh.program
def picture(uv: sh.TexCoord2f, time: sh.Attrib1f, frame: sh.Attrib1i, mouse: sh.Attrib4f) -> sh.Color3f:
    level = gain * uv.x + sh.fract(time) + 0.001 * sh.Attrib1f(frame)
    color = tint * level + 0.01 * sh.Color3f(mouse.xy, mouse.z)
    return sh.cond(on, color, color + 0.1 * sh.Attrib1f(count))
"""
ODD = """
import shpy as sh


@sh.program
def picture(pixel: sh.Attrib2i) -> sh.Color3f:
    x = sh.Attrib1f(pixel.x)
    total = sh.Attrib1f(0)
    with sh.SH_FOR(0, 900) as k:
        total += 0.001 * sh.Attrib1f(k)
    far = 1 / (x - x)
    total += 1 / far
    root = sh.sqrt(x - 2)
    inverse = 1 / (x - 5)
    with sh.SH_FOR(0, 900) as k:
        total += 0.001 * sh.Attrib1f(k)
    return sh.Color3f(root, inverse, total)
"""


def opened(tmp_path, text, size=(8, 6), program=None, name="shader.py"):
    path = tmp_path / name
    path.write_text(text)
    request = {"path": str(path), "given": str(path), "program": program}
    found = Session(request, lambda: None, lambda header: None)
    found.set({"backend": "numpy", "size": list(size)})
    return found


def frame_of(session):
    """Return the next frame's header and pixels, waiting for kernels, with its number."""

    def drawn():
        session.woken()
        return session.next()

    header, shown = wait_until(drawn)
    return {**header, "number": session._number}, shown


def test_a_trace_is_of_the_frame_that_is_shown(tmp_path):
    session = opened(tmp_path, READING)
    frames = []
    for number, mouse in enumerate([(1, 2, 3, 4), (5, 6, 7, 8), (2, 2, -2, -2)]):
        session.set({"mouse": list(mouse), "params": {"gain": [0.25 * number], "on": [number == 1]}})
        frames.append((frame_of(session)[0], np.array(session.sent[session._number].output)))
    for header, output in frames:
        question = {"about": "trace", "at": [2, 5], "number": header["number"]}
        found, _ = session.answer(question)
        assert (found["frame"], found["time"]) == (header["frame"], header["time"])
        assert np.array_equal(found["steps"][-1]["value"], output[2, 5])
        value, _ = session.answer({**question, "about": "value"})
        assert np.array_equal(value["value"], output[2, 5])
    assert session.controls.values()["gain"] == [0.5]  # the last one stays


def test_a_frame_that_has_gone_is_said(tmp_path):
    session = opened(tmp_path, READING)
    for _ in range(6):
        header, _ = frame_of(session)
    assert header["number"] == 6
    gone, _ = session.answer({"about": "trace", "at": [0, 0], "number": 1})
    assert gone["problem"] == "that frame has gone; pause the view first"


def test_the_trace_of_a_coarse_frame_is_of_its_own_pixel(tmp_path):
    session = opened(tmp_path, READING, size=(400, 300))
    header, _ = frame_of(session)
    assert header["coarse"]
    found, _ = session.answer({"about": "trace", "at": [150, 399], "number": header["number"]})
    assert found["coarse"]
    assert np.array_equal(found["steps"][-1]["value"], session.sent[header["number"]].output[36, -1])


def test_a_chains_trace_goes_through_its_step_and_what_shows_it(tmp_path):
    session = opened(tmp_path, HEAD + CHAINS["written_before_read"])
    for _ in range(3):
        header, _ = frame_of(session)
    found, _ = session.answer({"about": "trace", "at": [1, 2], "number": header["number"]})
    assert found["program"] == "back, show"
    assert np.array_equal(found["steps"][-1]["value"], session.sent[header["number"]].output[1, 2])
    session.set({"playing": False})
    session.reset()
    frame_of(session)


def test_the_first_odd_pixel_is_traced_to_the_step_that_made_it(tmp_path):
    """An infinity before it, which comes to 0, is not the cause."""
    session = opened(tmp_path, ODD)
    header, shown = frame_of(session)
    assert header["odd"] == {"nan": 12, "infinite": 6}
    found, _ = session.answer({"about": "odd", "number": header["number"]})
    assert found["at"] == [0, 0]
    odd = found["steps"][found["odd"]]
    assert (odd["name"], odd["source"]) == ("root", "root = sh.sqrt(x - 2)")
    assert found["left_out"] > 0
    session.set({"mark": True})
    marked = frame_of(session)[1]
    assert marked[3, 1].tolist() == [255, 0, 200, 255]
    assert marked[3, 5].tolist() == [0, 230, 255, 255]
    assert marked[3, 4].tolist() == [*(shown[3, 4, :3] // 4).tolist(), 255]
    clean = opened(tmp_path, READING)
    assert frame_of(clean)[0]["odd"] == {"nan": 0, "infinite": 0}
    assert clean.answer({"about": "odd"})[0]["problem"] == "all pixels of this frame are finite"


@pytest.mark.parametrize("count", [1, 399, 400, 401, 1000])
def test_an_odd_step_is_among_those_that_are_sent(count):
    for odd in (None, 0, count // 3, count // 2, count - 1):
        kept, cut = _kept(count, odd)
        assert len(kept) == min(count, 400)
        assert kept == sorted(set(kept))
        assert 0 <= kept[0] <= kept[-1] < count
        assert odd is None or odd in kept
        assert 0 <= cut <= count


def test_marks_cover_neighbours_of_large_pictures_and_numbers_of_any_kind_are_counted():
    output = np.zeros((600, 800), np.float32)
    output[300, 400] = np.nan
    output[0, 0] = -np.inf
    assert oddities.counts(output) == {"nan": 1, "infinite": 1}
    assert oddities.first(output) == (0, 0)
    marked = oddities.marked(pixels(output), output)
    assert (marked == (255, 0, 200, 255)).all(axis=-1).sum() == 49
    assert (marked == (0, 230, 255, 255)).all(axis=-1).sum() == 16
    assert oddities.counts(np.ones((2, 2, 3), np.int32)) == {"nan": 0, "infinite": 0}


def drawn_again(session, tmp_path, monkeypatch, header):
    """Return the pictures of the command and of the code for a frame, and the note."""
    texts, _ = session.answer({"about": "recipe", "number": header["number"]})
    monkeypatch.chdir(tmp_path)
    assert main([*shlex.split(texts["command"])[1:], "-o", "again.png"]) == 0
    return np.asarray(pillow.open("again.png")), eval(texts["code"], {"sh": sh}), texts["note"]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("program", [None, "other"])
@pytest.mark.parametrize("backend", ["numpy", "opencl"])
def test_the_command_and_the_code_give_the_picture(tmp_path, monkeypatch, program, backend):
    session = opened(tmp_path, READING, size=(300, 20), program=program)
    moved = {"gain": [0.3], "tint": [0.1, 0.2, 1.0], "on": [True], "count": [7]} if program is None else {}
    session.set({"mouse": [3.5, 1.25, -2, -7.125], "params": moved, "encode": True, "time": 1.1, "frame": 17})
    session.set({"backend": backend, "math": "portable fused" if program else "portable"})
    header = {"coarse": True, "waiting": True}
    while header["coarse"] or header["waiting"]:
        header, shown = frame_of(session)
    command, code, note = drawn_again(session, tmp_path, monkeypatch, header)
    assert np.array_equal(command, shown)
    assert np.array_equal(code, shown)
    assert note == ""
    file = session.answer({"about": "picture", "number": header["number"]})[1]
    assert np.array_equal(np.asarray(pillow.open(io.BytesIO(file))), shown)


@pytest.mark.parametrize("name", CHAINS)
def test_the_command_and_the_code_give_the_picture_of_a_chain(tmp_path, monkeypatch, capsys, name):
    session = opened(tmp_path, HEAD + CHAINS[name], name=f"{name}.py")
    session.set({"steps": 2, "mouse": [1, 2, 3, 4]})
    for _ in range(3):
        header, shown = frame_of(session)
    command, code, note = drawn_again(session, tmp_path, monkeypatch, header)
    reads_time = name == "time_and_mouse"
    assert note == ("The chain reads the time, which is 0 in each step of the texts." if reads_time else "")
    if not reads_time:
        assert np.array_equal(command, shown)
        assert np.array_equal(code, shown)


def test_what_changed_on_the_way_of_a_chain_is_said(tmp_path):
    session = opened(tmp_path, HEAD + CHAINS["numbers_and_a_param"])
    for gain, frames in ((0.5, 2), (0.75, 4)):
        session.set({"params": {"gain": [gain]}})
        while (header := frame_of(session)[0])["frame"] < frames:
            pass
    note = session.answer({"about": "recipe", "number": header["number"]})[0]["note"]
    assert "changed on the way" in note
    session.reset()
    header, _ = frame_of(session)
    assert session.answer({"about": "recipe", "number": header["number"]})[0]["note"] == ""


def test_the_emitted_text_is_given(tmp_path):
    session = opened(tmp_path, HEAD + CHAINS["written_before_read"])
    header, _ = frame_of(session)
    texts = session.answer({"about": "text", "number": header["number"]})[0]["texts"]
    assert [each["name"] for each in texts] == ["near", "back", "show"]
    assert all("def " in each["text"] for each in texts)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["missing.py"], "there is no file missing.py"),
        (["shader.py", "--set", "no=1"], "there is no Param no"),
        (["shader.py", "--set", "gain=7"], "outside of its range, 0 to 1"),
        (["shader.py:nothing"], "has no program or chain 'nothing'"),
        (["shader.py", "-o", "no/where.png"], "there is no folder no"),
    ],
)
def test_mistakes_of_draw_are_named(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "shader.py").write_text(READING)
    assert main(["draw", *words]) == 2
    assert said in capsys.readouterr().err


class Page:
    number = 7

    def __init__(self):
        self.told = []

    def send(self, message):
        self.told.append(wire.unpack(message)[0])


def test_a_question_about_the_version_before_is_answered_by_the_server(tmp_path, monkeypatch):
    monkeypatch.setattr(hub, "Pool", lambda module, heard: None)
    (tmp_path / "shader.py").write_text("")
    found = hub.Hub("shpy.view.session", {"path": str(tmp_path / "shader.py")}, {})
    page = Page()
    found.join(page)
    found._ask({"do": "ask", "about": "trace", "at": [1, 2], "worker": 3, "number": 4, "page": 7})
    assert page.told[-1]["problem"] == "the file was recorded again; ask once more"
