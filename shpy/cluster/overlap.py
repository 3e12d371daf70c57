"""sh.map_overlap: a stencil over Dask arrays, several steps for each exchange of halos.

Stage: cluster. A block gets a halo of its neighbours' elements, as wide as the stencil reaches in all steps, and
computes the halo as well. After each step fewer elements of the halo are right; after the last one exactly those of the
block are. At the border of the array a block has no halo, so that reads are clamped there in each step, as in a run
over the whole array.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from shpy.chains.chain import Chain, Repeat, Sequence, sequence
from shpy.chains.member import RUN_ARGUMENTS, Member, element_layout, is_gathered, stream_names
from shpy.cluster.arrays import Cut, check_hosted, check_whole, cut_leaves, dask_array, has_lazy, unified
from shpy.cluster.graphs import over_blocks
from shpy.cluster.jobs import Stencil, cut_tables
from shpy.errors import ShpyTypeError
from shpy.ir.constants import is_int
from shpy.ir.traverse import grid_rank
from shpy.lang.data.textures import TextureType
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Group, Layout
from shpy.passes.pipeline import optimise
from shpy.passes.reach import Reach, reach
from shpy.programs import Program
from shpy.run.kernel import Kernel
from shpy.streams.elements import Shape


def map_overlap(chain: Chain | Kernel | Program, streams: Mapping[str, Any], *, steps: int = 1) -> dict[str, Any]:
    """Return the streams that `steps` executions of a chain or kernel write, as Dask arrays by name. Nothing runs yet.

    `streams` are those of `Chain.run`. Dask arrays (*S, N) of one shape S are cut into blocks, and so are host arrays
    that are written or read by element. Numbers, Params and Tables are sent to each worker whole. A kernel reads a Dask
    array at `sh.grid_index` plus constants: the halo is the largest of these times `steps`. The index and
    `sh.grid_shape` are those of the whole array. Reads beyond it give its border in every step, or its other end where
    the index is `% sh.grid_shape`, so the bits are those of one run for any chunks. More steps exchange less often, and
    compute a wider halo twice.

    Raises ShpyTypeError, before anything runs, for shapes and chunks that do not fit, for a `sh.loop`, whose end
    depends on all elements, and for an index without a known distance from the element; ShpyError without Dask.
    """
    dask_array()
    whole = _checked(chain, steps)
    check_hosted(streams, "map_overlap")
    _check_names(whole, streams)
    outputs = {name: layout for kernel in whole.kernels for name, layout in kernel.outputs}
    precision = next((m.kernel.options.precision for m in whole.kernels if isinstance(m.kernel, Kernel)), "f32")
    cut_streams = _cut_streams(whole, streams, outputs, precision)
    layouts = {name: layout for name, (layout, _) in cut_streams.items()}
    cuts = [cut for _, entries in cut_streams.values() for cut in entries]
    shape = _common(cuts, whole)
    constant = {name: value for name, value in streams.items() if name not in layouts}
    unified_arrays, chunks = unified(cuts, shape)
    if not all(shape):
        return {name: streams[name] for name in outputs if name in streams}
    reaches = [_reach(kernel, {*layouts, *outputs}, len(shape)) for kernel in whole.kernels]
    distance, wraps, clamps = _joined(whole, iter(reaches))
    depth = [steps * n for n in distance]
    _check_borders(whole, shape, depth, wraps, clamps)
    wide = [_widened(sizes, n) for sizes, n in zip(chunks, depth, strict=True)]
    arrays = [_extended(array, wide, depth, wraps) for array in unified_arrays]
    job = Stencil(whole, steps, shape, layouts, constant, outputs, wraps, [each.distance for each in reaches])
    places = [_places(sizes, n, wrap) for sizes, n, wrap in zip(wide, depth, wraps, strict=True)]
    group = Group("dict", tuple(outputs), tuple(outputs.values()))
    tails = [cut.array.ndim > len(cut.shape) for cut in cuts]
    result: dict[str, Any] = over_blocks(job, arrays, tails, places, tuple(wide), group, precision)
    return result


def _checked(chain: Any, steps: Any) -> Chain:
    """Return the chain; raise ShpyTypeError for anything else, for loops, and unless `steps` is a positive int."""
    if not is_int(steps) or steps < 1:
        raise ShpyTypeError(f"steps={steps!r} is no number of executions", loc=here(), cure="steps=8")
    whole: Chain = chain if isinstance(chain, Chain) else sequence(chain)
    for node in _nodes(whole):
        if not isinstance(node, Member | Sequence | Repeat):
            raise ShpyTypeError(
                f"{node} ends when no element of the whole array writes, which a block cannot know",
                loc=here(),
                cure="sh.repeat(step, n), or rounds of sh.map_overlap until the array of a count is zero",
            )
    return whole


def _nodes(node: Any) -> Any:
    yield node
    for member in getattr(node, "members", ()):
        yield from _nodes(member)


def _check_names(chain: Chain, streams: Mapping[str, Any]) -> None:
    names = stream_names(chain.steps)
    for name in streams:
        if name not in names:
            raise ShpyTypeError(f"{name} is no stream of {chain}", loc=here(), cure=f"one of {', '.join(names)}")
    missing = [name for name in chain.inputs if name not in streams and name not in RUN_ARGUMENTS]
    if missing:
        arguments = (*streams, *missing)
        raise ShpyTypeError(
            f"{chain} lacks {', '.join(missing)}",
            loc=here(),
            cure=f"sh.map_overlap(chain, {{{', '.join(f'{n!r}: {n}' for n in arguments)}}})",
        )


def _cut_streams(
    chain: Chain, streams: Mapping[str, Any], outputs: Mapping[str, Layout], precision: str
) -> dict[str, tuple[Layout, list[Cut]]]:
    """Return the layout and leaves of each stream that is cut: one that is written, or read as an array of elements."""
    cut_streams: dict[str, tuple[Layout, list[Cut]]] = {}
    for name, value in streams.items():
        types = [step.inputs[name] for step in chain.steps if name in step.inputs]
        by_element = [type_ for type_ in types if not is_gathered(type_)]
        if any(isinstance(type_, TextureType) for type_ in types):
            check_whole(name, value, "a sh.Table, which is read at an index")
        layout = element_layout((by_element or types)[0]) if types else outputs[name]
        entries = cut_leaves(layout, value, name, precision) if name in outputs or by_element or has_lazy(value) else []
        if any(isinstance(entry, Cut) for entry in entries):
            if not all(isinstance(entry, Cut) for entry in entries):
                raise ShpyTypeError(
                    f"some parts of {name} are arrays, and others numbers", loc=here(), cure="an array for each part"
                )
            cut_streams[name] = layout, entries
    return cut_streams


def _common(cuts: list[Cut], chain: Chain) -> Shape:
    """Return the shape of the elements of all arrays; ShpyTypeError where they differ."""
    if not any(cut.lazy for cut in cuts):
        raise ShpyTypeError(
            "no stream is a Dask array", loc=here(), cure="chain.run(…), which runs here, or da.from_array(x, chunks=…)"
        )
    if len({cut.shape for cut in cuts}) > 1:
        listed = ", ".join(f"{cut.name} {cut.shape}" for cut in cuts)
        raise ShpyTypeError(f"arrays that are cut have one shape, not {listed}", loc=here(), cure="arrays of one shape")
    shape = cuts[0].shape
    for kernel in chain.kernels:
        rank = grid_rank(kernel.recorded.module)
        if rank not in (None, len(shape)):
            raise ShpyTypeError(
                f"{kernel.name} uses grid_index({rank}), and the arrays have {len(shape)} axes of elements",
                loc=here(),
                cure=f"arrays of {rank} axes",
            )
    return shape


def _reach(kernel: Member, cut: set[str], rank: int) -> Reach:
    """Return how far a kernel reads the streams `cut` on each axis."""
    # Optimised: an index that is stored component by component is one expression then.
    module = optimise(kernel.recorded.module, fixed=False)
    return reach(module, cut_tables(kernel.recorded, cut), rank)


def _joined(node: Any, reaches: Iterator[Reach]) -> Reach:
    """Return how far one execution of a part of a chain reaches; `reaches` are those of its kernels in order."""
    if isinstance(node, Member):
        return next(reaches)
    distances, wraps, clamps = zip(*(_joined(member, reaches) for member in node.members), strict=True)
    times = node.times if isinstance(node, Repeat) else 1
    return Reach(
        tuple(times * sum(each) for each in zip(*distances, strict=True)),
        tuple(map(any, zip(*wraps, strict=True))),
        tuple(map(any, zip(*clamps, strict=True))),
    )


def _check_borders(chain: Chain, shape: Shape, depth: list[int], wraps: Any, clamps: Any) -> None:
    """Raise ShpyTypeError for reads that wrap around and clamp along one axis, and for those farther than the axis."""
    for axis, n in enumerate(shape):
        if wraps[axis] and clamps[axis]:
            raise ShpyTypeError(
                f"{chain} reads across the border of axis {axis} both modulo its length and clamped",
                loc=here(),
                cure="% sh.grid_shape(n) in all indices, or in none",
            )
        if wraps[axis] and depth[axis] > n:
            raise ShpyTypeError(
                f"all steps read {depth[axis]} elements along axis {axis}, which has {n}, and wrap around",
                loc=here(),
                cure="fewer steps, several times, or sh.repeat(program, steps).run(...) without Dask",
            )


def _widened(sizes: tuple[int, ...], depth: int) -> tuple[int, ...]:
    """Join neighbouring chunks of an axis until each is as long as the halo; return their sizes."""
    lengths: list[int] = []
    for size in sizes:
        if lengths and (lengths[-1] < depth or not lengths[-1]):
            lengths[-1] += size
        else:
            lengths.append(size)
    if len(lengths) > 1 and lengths[-1] < max(depth, 1):
        lengths[-2:] = [lengths[-2] + lengths[-1]]
    return tuple(lengths)


def _extended(array: Any, chunks: list[tuple[int, ...]], depth: list[int], wraps: Any) -> Any:
    """Return an array whose blocks have halos: the other end of the array at a border that wraps around, else none."""
    rank = len(chunks)
    cut = array.rechunk(dict(enumerate(chunks)))
    halo = {axis: n if len(chunks[axis]) > 1 or wraps[axis] else 0 for axis, n in enumerate(depth)} | {
        axis: 0 for axis in range(rank, array.ndim)
    }
    if not any(halo.values()):
        return cut
    border = {axis: "periodic" if axis < rank and wraps[axis] else "none" for axis in halo}
    return dask_array().overlap.overlap(cut, depth=halo, boundary=border, allow_rechunk=False)


def _places(sizes: tuple[int, ...], depth: int, wrap: bool) -> list[tuple[int, int, int]]:
    """Return where each block with its halo begins, and the part of it that is the block's own."""
    starts = np.cumsum((0, *sizes)).tolist()
    before = [depth if wrap else min(depth, start) for start in starts[:-1]]
    return [(start - b, b, b + n) for start, b, n in zip(starts[:-1], before, sizes, strict=True)]
