"""The child processes of a view: one that draws, one that records the next version, and a warm one.

Stage: view, in the server. A worker is a process with a socket; it runs `child` until the socket closes or `kill` ends
it. A warm worker has imported shpy and opened the devices, so it records a file within milliseconds.

    pool = Pool("shpy.view.session", heard)
    worker = await pool.take()              # the warm one; another one warms up
    worker.send({"do": "open", …})
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from typing import Final

from shpy.view import wire

Heard = Callable[["Worker", bytes | None], None]
"""The function that is called with each message of a worker, and with None when its process has ended."""

_HEAD_START: Final = 1.0
"""Seconds for which the recording worker has the processor to itself, before the next worker warms up."""
_numbers = itertools.count(1)


class Worker:
    """A child process and the server's end of its socket."""

    def __init__(self, module: str, heard: Heard) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            command = [sys.executable, "-m", "shpy.view.child", str(theirs.fileno()), module]
            # In a session of its own, so that a terminal's Ctrl-C reaches only the server.
            self.process = subprocess.Popen(command, pass_fds=(theirs.fileno(),), start_new_session=True)
        ours.setblocking(False)
        self._socket = ours
        self.number = next(_numbers)
        self.asked: float | None = None
        """The time of the ping that has no answer yet."""
        self.doing: str | None = None
        """The work for the picture that is awaited, in the words of the worker."""
        self.questions: list[wire.Header] = []
        """The questions of pages that have no answer yet."""
        self._heard = heard
        self.warm = asyncio.Event()
        self._writer: asyncio.StreamWriter | None = None
        self._task = asyncio.create_task(self._listen())

    async def _listen(self) -> None:
        reader, self._writer = await asyncio.open_connection(sock=self._socket)
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            wire.unpack(await wire.receive(reader))  # the message that the worker is warm
            self.warm.set()
            while True:
                self._heard(self, await wire.receive(reader))
        self.warm.set()
        await asyncio.to_thread(self.process.wait)  # the socket closes a moment before the process has a status
        self._heard(self, None)

    def send(self, header: wire.Header) -> None:
        """Send a message; do nothing if the worker has ended."""
        if self._writer is not None and not self._writer.is_closing():
            wire.send(self._writer, header)

    @property
    def status(self) -> int | None:
        """The exit status of the process, negative for a signal; None while it runs."""
        return self.process.poll()

    def pause(self) -> None:
        """Stop the process until `resume`, so that another one has the processor."""
        self.process.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        """Continue a process that `pause` stopped; do nothing to one that runs."""
        self.process.send_signal(signal.SIGCONT)

    def kill(self) -> None:
        """End the process, whatever it is doing."""
        self._task.cancel()
        if self._writer is not None:
            self._writer.close()
        else:
            self._socket.close()
        self.process.kill()  # the pool waits for the end, which takes a while for a large process


class Pool:
    """The workers of one module of sessions, with one warm spare.

    After `take` there is no spare for `_HEAD_START` seconds, so that the worker that was taken has the processor.
    """

    def __init__(self, module: str, heard: Heard) -> None:
        self._module = module
        self._heard = heard
        self._all: set[Worker] = set()
        self._spare: Worker | None = None
        self._later: asyncio.TimerHandle | None = None
        self._start()

    def _start(self) -> Worker:
        """Return the spare worker; start one if there is none."""
        if self._later is not None:
            self._later.cancel()
        if self._spare is None:
            self._all = {worker for worker in self._all if worker.status is None}
            self._spare = Worker(self._module, self._heard)
            self._all.add(self._spare)
        return self._spare

    async def take(self) -> Worker:
        """Return a warm worker; the next one starts once this one has had the processor for a while."""
        worker = self._start()
        await worker.warm.wait()
        if worker is not self._spare:  # another caller took it meanwhile
            return await self.take()
        self._spare = None
        self._later = asyncio.get_running_loop().call_later(_HEAD_START, self._start)
        return worker

    def close(self) -> None:
        """End all workers."""
        if self._later is not None:
            self._later.cancel()
        for worker in self._all:
            worker.kill()
        for worker in self._all:
            worker.process.wait()
