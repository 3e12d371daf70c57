"""The hub: the state of a view, the worker that draws it, and the pages that show it.

Stage: view, in the server. All pages show the same view. A page that has not acknowledged its last frame gets no
other one until it has: then it gets the latest, and earlier ones are dropped. The worker continues as soon as one page
is ready.

    file changes ─► a warm worker opens it ─► its first frame ─► it replaces the previous worker, which ends
                    the previous one pauses └─► an error, or much time: the previous worker continues
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, Protocol

from shpy.view import wire
from shpy.view.workers import Pool, Worker

_POLL: Final = 0.02
"""Seconds between two checks of the files' times."""
_PING: Final = 0.5
"""Seconds between two pings of a worker."""
_SLOW: Final = 1.5
"""Seconds without an answer to a ping after which pages show that a worker is busy."""
_LONG: Final = 1.0
"""Seconds after which pages show the work for the picture that is awaited."""
_OTHER: Final = {"backend", "math", "size", "scene"}
"""The changes of the state after which another picture is awaited."""


_AGAIN: Final = "the file was recorded again; ask once more"


class Page(Protocol):
    """A connected page."""

    number: int

    def send(self, message: bytes) -> None:
        """Queue a message, without waiting."""

    def offer(self, frame: bytes) -> None:
        """Send a frame, or keep only the latest while an earlier one is not acknowledged."""

    def acknowledge(self) -> None:
        """Record that the page has drawn its last frame."""


class Hub:
    """The view of one file."""

    def __init__(self, module: str, request: dict[str, Any], state: dict[str, Any]) -> None:
        # Python resolves links to find the folder of a script, from which it imports modules.
        self.request = {**request, "path": str(Path(request["path"]).resolve())}
        self.state = state
        self.pages: dict[int, Page] = {}
        self._watched: dict[Path, tuple[int, int] | None] = {}
        self._watch_files([self.request["path"]])
        self._pool = Pool(module, self._heard)
        self._drawing: Worker | None = None
        self._recording: Worker | None = None
        self._described: bytes | None = None
        """The message in which the recording worker described its version."""
        self._recorded: bytes | None = None
        self._frame: bytes | None = None
        self._error: bytes | None = None
        self._failed: Worker | None = None
        self._pinged = time.monotonic()
        self._said_busy = False
        self._awaited: float | None = None
        """The time since which a picture is awaited: one clock for all that has to be done for it."""
        self._seen = (0, 0)

    # Files

    async def watch(self) -> None:
        """Record the file, and again whenever it, or a file that it imports, changes."""
        await self.record()
        while True:
            await asyncio.sleep(_POLL)
            if self._changed():
                await self.record()
            self._ping()

    def _changed(self) -> bool:
        """Return whether the time or size of a file has changed; a missing file counts as unchanged."""
        stamps = {path: _stamp(path) for path in self._watched}
        changed = {path: stamp for path, stamp in stamps.items() if stamp not in (None, self._watched[path])}
        self._watched.update(changed)
        return bool(changed)

    def _watch_files(self, files: Iterable[str]) -> None:
        for path in map(Path, files):
            self._watched.setdefault(path, _stamp(path))

    async def record(self) -> None:
        """Let a warm worker record the current version; the previous one draws again if that fails or takes long."""
        self._drop_recording()
        stamp = _stamp(Path(self.request["path"]))
        age = time.time() - stamp[0] / 1e9 if stamp else 0.0
        self._cancel(None)  # the new version needs the processor
        self._awaited = time.monotonic()
        self._broadcast(wire.pack({"kind": "recording", "age": max(0.0, min(age, 10.0))}))
        worker = await self._pool.take()
        self._drop_recording()  # the file may have changed again meanwhile
        self._recording = worker
        if self._drawing is not None:
            self._drawing.pause()
        if worker.status is not None:
            self._ended(worker)  # the worker ended before anyone listened
        worker.send({"do": "open", "request": self.request, "state": self.state, "worker": worker.number})

    def stop(self) -> None:
        """End the busy worker: the one that records, else the one that draws."""
        if self._recording is not None:
            self._drop_recording()
        elif self._drawing is not None:
            self._end(self._drawing, "you stopped the process that runs the file")
            self._drawing = None
        self._fail("you stopped the process that runs the file", "a loop that ends; save the file to try again")

    def _drop_recording(self) -> None:
        if self._recording is not None:
            self._end(self._recording, _AGAIN)
        self._recording = self._described = None
        if self._drawing is not None:
            self._drawing.resume()

    def close(self) -> None:
        """End all workers."""
        self._pool.close()

    # Workers

    def _ping(self) -> None:
        """Ping the worker at intervals, and tell the pages for how long it has not answered."""
        worker, now = self._recording or self._drawing, time.monotonic()
        if now - self._pinged < _PING:
            return
        self._pinged = now
        silent = now - worker.asked if worker is not None and worker.asked is not None else 0.0
        if worker is not None and worker.asked is None:
            worker.asked = now
            worker.send({"do": "ping"})
        self._say_work(worker, silent, now)
        if silent > _SLOW:
            self._go_on(self._drawing)

    def _say_work(self, worker: Worker | None, silent: float, now: float) -> None:
        """Tell the pages what the worker does and for how long the picture has been awaited."""
        doing = worker.doing if worker is not None else None
        passed = now - self._awaited if self._awaited is not None else silent
        if silent > _SLOW or (doing and passed > _LONG):
            self._said_busy = True
            stage = "recording" if worker is self._recording and self._described is None else "running"
            told = {"stage": stage, "doing": doing, "seconds": round(passed), "silent": silent > _SLOW}
            self._broadcast(wire.pack({"kind": "busy", **told}))
        elif self._said_busy:
            self._said_busy = False
            self._broadcast(wire.pack({"kind": "busy", "seconds": 0}))

    def _heard(self, worker: Worker, message: bytes | None) -> None:
        """Handle a message of a worker; None means that its process has ended."""
        if worker not in (self._recording, self._drawing):
            return
        if message is None:
            self._ended(worker)
            return
        header, _ = wire.unpack(message)
        match header["kind"]:
            case "pong":
                worker.asked = None
            case "doing":
                worker.doing = header["text"]
            case "recorded":
                self._watch_files(header["files"])
                self._described = message
            case "error":
                self._take_error(worker, header, message)
            case "frame":
                self._take_frame(worker, header, message)
            case "answer":
                asked = (q for q in worker.questions if (q["page"], q["about"]) == (header["page"], header["about"]))
                if (question := next(asked, None)) is not None:
                    worker.questions.remove(question)
                page = self.pages.get(header["page"])
                if page is not None:
                    page.send(message)
            case _:
                self._broadcast(message)

    def _take_error(self, worker: Worker, header: wire.Header, message: bytes) -> None:
        """Show an error; drop a worker that could not record, or has no first picture while another one draws."""
        self._watch_files(header.get("files", ()))
        self._error, self._failed, self._awaited = message, worker, None
        self._broadcast(message)
        if worker is self._recording:
            if self._described is not None and self._drawing is None:
                self._promote(worker)  # a change of its controls may remove the error
            else:
                self._drop_recording()
            self._go_on(self._drawing)

    def _take_frame(self, worker: Worker, header: wire.Header, message: bytes) -> None:
        fresh = worker is self._recording
        if fresh:
            self._promote(worker)
        # A frame of the previous version does not show that the error in the file is gone.
        if self._error is not None and (fresh or worker is self._failed):
            self._error = None
            self._broadcast(wire.pack({"kind": "well"}))
        if worker is self._drawing and header.get("waiting") is None:
            self._awaited = None
        self.state.update(time=header["time"], frame=header["frame"])
        self._frame = message
        for page in self.pages.values():
            page.offer(message)

    def _promote(self, worker: Worker) -> None:
        """Let the worker that has recorded draw, and end the previous one."""
        if self._drawing is not None:
            self._end(self._drawing, _AGAIN)
        self._drawing, self._recording = worker, None
        self._recorded, self._described = self._described, None
        if self._recorded is not None:
            self._broadcast(self._recorded)

    def _ended(self, worker: Worker) -> None:
        status = worker.status
        how = f"by signal {-status}" if status is not None and status < 0 else f"with status {status}"
        if worker is self._recording:
            self._drop_recording()
        if worker is self._drawing:
            self._end(worker, f"the process that runs the file ended {how}")
            self._drawing = None
        self._fail(f"the process that runs the file ended {how}", "another backend; save the file to try again")

    def _fail(self, message: str, cure: str) -> None:
        self._failed = self._awaited = None
        self._error = wire.pack({"kind": "error", "stage": "stopped", "type": "", "message": message, "cure": cure})
        self._broadcast(self._error)

    def _go_on(self, worker: Worker | None) -> None:
        """Let the worker that draws compute its next frame, if a page has drawn one; end its pause."""
        if worker is not None:
            worker.resume()
            if self._seen[0] == worker.number:
                worker.send({"do": "acknowledge", "number": self._seen[1]})

    # Pages

    def join(self, page: Page) -> None:
        """Add a page and send it the state of the view."""
        self.pages[page.number] = page
        page.send(wire.pack({"kind": "hello", "page": page.number, "request": self.request, "state": self.state}))
        for message in (self._recorded, self._error):
            if message is not None:
                page.send(message)
        if self._frame is not None:
            page.offer(self._frame)

    def leave(self, page: Page) -> None:
        """Remove a page that has left."""
        if self.pages.pop(page.number, None) is not None:
            self._cancel(page.number)

    async def told(self, page: Page, message: dict[str, Any]) -> None:
        """Act on a message of a page, which `messages.checked` has checked."""
        match message["do"]:
            case "acknowledge":
                self._acknowledge(page, message["worker"], message["number"])
            case "set":
                self._set(page, message["changes"])
            case "pick":
                self.request["program"] = message["program"]
                await self.record()
            case "record":
                await self.record()
            case "stop":
                self.stop()
            case "reset":
                self.state.update(time=0.0, frame=0)
                self._forward(message)
            case "ask":
                self._ask({**message, "page": page.number})
            case "cancel":
                self._cancel(page.number)
            case _:
                self._forward(message)

    def _ask(self, question: dict[str, Any]) -> None:
        """Let the worker answer whose frame the question is about; without one, the workers that there are."""
        named = question.get("worker")
        workers = [one for one in (self._drawing, self._recording) if one is not None and named in (None, one.number)]
        for worker in workers:
            worker.send(question)
            worker.questions.append(question)
        if not workers:
            self._refuse(question, _AGAIN)

    def _refuse(self, question: dict[str, Any], problem: str) -> None:
        """Tell the page that asked why it gets no answer."""
        page = self.pages.get(question["page"])
        if page is not None:
            told = {"about": question["about"], "page": question["page"], "at": question.get("at")}
            page.send(wire.pack({"kind": "answer", **told, "problem": problem}))

    def _end(self, worker: Worker, problem: str) -> None:
        """End a worker, and tell the pages that wait for its answers why they get none."""
        worker.kill()
        for question in worker.questions:
            self._refuse(question, problem)
        worker.questions.clear()

    def _acknowledge(self, page: Page, worker: int, number: int) -> None:
        page.acknowledge()
        drawing = self._drawing
        if drawing is not None and worker == drawing.number:
            self._seen = worker, max(number, self._seen[1] if self._seen[0] == worker else 0)
            if self._recording is None:  # else the new version needs the processor
                self._go_on(drawing)

    def _set(self, page: Page, changes: dict[str, Any]) -> None:
        params = {**self.state["params"], **changes.get("params", {})}
        params = {name: value for name, value in params.items() if value is not None}
        self.state.update({**changes, "params": params})
        if self._awaited is None and _OTHER & changes.keys():
            self._awaited = time.monotonic()
        self._forward({"do": "set", "changes": changes})
        told = wire.pack({"kind": "state", "changes": changes})
        for other in self.pages.values():
            if other is not page:
                other.send(told)

    def _cancel(self, page: int | None) -> None:
        """Cancel the search of a page; None: all searches."""
        self._forward({"do": "cancel", "page": page})

    def _forward(self, message: wire.Header) -> None:
        for worker in (self._drawing, self._recording):
            if worker is not None:
                worker.send(message)

    def _broadcast(self, message: bytes) -> None:
        for page in self.pages.values():
            page.send(message)


def _stamp(path: Path) -> tuple[int, int] | None:
    """Return the time and size of a file; None if it does not exist, as while an editor replaces it."""
    with suppress(OSError):
        state = path.stat()
        return state.st_mtime_ns, state.st_size
    return None
