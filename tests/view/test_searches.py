"""The search for the first diverging statement: it ends where nobody waits for it, and the hub says so to workers."""

import asyncio
import threading

import numpy as np
import pytest
from pages import wait_until
from patience import HANGING

import shpy as sh
from shpy.display.screen import Moment, run_at
from shpy.testing import observers
from shpy.view import hub
from shpy.view.kernels import Form
from shpy.view.searches import Searches

MOMENT = Moment((64, 2), 0.0, 0, (0.0, 0.0, 0.0, 0.0))
FORMS = Form("numpy", "strict"), Form("numpy", "fast")


@sh.program
def grown(uv: sh.TexCoord2f) -> sh.Attrib1f:
    return sh.exp(3 * uv.x)


@pytest.fixture(scope="module")
def elements():
    """Return two elements at which the modes differ."""
    outputs = [np.asarray(run_at(grown.compile("numpy", math=form.math), grown.inputs, MOMENT)) for form in FORMS]
    return [int(n) for n in np.flatnonzero(outputs[0] != outputs[1])[:2]]


@pytest.fixture
def runs(monkeypatch):
    """Hold the second run of an observer until `go_on` is set; `count` has the runs that began."""

    class Runs:
        count, held, go_on = 0, threading.Event(), threading.Event()

    original = observers.BackendObserver._run

    def run(observer, target):
        found = original(observer, target)
        Runs.count += 1
        if Runs.count == 2:
            Runs.held.set()
            assert Runs.go_on.wait(HANGING)
        return found

    monkeypatch.setattr(observers.BackendObserver, "_run", run)
    yield Runs
    Runs.go_on.set()


def others():
    return set(threading.enumerate()) - {threading.current_thread()}


def test_a_search_finds_the_statement(elements):
    told = []
    Searches(told.append).begin(7, grown, MOMENT, FORMS, elements[0])
    wait_until(lambda: told)
    (answer,) = told
    assert (answer["about"], answer["page"]) == ("divergence", 7)
    assert "exp(" in answer["divergence"]


@pytest.mark.parametrize("page", [7, None])
def test_a_cancelled_search_makes_no_further_run_and_tells_nothing(runs, elements, page):
    told, before = [], others()
    searches = Searches(told.append)
    searches.begin(7, grown, MOMENT, FORMS, elements[0])
    assert runs.held.wait(HANGING)
    searches.cancel(8)  # of another page
    searches.cancel(page)
    runs.go_on.set()
    wait_until(lambda: others() <= before)
    assert (runs.count, told) == (2, [])


def test_a_search_takes_the_place_of_the_pages_search_before(runs, elements):
    told, before = [], others()
    searches = Searches(told.append)
    searches.begin(7, grown, MOMENT, FORMS, elements[0])
    assert runs.held.wait(HANGING)
    searches.begin(7, grown, MOMENT, FORMS, elements[1])
    runs.go_on.set()
    wait_until(lambda: others() <= before)
    assert [answer["divergence"].split("element ")[1].split("\n")[0] for answer in told] == [f"0, {elements[1]}"]


class Worker:
    """A worker that notes the messages to it."""

    number, status, asked = 1, None, None

    def __init__(self):
        self.sent = []

    def send(self, message):
        self.sent.append(message)

    def pause(self):
        pass

    def resume(self):
        pass


class Pool:
    """A pool of workers that never start."""

    def __init__(self, module, heard):
        pass

    async def take(self):
        return Worker()


class Page:
    number = 7

    def send(self, message):
        pass


@pytest.mark.parametrize("what", ["button", "closed", "saved"])
def test_the_worker_that_draws_is_told_to_cancel(monkeypatch, tmp_path, what):
    monkeypatch.setattr(hub, "Pool", Pool)
    path = tmp_path / "shader.py"
    path.write_text("")
    found = hub.Hub("shpy.view.session", {"path": str(path)}, {"params": {}})
    found._drawing, page = Worker(), Page()
    found.join(page)
    if what == "button":
        asyncio.run(found.told(page, {"do": "cancel"}))
    elif what == "closed":
        found.leave(page)
    else:
        asyncio.run(found.record())
    assert found._drawing.sent == [{"do": "cancel", "page": None if what == "saved" else 7}]
