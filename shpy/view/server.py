"""The server of a view: the files of a page, and a WebSocket for each page that is open, for this machine alone.

Stage: view. Every request has to name this machine as its Host, and a WebSocket has to come from a page of this
server (Origin): so no other web page can read or change the view, by a name of its own for 127.0.0.1 either.

    serve(View("shpy.view.session", {"path": "shader.py"}), port=8000)
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ipaddress
import itertools
import re
import signal
import socket
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from shpy.errors import ShpyError
from shpy.packages import install
from shpy.view.hub import Hub
from shpy.view.messages import LONGEST, Refused, checked

if TYPE_CHECKING:
    import uvicorn
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.websockets import WebSocket

LOOPBACK: Final = "127.0.0.1"
PAGE: Final = Path(__file__).with_name("page")
_HEADERS: Final = {
    "content-security-policy": "default-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
_TYPES: Final = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
_CLOSING: Final = 0.5
"""Seconds within which pages have to close when the server ends."""
_POLICY: Final = 1008
"""The code of a WebSocket that is closed because a message, or the page itself, is refused."""


@dataclass(frozen=True)
class View:
    """A view to serve: the module of its sessions, the request that opens one, and the state at first.

    `pages` are folders with the page's files; of two files of one name the first folder's is served.
    """

    module: str
    request: dict[str, Any]
    state: dict[str, Any] = field(default_factory=dict)
    pages: tuple[Path, ...] = (PAGE,)

    def files(self) -> dict[str, Path]:
        """Return the files of the page by their paths; no other path is served."""
        paths = {f"/{p.name}": p for folder in reversed(self.pages) for p in folder.iterdir() if p.suffix in _TYPES}
        return {**paths, "/": paths["/index.html"]}


class _Connection:
    """A connected page: messages are queued in order, but of frames only the latest is kept."""

    _numbers = itertools.count(1)

    def __init__(self) -> None:
        self.number = next(self._numbers)
        self._messages: asyncio.Queue[bytes] = asyncio.Queue()
        self._waiting: bytes | None = None
        self._drawing = False

    def send(self, message: bytes) -> None:
        """Queue a message, without waiting."""
        self._messages.put_nowait(message)

    def offer(self, frame: bytes) -> None:
        """Send a frame; while the page draws an earlier one, keep the frame in place of any other kept one."""
        if self._drawing:
            self._waiting = frame
        else:
            self._drawing = True
            self.send(frame)

    def acknowledge(self) -> None:
        """Record that the page has drawn its last frame, and send the kept one."""
        self._drawing, frame, self._waiting = False, self._waiting, None
        if frame is not None:
            self.offer(frame)

    async def deliver(self, send: Callable[[bytes], Awaitable[None]]) -> None:
        """Send queued messages until the connection ends."""
        while True:
            await send(await self._messages.get())


def allowed_host(host: str, *, beyond: bool) -> bool:
    """Return whether a Host header names this machine: loopback, or with `beyond` its host name or a numeric address.

    Any other name could belong to another site that resolves it to this machine (DNS rebinding).
    """
    name = _name(host)
    if name in (LOOPBACK, "localhost", "::1"):
        return True
    if not beyond:
        return False
    with contextlib.suppress(ValueError):
        ipaddress.ip_address(name)
        return True
    return name == socket.gethostname().lower()


def _name(host: str) -> str:
    """Return the name or address of a Host header; empty where the header is malformed."""
    match = re.fullmatch(r"(?:\[([0-9A-Fa-f:.]+)\]|([A-Za-z0-9._-]+))(?::([0-9]{0,5}))?", host)
    if match is None or int(match[3] or 0) > 65535:
        return ""
    return (match[1] or match[2]).lower()


def _is_own(origin: str, host: str) -> bool:
    """Return whether an Origin header is that of a page of this server, which was asked under the same Host."""
    return origin in (f"http://{host}", f"https://{host}")


class _Site:
    """The routes of a view: its files, and the WebSocket of each page."""

    def __init__(self, view: View, *, beyond: bool) -> None:
        self._view = view
        self._files = view.files()
        self._beyond = beyond
        self._hub: Hub

    @contextlib.asynccontextmanager
    async def lifespan(self, app: Any) -> AsyncIterator[None]:
        """Watch the files as long as the server runs."""
        self._hub = Hub(self._view.module, self._view.request, {"params": {}, **self._view.state})
        watching = asyncio.create_task(self._hub.watch())
        try:
            yield
        finally:
            watching.cancel()
            self._hub.close()

    async def file(self, request: Request) -> Response:
        """Answer with one of the page's files."""
        from starlette.responses import PlainTextResponse, Response

        if not allowed_host(request.headers.get("host", ""), beyond=self._beyond):
            return PlainTextResponse("this server is for its own machine", 421, headers=_HEADERS)
        path = self._files.get(request.url.path)
        if path is None:
            return PlainTextResponse("there is no such page", 404, headers=_HEADERS)
        return Response(path.read_bytes(), media_type=_TYPES[path.suffix], headers=_HEADERS)

    async def connect(self, connection: WebSocket) -> None:
        """Serve one page of this server until it leaves; refuse those of others."""
        host, origin = (connection.headers.get(name, "") for name in ("host", "origin"))
        if not allowed_host(host, beyond=self._beyond) or not _is_own(origin, host):
            await connection.close(_POLICY)
            return
        await connection.accept()
        page = _Connection()
        self._hub.join(page)
        delivery = asyncio.create_task(page.deliver(connection.send_bytes))
        try:
            await self._listen(page, connection)
        finally:
            self._hub.leave(page)
            delivery.cancel()

    async def _listen(self, page: _Connection, connection: WebSocket) -> None:
        from starlette.websockets import WebSocketDisconnect

        try:
            while True:
                await self._hub.told(page, checked(await connection.receive_text()))
        except WebSocketDisconnect:
            return
        except (Refused, KeyError):  # a KeyError where the message is bytes
            await connection.close(_POLICY)


def application(view: View, *, beyond: bool = False) -> Any:
    """Return the ASGI application. Raises ShpyError where Starlette is missing."""
    try:
        from starlette.applications import Starlette
        from starlette.routing import Route, WebSocketRoute
    except ImportError as error:
        raise missing() from error
    site = _Site(view, beyond=beyond)
    return Starlette(
        routes=[WebSocketRoute("/view", site.connect), Route("/{path:path}", site.file, methods=["GET"])],
        lifespan=site.lifespan,
    )


def missing() -> ShpyError:
    """Return the error for a view without the packages that it needs."""
    return ShpyError(
        "a view needs Starlette, uvicorn and websockets", cure=install("starlette", "uvicorn", "websockets")
    )


def serve(view: View, *, address: str = LOOPBACK, port: int = 8000, report: Callable[[str], None] = print) -> None:
    """Serve the view until Ctrl-C; `report` is called with each line to print.

    Port 0 takes a free one. An address beyond loopback is warned of: whoever reaches it sees and changes the view.
    Raises ShpyError where the port is taken or a package is missing.
    """
    try:
        import uvicorn
        import websockets
    except ImportError as error:
        raise missing() from error
    del websockets  # uvicorn finds it
    beyond = not _is_loopback(address)
    app = application(view, beyond=beyond)
    listening = _listen(address, port)
    port = listening.getsockname()[1]
    host = f"[{address}]" if ":" in address else address
    config = uvicorn.Config(
        app,
        log_level="warning",
        ws="websockets-sansio",
        ws_max_size=LONGEST,
        ws_per_message_deflate=False,  # on this machine compressing takes longer than sending
        timeout_graceful_shutdown=_CLOSING,  # type: ignore[arg-type]
        server_header=False,
    )
    with listening:
        try:
            server = uvicorn.Server(config)
            report(f"http://{host}:{port}/   (Ctrl-C ends it)")
            if beyond:
                report("warning: everybody who reaches this machine sees the view and changes it, without a password")
            with _signals_kept(server):
                server.run(sockets=[listening])
        except KeyboardInterrupt as error:
            raise type(error)("stopped") from None


@contextlib.contextmanager
def _signals_kept(server: uvicorn.Server) -> Iterator[None]:
    """Let Ctrl-C and SIGTERM end the server, and raise them again when it has ended.

    uvicorn does so once its event loop runs. Before, an interrupt while Python creates the loop would leave it
    unfinished. Threads other than the main one get no signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    signals: list[int] = []

    def take(number: int, frame: object) -> None:
        signals.append(number)
        server.should_exit = True

    before = {number: signal.signal(number, take) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for one in signals[:1]:
        signal.raise_signal(one)


def _is_loopback(address: str) -> bool:
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return address == "localhost"


def _listen(address: str, port: int) -> socket.socket:
    """Return a listening socket; raise ShpyError if the address or port cannot be bound."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    listener = socket.socket(family)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((address, port))
        listener.listen()
    except OSError as error:
        listener.close()
        others = f"--port {port + 1}" if port < 65535 else f"--port {port - 1}"
        cure = others if error.errno in (errno.EADDRINUSE, errno.EACCES) else "--listen 127.0.0.1"
        raise ShpyError(f"{address}:{port}: {error.strerror or error}", cure=cure) from error
    return listener
