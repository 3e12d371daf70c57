"""Messages between worker, server and page: a header in JSON, followed by bytes.

Stage: view. Between server and page a message is one binary message of the WebSocket; between server and worker its
length precedes it.

    4 bytes: length of the header, little-endian | header, a JSON object | the rest, such as the pixels of a frame
"""

from __future__ import annotations

import asyncio
import json
import math
import socket
import struct
import threading
from typing import Any, Final

Header = dict[str, Any]
_LENGTH: Final = struct.Struct("<I")
_FRAME: Final = struct.Struct("<Q")


def pack(header: Header, rest: Any = b"") -> bytes:
    """Return the message; numbers that are not finite become strings, since JSON cannot hold them."""
    return b"".join((_head(header), rest))


def _head(header: Header) -> bytes:
    """Return the part of a message before its rest: the length of the header and the header."""
    text = json.dumps(plain(header), allow_nan=False).encode()
    return _LENGTH.pack(len(text)) + text


def unpack(message: bytes) -> tuple[Header, memoryview]:
    """Return the header and the rest of a message from `pack`."""
    (length,) = _LENGTH.unpack_from(message)
    start = _LENGTH.size
    return json.loads(message[start : start + length]), memoryview(message)[start + length :]


def plain(value: Any) -> Any:
    """Return a value that JSON can hold: numpy's arrays become lists, NaN and infinity become strings."""
    if isinstance(value, dict):
        return {str(name): plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


class Line:
    """The worker's end of the socket, which its threads share: reads and writes whole messages."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._lock = threading.Lock()
        self._reader = connection.makefile("rb")

    def send(self, header: Header, rest: Any = b"") -> None:
        """Send one message without copying its rest; raise OSError if the server is gone."""
        head = _head(header)
        with self._lock:
            self._connection.sendall(_FRAME.pack(len(head) + len(rest)) + head)
            self._connection.sendall(rest)

    def receive(self) -> Header | None:
        """Return the header of the next message; None if the server is gone."""
        length = self._reader.read(_FRAME.size)
        if len(length) < _FRAME.size:
            return None
        message = self._reader.read(_FRAME.unpack(length)[0])
        return unpack(message)[0]


async def receive(reader: asyncio.StreamReader) -> bytes:
    """Return the next message of a worker; raise IncompleteReadError if it is gone."""
    (length,) = _FRAME.unpack(await reader.readexactly(_FRAME.size))
    return await reader.readexactly(length)


def send(writer: asyncio.StreamWriter, header: Header) -> None:
    """Send a message to a worker."""
    message = pack(header)
    writer.write(_FRAME.pack(len(message)) + message)
