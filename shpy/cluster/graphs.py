"""Graphs: run a job for each block, and make the Dask arrays of the outputs from its results.

Stage: cluster. Dask's blockwise makes the tasks; the job is one key of the graph, so each worker receives it once.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from shpy.cluster.arrays import dask_array
from shpy.cluster.jobs import Job, piece, run_job
from shpy.ir.constants import dtypes_at
from shpy.lang.values.structure import Layout, build_arrays, leaves

Chunks = tuple[tuple[int, ...], ...]
Places = Sequence[Sequence[tuple[int, int, int]]]
"""For each axis and block of it: where the block begins, and the part of it, from and to, that the result keeps."""


def over_blocks(
    job: Job,
    arrays: Sequence[Any],
    tails: Sequence[bool],
    places: Places,
    chunks: Chunks,
    output: Layout,
    precision: str,
    joined: Mapping[str, Sequence[Any]] | None = None,
) -> Any:
    """Return the outputs of a job as Dask arrays in the structure of `output`, with these chunks of elements.

    `tails` says which arrays have an axis of components. `joined` has the arrays of one chunk that every task takes
    whole, by the name of the Table that they make. Nothing runs.
    """
    import dask

    da = dask_array()
    rank, packed = len(chunks), pickle.dumps(job)
    digest = hashlib.sha256(packed).hexdigest()[:32]
    sent = dask.delayed(packed, name=f"shpy-{digest}", pure=True)
    axes = tuple(range(rank))
    pairs: list[Any] = []
    for number, (array, tail) in enumerate(zip(arrays, tails, strict=True)):
        own = array.ndim - tail
        pairs += [array, axes[rank - own :] + ((rank + number,) if tail else ())]
    for axis, blocks in enumerate(places):
        table = np.array(blocks, np.int64).reshape(-1, 3)
        pairs += [da.from_array(table, chunks=(1, 3)), (axis, rank + len(arrays) + axis)]
    output_leaves = list(leaves(output, "output"))
    tables = {name: [leaf.to_delayed().item() for leaf in parts] for name, parts in (joined or {}).items()}
    options: dict[str, Any] = {
        "joined": tables, "align_arrays": False, "concatenate": True, "packed": sent, "rank": rank,
        "adjust_chunks": dict(zip(axes, chunks, strict=True)),
    }  # fmt: skip
    parts = [_meta(cls, rank, precision) for _, _, cls in output_leaves]
    if len(parts) == 1:
        components, meta = parts[0]
        new = {rank + len(pairs): components} if components else {}
        whole = da.blockwise(run_job, axes + tuple(new), *pairs, new_axes=new, dtype=meta.dtype, meta=meta, **options)
        return build_arrays(output, iter([whole]))
    several = np.empty((0,) * rank, object)
    whole = da.blockwise(run_job, axes, *pairs, dtype=object, meta=several, **options)
    outputs = []
    for k, (components, meta) in enumerate(parts):
        new = {rank: components} if components else {}
        outputs.append(
            da.blockwise(piece, axes + tuple(new), whole, axes, new_axes=new, k=k, dtype=meta.dtype, meta=meta)
        )
    return build_arrays(output, iter(outputs))


def _meta(cls: Any, rank: int, precision: str) -> tuple[int, Any]:
    """Return the extent of a leaf's axis of components, 0 for a scalar, and an empty array of the leaf's dtype."""
    tail = cls.size if cls.size > 1 else 0
    return tail, np.empty((0,) * (rank + bool(tail)), dtypes_at(precision)[cls.base])


def whole_places(chunks: Chunks) -> list[list[tuple[int, int, int]]]:
    """Return for each axis the blocks as (start in the grid, 0, extent): each block is kept whole, without a border."""
    return [
        [(int(start), 0, n) for start, n in zip(np.cumsum((0, *sizes[:-1])), sizes, strict=True)] for sizes in chunks
    ]
