"""The connection to a Dask cluster: a client that exists, the address of a scheduler, or workers of this machine.

Stage: cluster. Dask is imported when a cluster is asked for.

    with connected("local:4") as client:
        client.submit(...)
"""

from __future__ import annotations

import json
import logging
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import shpy as sh
from raytracer.errors import ClusterError

FIRST_ANSWER = 30
"""Seconds within which a scheduler must answer."""
MOST = 1024
"""Workers of this machine, at most."""
_KEEPING = {"MALLOC_TRIM_THRESHOLD_": f"{1 << 28}", "MALLOC_MMAP_THRESHOLD_": f"{1 << 28}"}
"""Settings of glibc's malloc that keep memory for the next array. Dask has it return all of it to the system, and
numpy, which takes it again for each array, is slower."""


@contextmanager
def connected(cluster: Any) -> Iterator[Any]:
    """Yield a dask.distributed.Client: the given one, or a new one that is closed at the end.

    `cluster` may also be the address of a scheduler, such as "tcp://host:8786", or "local:4" for four processes of this
    machine, which end with it. Raises ClusterError for anything else, for a scheduler that does not answer, and where
    Dask is missing.
    """
    distributed = _distributed()
    if isinstance(cluster, distributed.Client):
        if cluster.asynchronous:
            raise ClusterError("this Client is asynchronous: make one without asynchronous=True")
        yield cluster
        return
    count = _count_of(cluster)
    if count is None:
        try:
            client = distributed.Client(cluster, timeout=FIRST_ANSWER, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ClusterError(
                f"no Dask scheduler answers at {cluster} ({type(error).__name__}): start one with `dask scheduler`"
            ) from None
        with client:
            yield client
        return
    with _quiet(), _workers(count) as here, distributed.Client(here, set_as_default=False) as client:
        client.wait_for_workers(count)
        yield client


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence what Dask logs of connections that close while the workers end: it turns its own silence off before."""
    logger = logging.getLogger("distributed.batched")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)


def _count_of(cluster: Any) -> int | None:
    """Return the N of "local:N", None for an address."""
    text = cluster if isinstance(cluster, str) else ""
    local = re.fullmatch(r"local:([0-9]{1,9})", text)
    if local and 1 <= int(local[1]) <= MOST:
        return int(local[1])
    if local or not re.match(r"[a-z]+://.", text):
        raise ClusterError(
            'a cluster is a dask.distributed.Client, an address such as "tcp://host:8786", or "local:N" for '
            f"1 to {MOST} workers of this machine, not {cluster!r}"
        )
    return None


def _workers(count: int) -> Any:
    """Start workers of one thread each on this machine, and their scheduler in this process."""
    from distributed import Scheduler, SpecCluster

    host = {"host": "127.0.0.1"}
    worker = {"cls": _worker_class(), "options": {"worker_kwargs": {**host, "nthreads": 1, "dashboard": False}}}
    return SpecCluster(
        scheduler={"cls": Scheduler, "options": {**host, "dashboard": False, "dashboard_address": ":0"}},
        workers=dict.fromkeys(range(count), worker),
        worker=worker,
        silence_logs=logging.CRITICAL,
    )


def _worker_class() -> Any:
    import asyncio  # here, since commands without a cluster import this file, too

    from distributed.deploy.subprocess import SubprocessWorker

    class LocalWorker(SubprocessWorker):  # type: ignore[misc]
        """A worker that the command `dask` starts, so that no script is imported again as with multiprocessing.

        It imports from the same folders as this process, prints nothing and ignores Ctrl-C: this process ends it.
        """

        async def _start(self) -> None:
            words = [sys.executable, "-m", "dask", "spec", self.scheduler, "--spec"]
            spec = json.dumps({"cls": self.worker_class, "opts": self.worker_kwargs})
            folders = os.pathsep.join(folder or os.getcwd() for folder in sys.path)
            environment = {**_KEEPING, **os.environ, "PYTHONPATH": folders, "DASK_LOGGING__DISTRIBUTED": "critical"}
            self.process = await asyncio.create_subprocess_exec(*words, spec, env=environment, start_new_session=True)

    return LocalWorker


def _distributed() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise ClusterError(f"a cluster needs Dask: {sh.packages.install('dask', 'distributed')}") from error
    return distributed
