"""sh.map_blocks: a kernel over each block of Dask arrays.

Stage: cluster. Takes a kernel and Dask arrays, gives Dask arrays whose graph has one task per block. The arrays are
broadcast and cut into chunks that agree, and each task gets the place of its block, so that the bits do not depend on
the chunks.

    out = map_blocks(kernel, x, y)      # nothing runs yet
    out.compute()
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shpy.chains.chain import Chain
from shpy.cluster.arrays import Cut, check_hosted, check_whole, cut_leaves, dask_array, has_lazy, unified, whole_leaves
from shpy.cluster.graphs import Chunks, over_blocks, whole_places
from shpy.cluster.jobs import Blockwise
from shpy.errors import ShpyTypeError
from shpy.lang.data.tables import TableType
from shpy.lang.data.textures import TextureType
from shpy.lang.recording.location import here
from shpy.programs import Program
from shpy.run import host
from shpy.run.kernel import Kernel
from shpy.streams.elements import Shape


def map_blocks(kernel: Kernel | Program, *arrays: Any, shape: Any = None, chunks: Any = None, **named: Any) -> Any:
    """Return the outputs of a kernel over Dask arrays, as Dask arrays in the structure of its output. Nothing runs yet.

    The inputs are those of a call: Dask arrays (*S, N), or (*S,) for one component, with chunks along the axes of
    elements; host arrays, numbers, Params, Tables. They broadcast, and structs and several outputs work as for numpy
    arrays. `sh.grid_index` and `sh.grid_shape` are those of the whole array. Without any Dask array, `shape` and
    `chunks` are those of the elements. The kernel is sent with its Params' present values, and each worker compiles it
    once; a program is compiled for the default backend of the worker. A Table that is a Dask array, or a dict of them
    for a struct, is joined on each worker that needs it; `sh.gather` reads one whose chunks stay where they are.

    Raises ShpyTypeError, before anything runs, for shapes, dtypes and chunks that do not fit; ShpyError without Dask.
    """
    da = dask_array()
    _check_kernel(kernel)
    recorded = kernel.recorded
    precision = kernel.options.precision if isinstance(kernel, Kernel) else "f32"
    arguments = host.bind(recorded, arrays, named)
    check_hosted({**arguments, **recorded.tables}, "map_blocks")
    types = {n: t for n, t in recorded.inputs.items() if isinstance(t, TableType) and has_lazy(arguments[n])}
    joined = {name: whole_leaves(type_, arguments[name], name, precision) for name, type_ in types.items()}
    indexed = [name for name, t in recorded.inputs.items() if isinstance(t, TableType | TextureType)]
    tables = {name: arguments[name] for name in indexed if name not in types}
    for name, table in tables.items():
        check_whole(name, table, "a sh.Table, which takes one")
    inputs, cuts = {}, []
    for name, type_ in recorded.inputs.items():
        if not isinstance(type_, TableType | TextureType):
            entries = cut_leaves(type_, arguments[name], name, precision)
            inputs[name] = type_, [None if isinstance(entry, Cut) else entry for entry in entries]
            cuts += [entry for entry in entries if isinstance(entry, Cut)]
    whole = host.common_shape(cuts, shape)
    if shape is None and not any(cut.lazy for cut in cuts) and not (joined and cuts):
        raise _no_shape(recorded.module.name, joined)
    unified_arrays, sizes = unified(cuts, whole)
    if chunks is not None or any(not n or sum(n) != extent for n, extent in zip(sizes, whole, strict=True)):
        sizes = _chosen(sizes, whole, chunks, da)
    job = Blockwise(kernel, whole, inputs, tables, types)
    tails = [cut.array.ndim > len(cut.shape) for cut in cuts]
    return over_blocks(job, unified_arrays, tails, whole_places(sizes), sizes, recorded.output, precision, joined)


def _no_shape(name: str, joined: Mapping[str, Any]) -> ShpyTypeError:
    """Return the error for a run whose elements no Dask array counts; `joined` are those that are read as Tables."""
    if joined:
        return ShpyTypeError(
            f"{name} reads {', '.join(joined)} at any index, and no input tells how many elements there are",
            loc=here(),
            cure="shape= and chunks=, or sh.map_overlap for a stencil",
        )
    return ShpyTypeError(
        f"no input of {name} is a Dask array",
        loc=here(),
        cure="kernel(…), which runs here, or da.from_array(x, chunks=…); without inputs, shape= and chunks=",
    )


def _chosen(sizes: Chunks, whole: Shape, chunks: Any, da: Any) -> Chunks:
    """Return the chunks of all axes; `chunks` gives those of the axes along which no array has chunks."""
    try:
        asked = da.core.normalize_chunks("auto" if chunks is None else chunks, whole, dtype="float32")
    except (TypeError, ValueError, ZeroDivisionError) as error:
        reason = "a chunk has elements" if isinstance(error, ZeroDivisionError) else error  # Python's message varies
        raise ShpyTypeError(
            f"chunks={chunks!r} of the shape {whole}: {reason}", loc=here(), cure="chunks=(512, 512), one for each axis"
        ) from error
    open_axes = [not n or sum(n) != extent for n, extent in zip(sizes, whole, strict=True)]
    if chunks is not None and not all(open_axes):
        raise ShpyTypeError("chunks= beside arrays, which have their own", loc=here(), cure="x.rechunk(chunks)")
    return tuple(new if is_open else old for new, old, is_open in zip(asked, sizes, open_axes, strict=True))


def _check_kernel(kernel: Any) -> None:
    if isinstance(kernel, Kernel | Program):
        return
    cure = "sh.map_overlap(chain, {name: array})" if isinstance(kernel, Chain) else "@sh.program before the function"
    raise ShpyTypeError(f"sh.map_blocks takes a program or kernel, not {kernel!r}", loc=here(), cure=cure)
