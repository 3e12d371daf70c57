"""Check the messages of a page: only messages listed here reach the hub.

Stage: view, in the server.

    checked('{"do": "set", "changes": {"playing": false}}')     # the message as a dict
    checked('{"do": "open"}')                                   # raises Refused
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from typing import Any, Final

from shpy.backend.registry import NAMES
from shpy.passes.modes import CONTRACTIONS

LONGEST: Final = 1 << 16
"""The most bytes of a message of a page."""
SIDE: Final = 4096
"""The most pixels along one side of a picture."""
_COMPONENTS: Final = 16
_LARGEST: Final = sys.float_info.max


class Refused(ValueError):
    """The error for a message that our pages never send."""


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and -_LARGEST <= value <= _LARGEST


def _whole(low: int, high: int) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, int) and not isinstance(value, bool) and low <= value <= high


def _numbers(count: int) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, list) and len(value) == count and all(map(_number, value))


def _text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= 200


def _pair(low: int) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, list) and len(value) == 2 and all(map(_whole(low, SIDE), value))


def _component(value: Any) -> bool:
    return _number(value) or isinstance(value, bool)


def _params(value: Any) -> bool:
    return isinstance(value, dict) and all(
        _text(name) and (v is None or (isinstance(v, list) and len(v) <= _COMPONENTS and all(map(_component, v))))
        for name, v in value.items()
    )


def _flag(value: Any) -> bool:
    return isinstance(value, bool)


_count = _whole(0, 1 << 40)
_CHANGES: Final[dict[str, Callable[[Any], bool]]] = {
    "playing": _flag,
    "encode": _flag,
    "mark": _flag,
    "time": _number,
    "frame": _whole(0, 1 << 30),
    "steps": _whole(1, 1000),
    "size": _pair(1),
    "mouse": _numbers(4),
    "backend": lambda value: _text(value) and value in NAMES,
    "math": lambda value: _text(value) and value in CONTRACTIONS,
    "params": _params,
    "scene": lambda value: isinstance(value, dict),
}


def _changes(value: Any) -> bool:
    return isinstance(value, dict) and all(name in _CHANGES and _CHANGES[name](v) for name, v in value.items())


_MESSAGES: Final[dict[str, dict[str, Callable[[Any], bool]]]] = {
    "acknowledge": {"worker": _count, "number": _count},
    "set": {"changes": _changes},
    "pick": {"program": _text},
    "record": {},
    "stop": {},
    "reset": {},
    "step": {},
    "cancel": {},
    "ask": {"about": _text, "at": _pair(0), "with": _changes, "worker": _count, "number": _count},
}
_OPTIONAL: Final = ("at", "with", "worker", "number")


def checked(text: str | bytes) -> dict[str, Any]:
    """Return the message; raise Refused for a message that our pages never send."""
    try:
        message = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise Refused("it is no JSON") from error
    if not isinstance(message, dict) or not isinstance(message.get("do"), str) or message["do"] not in _MESSAGES:
        raise Refused("it asks for nothing that there is")
    fields = _MESSAGES[message["do"]]
    for name, value in message.items():
        if name != "do" and not (name in fields and fields[name](value)):
            raise Refused(f"{message['do']}: {name}")
    missing = [name for name in fields if name not in message and name not in _OPTIONAL]
    if missing:
        raise Refused(f"{message['do']} without {missing[0]}")
    return message


def _refuse_constant(text: str) -> float:
    raise ValueError(text)
