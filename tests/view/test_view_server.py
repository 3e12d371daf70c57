"""The server of a view: who may ask, what is served, how frames flow, and how it ends."""

import http.client
import json
import os
import signal
import struct
import threading
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from pages import wait_until
from patience import HANGING
from views import as_at_first, viewed
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from shpy.view import hub, reading, wire
from shpy.view.messages import LONGEST, Refused, checked
from shpy.view.server import _signals_kept, allowed_host

MOVING = """
import shpy as sh

gain = sh.Param(sh.Attrib1f, 0.5, range=(0, 1))

@sh.program
def wave(uv: sh.TexCoord2f, time: sh.Attrib1f) -> sh.Color3f:
    return sh.Color3f(uv, gain * sh.fract(time))
"""


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "wave.py"
    path.write_text(MOVING)
    with viewed(path, "--backend", "numpy", "--size", "40x30") as found:
        yield found


@pytest.fixture
def view(served):
    """Return the view in the state that it began in."""
    as_at_first(served, "gain")
    return served


def get(view, path, host=None):
    connection = http.client.HTTPConnection("127.0.0.1", view.port, timeout=HANGING)
    connection.putrequest("GET", path, skip_host=True)
    connection.putheader("Host", host or f"127.0.0.1:{view.port}")
    connection.endheaders()
    answer = connection.getresponse()
    return answer.status, dict(answer.getheaders()), answer.read()


@contextmanager
def page(view, **options):
    settings = {"origin": f"http://127.0.0.1:{view.port}", "max_size": None, **options}
    with connect(f"ws://127.0.0.1:{view.port}/view", **settings) as socket:
        yield socket


def told(socket, kind):
    """Return the next message of a kind, if it is among the next 20,000; acknowledge the frames before it."""
    for _ in range(20_000):
        header, rest = wire.unpack(socket.recv(timeout=HANGING))
        if header["kind"] == kind:
            return header, rest
        if header["kind"] == "frame":
            acknowledge(socket, header)
    raise AssertionError(f"no {kind} is sent")


def kinds(socket, timeout):
    """Yield the kinds of messages until the connection ends, or none comes for some seconds."""
    while True:
        yield wire.unpack(socket.recv(timeout=timeout))[0]["kind"]


def send(socket, **message):
    socket.send(json.dumps(message))


def acknowledge(socket, frame):
    send(socket, do="acknowledge", worker=frame["worker"], number=frame["number"])


def test_the_page_and_its_files_are_served_and_nothing_else(view):
    status, headers, body = get(view, "/")
    assert (status, headers["content-type"]) == (200, "text/html; charset=utf-8")
    assert "default-src 'self'" in headers["content-security-policy"]
    assert b"http://" not in body.replace(b"http://www.w3.org", b"")
    assert get(view, "/page.css")[0] == get(view, "/shader.js")[0] == 200
    for path in (
        "/wave.py",
        "/../server.py",
        "/%2e%2e/server.py",
        "//etc/passwd",
        "/page.css/..",
        "/view/../server.py",
    ):
        assert get(view, path)[0] == 404, path


@pytest.mark.parametrize("host", ["example.com", "127.0.0.1.example.com:80", "192.168.0.7:80", "", "localhost.evil"])
def test_a_foreign_host_is_refused(view, host):
    assert get(view, "/", host or " ")[0] == 421


def test_a_forwarded_port_may_have_another_number(view):
    assert get(view, "/", "localhost:9999")[0] == 200


@pytest.mark.parametrize("origin", ["http://example.com", None, "null", "http://127.0.0.1:1", "http://localhost"])
def test_a_page_of_another_origin_is_refused(view, origin):
    with pytest.raises(InvalidStatus) as refused, page(view, origin=origin):
        pass
    assert refused.value.response.status_code == 403


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "message",
    [
        "no JSON",
        "[1]",
        '{"do": "open", "request": {"path": "/etc/passwd"}}',
        '{"do": "set", "changes": {"size": [100000, 100000]}}',
        '{"do": "set", "changes": {"params": {"gain": [NaN]}}}',
        '{"do": "set"}',
        b"bytes",
        '{"do": "set", "changes": {"params": {"gain": ["' + LONGEST * "x" + '"]}}}',
    ],
    ids=range(8),
)
def test_a_message_that_no_page_sends_ends_its_connection_alone(view, message):
    with page(view) as other, page(view) as socket:
        socket.send(message)
        with pytest.raises(ConnectionClosed) as closed:
            list(kinds(socket, HANGING))
        assert closed.value.rcvd.code in (1008, 1009)
        acknowledge(other, told(other, "frame")[0])


def test_a_slow_page_gets_the_latest_frame_and_no_queue(view):
    with page(view) as fast, page(view) as slow:
        first, _ = told(slow, "frame")
        numbers = []
        while len(numbers) < 8:
            frame, rest = told(fast, "frame")
            assert len(rest) == 40 * 30 * 4
            numbers.append(frame["number"])
            acknowledge(fast, frame)
        assert numbers == sorted(set(numbers))
        acknowledge(slow, first)
        assert told(slow, "frame")[0]["number"] >= numbers[-2]
        later = kinds(slow, 0.3)  # the next frame waits for this one's acknowledgement
        with pytest.raises(TimeoutError):
            next(kind for kind in later if kind == "frame")


def test_ten_pages_show_one_view(view):
    with ExitStack() as stack:
        pages = [stack.enter_context(page(view)) for _ in range(10)]
        for _ in range(3):
            for socket in pages:
                acknowledge(socket, told(socket, "frame")[0])


def test_a_page_that_breaks_off_stops_nobody(view):
    with page(view) as socket:
        told(socket, "frame")
        socket.socket.setsockopt(1, 13, struct.pack("ii", 1, 0))  # SO_LINGER: the connection is reset
        socket.socket.close()
    with page(view) as socket:
        acknowledge(socket, told(socket, "frame")[0])
        told(socket, "frame")


def test_what_one_page_changes_the_others_show(view):
    with page(view) as one, page(view) as two:
        told(two, "recorded")
        send(one, do="set", changes={"params": {"gain": [0.25]}, "time": 0.5, "playing": False})
        assert told(two, "state")[0]["changes"]["params"] == {"gain": [0.25]}
        while True:
            frame, rest = told(two, "frame")
            acknowledge(two, frame)
            if frame["time"] == 0.5:
                break
        assert rest[2] == round(255 * 0.25 * 0.5)


def test_a_value_that_a_param_refuses_is_said(view):
    with page(view) as socket:
        told(socket, "recorded")
        send(socket, do="set", changes={"params": {"gain": [7]}})
        assert "outside of its range, 0 to 1" in told(socket, "remark")[0]["text"]


def listeners(port):
    """Return the addresses on which somebody listens at a port."""
    found = set()
    for name in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]:
            local, state = line.split()[1], line.split()[3]
            if state == "0A" and int(local.split(":")[1], 16) == port:
                found.add(local.split(":")[0])
    return found


def test_nothing_listens_beyond_loopback(view):
    assert listeners(view.port) == {"0100007F"}


def children(process):
    return [int(pid) for pid in Path(f"/proc/{process}/task/{process}/children").read_text().split()]


def test_an_address_beyond_loopback_is_warned_of_and_control_c_ends_the_workers_of_a_file_that_loops_forever(tmp_path):
    path = tmp_path / "endless.py"
    path.write_text("while True: pass")
    with viewed(path, "--listen", "0.0.0.0", address="0.0.0.0") as found, page(found) as socket:
        assert "warning: everybody who reaches this machine" in found.process.stdout.readline()
        assert get(found, "/", "192.168.0.7:8000")[0] == 200
        assert get(found, "/", "example.com")[0] == 421
        told(socket, "busy")
        workers = children(found.process.pid)
        assert len(workers) == 2
        assert found.end() == (130, "shpy: stopped\n")
        wait_until(lambda: not any(os.path.exists(f"/proc/{pid}") for pid in workers))


def state_of(process):
    """Return the letter of a process's state, T where it is stopped; None where it has ended."""
    try:
        found = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return None
    return None if found in "ZX" else found


def waiting(folder):
    """Return lines that wait for a file `go`."""
    return f"import os, time\nwhile not os.path.exists({str(folder / 'go')!r}): time.sleep(0.01)\n"


@contextmanager
def paused(tmp_path):
    """Yield a view whose file waits for a file `go` before it fails, its page, and the paused process that draws."""
    path = tmp_path / "wave.py"
    path.write_text(MOVING)
    with viewed(path, "--backend", "numpy", "--size", "4x3") as found, page(found) as socket:
        acknowledge(socket, told(socket, "frame")[0])
        wait_until(lambda: len(children(found.process.pid)) == 2)  # the next one warms up a second later
        drawing = min(children(found.process.pid))
        path.write_text(waiting(tmp_path) + "0 / 0")
        wait_until(lambda: state_of(drawing) == "T")
        yield found, socket, drawing


def test_the_process_that_draws_pauses_while_another_one_records_and_is_replaced(tmp_path):
    with paused(tmp_path) as (found, socket, drawing):
        (tmp_path / "go").touch()
        assert told(socket, "error")[0]["type"] == "ZeroDivisionError"
        wait_until(lambda: state_of(drawing) != "T")
        told(socket, "frame")
        (tmp_path / "go").unlink()
        found.path.write_text(waiting(tmp_path) + MOVING)
        wait_until(lambda: state_of(drawing) == "T")
        send(socket, do="ask", about="trace", at=[1, 1], worker=1, number=1)
        (tmp_path / "go").touch()
        answer = told(socket, "answer")[0]
        # On a busy machine the recording may take a second: then the process goes on, and has drawn more.
        problems = "the file was recorded again; ask once more", "that frame has gone; pause the view first"
        assert answer["about"] == "trace"
        assert answer["problem"] in problems
        wait_until(lambda: state_of(drawing) is None)


@pytest.mark.slow
def test_the_process_that_draws_goes_on_while_another_one_records_for_long(tmp_path):
    with paused(tmp_path) as (_, socket, drawing):
        assert any(told(socket, "busy")[0].get("stage") == "recording" for _ in range(20))
        wait_until(lambda: state_of(drawing) != "T")
        told(socket, "frame")


@pytest.mark.slow
def test_a_paused_process_ends_with_a_server_that_is_killed(tmp_path):
    with paused(tmp_path) as (found, _, drawing):
        found.process.kill()
        wait_until(lambda: state_of(drawing) is None)


@pytest.mark.slow
def test_control_c_ends_it_in_the_moment_when_it_starts(tmp_path):
    path = tmp_path / "wave.py"
    path.write_text(MOVING)
    for _ in range(3):
        with viewed(path) as found:
            assert found.end() == (130, "shpy: stopped\n")


def test_what_a_file_reads_is_watched_and_an_edit_of_a_function_changes_its_gradient(tmp_path):
    """The function stands in a file beside that of the program, which shows its slope, then its distance by a rule."""
    rule = "@sh.subroutine\ndef height(p: sh.Attrib2f) -> sh.Attrib1f:\n    return p.x\n\n@height.tangent\n"
    rule += "def height_tangent(y, p, d_p):\n    return 0.6 * d_p.x + d_p.y\n"
    (tmp_path / "shape.py").write_text("import shpy as sh\n\ndef height(p):\n    return 0.2 * p.x + p.y * p.y\n")
    (tmp_path / "palette.py").write_text("level = 0.25")
    (tmp_path / "levels.txt").write_text("0.5")
    read = "from pathlib import Path\nfrom palette import level\nfrom shape import height\n"
    read += "other = float(Path(__file__).with_name('levels.txt').read_text())\n"
    color = "sh.Color3f(sh.gradient(height)(sh.Attrib2f(uv)), level + other)"
    path = tmp_path / "wave.py"
    path.write_text(read + MOVING.replace("sh.Color3f(uv, gain * sh.fract(time))", color))
    edits = (
        ("levels.txt", "0.0", (51, 128, 64)),  # the slope by x, and by y at 0.25
        ("palette.py", "level = 1.0  # all", (51, 128, 255)),
        ("shape.py", "import shpy as sh\n\n" + rule, (153, 255, 255)),
    )
    with viewed(path, "--backend", "numpy", "--size", "4x2") as found, page(found) as socket:
        header, pixels = told(socket, "frame")
        assert tuple(pixels[:3]) == (51, 128, 191)
        for name, text, color in edits:
            acknowledge(socket, header)
            (tmp_path / name).write_text(text)
            told(socket, "recorded")
            header, pixels = told(socket, "frame")
            assert tuple(pixels[:3]) == color


@pytest.mark.slow
def test_files_outside_the_folder_and_missing_ones_are_watched(tmp_path):
    folder = tmp_path / "real"
    folder.mkdir()
    path = folder / "wave.py"
    read = "import sys\nfrom pathlib import Path\nfrom palette import level\n"
    read += "other = float((Path(__file__).parent.parent / 'levels.txt').read_text())\n"
    path.write_text(read + MOVING.replace("gain * sh.fract(time)", "level + other"))
    with viewed(path, "--backend", "numpy", "--size", "4x3") as found, page(found) as socket:
        assert "No module named 'palette'" in told(socket, "error")[0]["message"]
        (folder / "palette.py").write_text("level = 0.25")
        assert "levels.txt" in told(socket, "error")[0]["message"]
        for text, blue in (("0.5", 191), ("0.75", 255)):
            (tmp_path / "levels.txt").write_text(text)
            told(socket, "recorded")
            header, pixels = told(socket, "frame")
            assert pixels[2] == blue
            acknowledge(socket, header)


def test_the_file_of_a_view_is_the_one_that_a_link_leads_to(tmp_path, monkeypatch):
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "wave.py").touch()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    (tmp_path / "wave.py").symlink_to(tmp_path / "real" / "wave.py")
    monkeypatch.setattr(hub, "Pool", lambda module, heard: None)
    for path in (tmp_path / "wave.py", tmp_path / "link" / "wave.py"):
        found = hub.Hub("shpy.view.session", {"path": str(path)}, {})
        assert found.request["path"] == str(tmp_path / "real" / "wave.py")


@pytest.mark.parametrize("place", [reading.__file__, np.__file__, os.__file__, "/usr/share/driver.txt"])
def test_files_of_packages_and_of_the_system_are_not_watched(tmp_path, place):
    with reading.noted(tmp_path / "wave.py"), suppress(FileNotFoundError):
        open(place).close()
    assert reading.files_read() == (tmp_path / "wave.py",)


def test_a_file_that_another_thread_opens_while_the_noting_ends_is_opened(tmp_path, monkeypatch):
    (tmp_path / "levels.txt").write_text("0.5")

    def ended(file):
        reading._folder = None
        return file

    with reading.noted(tmp_path / "wave.py"):
        monkeypatch.setattr(reading.os.path, "abspath", ended)
        with open(str(tmp_path / "levels.txt")) as file:
            assert file.read() == "0.5"
        monkeypatch.undo()
    assert tmp_path / "levels.txt" in reading.files_read()


def test_signals_stay_as_they_are_in_a_thread_that_gets_none():
    before = signal.getsignal(signal.SIGINT)
    kept = []

    def enter():
        with _signals_kept(None):
            kept.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert kept == [before]


def test_control_c_ends_the_view_of_a_scene_with_one_word():
    with viewed("boxes", command=("raytracer", "view")) as found:
        assert get(found, "/")[0] == 200
        assert found.end() == (130, "raytracer: stopped\n")


def test_a_warm_process_that_ended_is_said_and_the_next_one_draws(view):
    with page(view) as socket:
        told(socket, "frame")
        wait_until(lambda: len(children(view.process.pid)) == 2)  # the next one warms up a second later
        for pid in children(view.process.pid):
            os.kill(pid, signal.SIGKILL)
        assert "ended by signal 9" in told(socket, "error")[0]["message"]
        send(socket, do="record")
        assert "ended by signal 9" in told(socket, "error")[0]["message"]
        send(socket, do="record")
        assert told(socket, "recorded")[0]["program"] == "wave"


MALFORMED = "[::1 a]b [ ] [] 127.0.0.1:99999 127.0.0.1:x [::1]: user@127.0.0.1 127.0.0.1/x ::1 127.0.0.1: \xb2 [v1.a]"
MALFORMED = (MALFORMED + " [::1%25lo] 127.0.0.1# 127.0.0.1?x http://127.0.0.1 \\").split()


@pytest.mark.parametrize("host", MALFORMED)
def test_a_malformed_host_is_refused_and_no_error(view, host):
    host = host.encode("latin-1").decode("latin-1")
    status = get(view, "/", host)[0]
    assert status == (200 if host in ("127.0.0.1:", "[::1]:") else 421)


@pytest.mark.parametrize("origin", ["http://[::1", "http://a]b", "[", "http://127.0.0.1:x", "//", "http://\xb2", "\\"])
def test_a_malformed_origin_is_refused_and_no_error(view, origin):
    with pytest.raises(InvalidStatus) as refused, page(view, origin=origin):
        pass
    assert refused.value.response.status_code == 403


def test_hosts_that_are_no_text_of_a_host_are_refused():
    letters = "[]:@/?#%\\ .-_1aZ\xb2\u2100"
    rng = np.random.default_rng(11)
    for _ in range(5000):
        host = "".join(rng.choice(list(letters), rng.integers(0, 12)))
        for beyond in (False, True):
            assert allowed_host(host, beyond=beyond) in (False, True)


def test_hosts_beyond_loopback_are_numbers_alone():
    assert all(allowed_host(host, beyond=True) for host in ("10.0.0.1:80", "[::1]:80", "localhost"))
    assert not any(allowed_host(host, beyond=True) for host in ("example.com", "10.0.0.1.evil.com", ""))


def test_messages_are_listed():
    assert checked('{"do": "set", "changes": {"params": {"a": [1, true]}}}')["do"] == "set"
    for text in (
        '{"do": "ask", "about": "value", "at": [-1, 0]}',
        '{"do": "step", "n": 1}',
        '{"do": "pick"}',
        "{" * 9999,
        '{"do": "set", "changes": {"time": 1e999}}',
        '{"do": "set", "changes": {"time": 1%s}}' % ("0" * 400),
    ):
        with pytest.raises(Refused):
            checked(text)
