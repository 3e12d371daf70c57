"""Tasks on a cluster: results as they are completed, errors as if raised here, and objects that workers keep.

Stage: cluster.

    for item, result in finished(client, function, items, shared):
        ...
"""

from __future__ import annotations

import inspect
import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import shpy as sh
from raytracer import errors
from raytracer.errors import ClusterError

FIRST_WORKER = 60
"""Seconds within which a cluster must have a worker."""
_FOREIGN = tuple(
    os.path.dirname(os.path.abspath(file)) + os.sep for file in (errors.__file__, inspect.getfile(sh.Program))
)
T = TypeVar("T")
KEPT = 2
"""Things that a process keeps."""
_things: OrderedDict[str, tuple[Any, Any]] = OrderedDict()
_making = threading.Lock()


def await_worker(client: Any) -> None:
    """Wait for the first worker of a cluster; ClusterError where none comes."""
    try:
        client.wait_for_workers(1, timeout=FIRST_WORKER)
    except TimeoutError:
        raise ClusterError(
            f"the cluster has no workers: start some by `dask worker {client.scheduler.address}`"
        ) from None


@contextmanager
def scattered(client: Any, thing: Any) -> Iterator[Any]:
    """Send a thing to every worker once; yield its future, which is released at the end."""
    await_worker(client)
    try:
        future = client.scatter(thing, broadcast=True, hash=False)
    except Exception as error:
        raise shown(error) from None
    try:
        yield future
    finally:
        future.release()


def key_of(thing: Any) -> str:
    """Return a key of an object's content, by which a worker finds the results that it has kept."""
    from dask.base import tokenize

    return str(tokenize(thing))


def finished(
    client: Any, function: Callable[..., Any], items: Iterable[Any], *shared: Any
) -> Iterator[tuple[Any, Any]]:
    """Run `function(*shared, item)` for each item as a task; yield items and results in the order in which they finish.

    Tasks that are left are cancelled when the iterator is closed, Ctrl-C included.
    Raises the error of a task, without Dask's part of the traceback; ClusterError where workers died over it.
    """
    from distributed import as_completed

    futures = {client.submit(function, *shared, item, pure=False): item for item in items}
    results = as_completed(list(futures), loop=client.loop, with_results=True)
    try:
        while futures:
            try:
                future, result = next(results)
                if future.cancelled():
                    raise result
            except Exception as error:
                raise shown(error) from None
            yield futures.pop(future), result
    finally:
        client.cancel(list(futures), force=True)


def in_order(client: Any, function: Callable[..., Any], items: Iterable[Any], *shared: Any) -> Iterator[Any]:
    """Run tasks as `finished` does; yield the results in the order of the items."""
    futures = [client.submit(function, *shared, item, pure=False) for item in items]
    futures.reverse()
    try:
        while futures:
            try:
                result = futures[-1].result()
            except Exception as error:
                raise shown(error) from None
            futures.pop()
            yield result
    finally:
        client.cancel(futures, force=True)


def is_loss(error: Exception) -> bool:
    """Return whether a task was lost with a worker."""
    from distributed import CancelledError, KilledWorker
    from distributed.comm import CommClosedError

    return isinstance(error, KilledWorker | CancelledError | CommClosedError)


def shown(error: Exception) -> Exception:
    """Return a task's error with the lines of the user's code alone, or the ClusterError that explains its loss."""
    from distributed import CancelledError, KilledWorker
    from distributed.comm import CommClosedError

    match error:
        case KilledWorker():
            return ClusterError(
                f"workers died again and again over the same task, the last of them at {error.last_worker.address}: "
                "perhaps their memory is too small for the scene"
            )
        case CancelledError():
            return ClusterError(
                f"the cluster has lost or cancelled a task ({error}): did the scheduler stop, or its "
                "workers for want of memory?"
            )
        case CommClosedError():
            return ClusterError(f"the cluster does not answer any more: {error}")
    return error.with_traceback(_of_user(error.__traceback__))


def _of_user(trace: TracebackType | None) -> TracebackType | None:
    """Return a traceback without the frames of Dask, the ray tracer and the language."""
    if trace is None:
        return None
    rest = _of_user(trace.tb_next)
    if _is_foreign(trace.tb_frame.f_code.co_filename):
        return rest
    return TracebackType(rest, trace.tb_frame, trace.tb_lasti, trace.tb_lineno)


def _is_foreign(file: str) -> bool:
    parts = Path(file).parts
    return "distributed" in parts or "dask" in parts or file.startswith(_FOREIGN)


@contextmanager
def kept(key: str, make: Callable[[], T], room: int = KEPT) -> Iterator[T]:
    """Yield the object of a key, to one thread at a time; `make()` makes it once for each process.

    A process keeps the `room` objects that were used last.
    """
    with _making:
        if key not in _things:
            while len(_things) >= room:
                _things.popitem(last=False)
            _things[key] = make(), threading.Lock()
        _things.move_to_end(key)
        thing, lock = _things[key]
    with lock:
        yield thing


def forget() -> None:
    """Drop all objects."""
    _things.clear()
