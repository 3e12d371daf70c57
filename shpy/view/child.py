"""The worker: a process that records one version of a file and computes its frames.

Stage: view. The server starts it with the file descriptor of a socket and the name of the session's module. It warms
up, waits for the request to open a file, and then computes frames as long as the page acknowledges them: at most two
frames are sent before one of them is acknowledged.

    python -m shpy.view.child 5 shpy.view.session
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import queue
import signal
import socket
import sys
import threading
import traceback
from typing import Any, Final

from shpy.backend.slow import hear
from shpy.view.wire import Line

_PR_SET_PDEATHSIG: Final = 1
_AHEAD: Final = 2
"""The most frames that are sent and not yet acknowledged."""


class WorkerLoop:
    """The loop of a worker process: it handles messages first, then draws a frame."""

    def __init__(self, line: Line, module: Any) -> None:
        self.line = line
        self.module = module
        self.inbox: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self.session: Any = None
        self.number = 0
        self.sent = self.acknowledged = 0
        self.faulty: str | None = None
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        while (message := self.line.receive()) is not None:
            self.inbox.put(message)
        os._exit(0)  # the server is gone, so the process ends, whatever the user's code is doing

    def run(self) -> None:
        """Answer messages and compute frames until the server is gone."""
        idle = True
        while True:
            if idle:
                self._take(self.inbox.get())
            while not self.inbox.empty():
                self._take(self.inbox.get())
            idle = not self._frame()

    def _take(self, message: dict[str, Any]) -> None:
        if message["do"] == "open":
            self._open(message)
        elif message["do"] == "ping":
            self.line.send({"kind": "pong"})
        elif message["do"] == "acknowledge":
            self.acknowledged = max(self.acknowledged, message["number"])
        elif self.session is not None:
            self._guarded(lambda: self._act(message), message)

    def _act(self, message: dict[str, Any]) -> None:
        match message["do"]:
            case "set":
                for refused in self.session.set(message["changes"]):
                    self.line.send({"kind": "remark", "text": refused})
                self.faulty = None
            case "reset":
                self.session.reset()
                self.faulty = None
            case "step":
                self.session.step()
            case "wake":
                self.session.woken()
            case "cancel":
                self.session.cancel(message["page"])
            case "ask":
                header, rest = self.session.answer(message)
                self.line.send({"kind": "answer", "about": message["about"], "page": message["page"], **header}, rest)

    def _open(self, message: dict[str, Any]) -> None:
        request, self.number = message["request"], message["worker"]
        try:
            session = self.module.Session(request, lambda: self.inbox.put({"do": "wake"}), self.line.send)
            session.set(message["state"])
        except BaseException as error:  # the user's code may raise SystemExit too
            self.line.send({"kind": "error", "stage": "recording", **self.module.explain_opening(error, request)})
            return
        self.session = session
        self.line.send({"kind": "recorded", "files": session.files(), **session.describe()})

    def _frame(self) -> bool:
        """Send the next frame; return whether another one may follow at once."""
        if self.session is None or self.faulty or self.sent - self.acknowledged >= _AHEAD:
            return False
        frames: list[Any] = []
        if not self._guarded(lambda: frames.append(self.session.next()), None) or frames[0] is None:
            return False
        header, rest = frames[0]
        self.sent += 1
        self.line.send(
            {"kind": "frame", "worker": self.number, "number": self.sent, **header}, memoryview(rest).cast("B")
        )
        return True

    def _guarded(self, work: Any, message: dict[str, Any] | None) -> bool:
        """Call `work`; return whether it succeeded, and send its error if not."""
        try:
            work()
            return True
        except OSError as error:
            if isinstance(error, BrokenPipeError | ConnectionError):
                os._exit(0)
            self._fail(error, message)
        except Exception as error:
            self._fail(error, message)
        return False

    def _fail(self, error: Exception, message: dict[str, Any] | None) -> None:
        explained = self.session.explain(error)
        if message is not None and message["do"] == "ask":
            header = {"kind": "answer", "about": message["about"], "page": message["page"]}
            self.line.send({**header, "problem": explained["message"], "cure": explained["cure"]})
            return
        self.faulty = explained["message"]  # until the state changes, since each frame would raise the same error
        self.line.send({"kind": "error", "stage": "running", **explained})


def _end_with_server() -> None:
    """Let Linux end this process with the server, since a paused process does not see that its socket closes."""
    with contextlib.suppress(OSError, AttributeError):  # other systems have no prctl
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def main(descriptor: int, name: str) -> None:
    """Run a worker on this socket until the server closes it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the server handles Ctrl-C and ends its workers
    _end_with_server()
    os.environ.setdefault("SHPY_QUIET", "1")  # the page says what compiles
    line = Line(socket.socket(fileno=descriptor))
    module = importlib.import_module(name)
    worker = WorkerLoop(line, module)
    try:
        module.warm()
    except Exception:
        traceback.print_exc()  # a broken driver: the page shows the error when that backend is chosen
    line.send({"kind": "warm"})
    hear(lambda text: line.send({"kind": "doing", "text": text}))
    worker.run()


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
