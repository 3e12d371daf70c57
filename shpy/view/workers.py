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
import socket
import subprocess
import sys
from collections.abc import Callable

from shpy.view import wire

Heard = Callable[["Worker", bytes | None], None]
"""The function for each message of a worker; None where its process has ended."""


_numbers = itertools.count(1)


class Worker:
    """A child process and the server's end of its socket."""

    def __init__(self, module: str, heard: Heard) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            command = [sys.executable, "-m", "shpy.view.child", str(theirs.fileno()), module]
            # Of a session of its own, so that a terminal's Ctrl-C reaches the server alone.
            self.process = subprocess.Popen(command, pass_fds=(theirs.fileno(),), start_new_session=True)
        ours.setblocking(False)
        self._socket = ours
        self.number = next(_numbers)
        self.asked: float | None = None
        """When the question was asked that has no answer yet."""
        self._heard = heard
        self.warm = asyncio.Event()
        self._writer: asyncio.StreamWriter | None = None
        self._task = asyncio.create_task(self._listen())

    async def _listen(self) -> None:
        reader, self._writer = await asyncio.open_connection(sock=self._socket)
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            wire.unpack(await wire.receive(reader))  # that it is warm
            self.warm.set()
            while True:
                self._heard(self, await wire.receive(reader))
        self.warm.set()
        await asyncio.to_thread(self.process.wait)  # it closes the socket a moment before it has a status
        self._heard(self, None)

    def send(self, header: wire.Header) -> None:
        """Send a message; a worker that has ended takes none."""
        if self._writer is not None and not self._writer.is_closing():
            wire.send(self._writer, header)

    @property
    def status(self) -> int | None:
        """The exit status of the process, negative for a signal; None while it runs."""
        return self.process.poll()

    def kill(self) -> None:
        """End the process, whatever it is doing."""
        self._task.cancel()
        if self._writer is not None:
            self._writer.close()
        else:
            self._socket.close()
        self.process.kill()
        self.process.wait()


class Pool:
    """Workers for one module of sessions: there is always a warm one, or one that is warming up."""

    def __init__(self, module: str, heard: Heard) -> None:
        self._module = module
        self._heard = heard
        self._spare = Worker(module, heard)
        self._all = {self._spare}

    async def take(self) -> Worker:
        """Return a warm worker, and start the next one."""
        worker = self._spare
        await worker.warm.wait()
        if worker is not self._spare:  # somebody else took it meanwhile
            return await self.take()
        self._all = {w for w in self._all if w.status is None}
        self._spare = Worker(self._module, self._heard)
        self._all.add(self._spare)
        return worker

    def close(self) -> None:
        """End all workers."""
        for worker in self._all:
            worker.kill()
