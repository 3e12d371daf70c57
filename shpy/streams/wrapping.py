"""Find the backend, shape and type of a stream over an array or texture of another library.

Stage: run.

    owner_of(array)               # "numpy"
    extents_of(array, None)       # ((4,), Attrib3f, "f32") for a float32 array (4, 3)
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from shpy.errors import ShpyTypeError
from shpy.ir.types import Base
from shpy.lang.data.hostdata import refuse_masked
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Leaf, layout_of
from shpy.lang.values.value import CLASSES
from shpy.passes.modes import Precision

Shape = tuple[int, ...]
_PRECISIONS: Final[dict[Any, Precision]] = {np.dtype(np.float64): "f64", np.dtype(np.float16): "f16"}
"""The working precisions by the dtypes of floats; a texture's floats have 32 bits."""


def owner_of(native: Any, backend: str | None = None) -> str:
    """Return the backend of the library that an array or texture belongs to; ShpyTypeError for anything else.

    A `backend` that is not None has to be that one. A masked array is an error, too.
    """
    refuse_masked(native, "the array")
    modules = [cls.__module__.partition(".")[0] for cls in type(native).__mro__]
    backends = {"numpy": "numpy", "pyopencl": "opencl", "moderngl": "glsl", "mgl": "glsl"}
    module = next((m for m in modules if m in backends), None)
    if module is None:
        raise ShpyTypeError(
            f"{type(native).__name__} is no memory that a stream can have",
            loc=here(),
            cure="a numpy array, a pyopencl.array.Array or a moderngl.Texture; or sh.Stream(array, type)",
        )
    owner = backends[module]
    if backend not in (None, owner):
        raise ShpyTypeError(
            f"{type(native).__name__} is memory of {owner}, which {backend} cannot share",
            loc=here(),
            cure=f"sh.Stream(array, type, {backend!r}), which copies",
        )
    return owner


def extents_of(native: Any, type_: Any) -> tuple[Shape, Any, Precision]:
    """Return the element shape of a library's array or texture, the type of an element, and the working precision.

    Raises ShpyTypeError where no type has such elements, and for a type of several leaves.
    """
    if type_ is not None and not isinstance(layout_of(type_, "a stream"), Leaf):
        raise ShpyTypeError(
            f"one array or texture is the memory of scalars or vectors, and {type_.__name__} has several leaves",
            loc=here(),
            cure="sh.Stream(array, type), which copies",
        )
    if hasattr(native, "components"):
        width, height = native.size
        base: Any = {"f": Base.F, "i": Base.I, "u": Base.U}.get(native.dtype[0])
        shape, size = (height, width), native.components
    else:
        base = {"f": Base.F, "i": Base.I, "u": Base.U, "b": Base.B}.get(native.dtype.kind)
        whole = tuple(native.shape)
        components = type_.type.size if type_ is not None else None
        size = components or (whole[-1] if len(whole) > 1 and whole[-1] in (2, 3, 4) else 1)
        shape = whole[:-1] if size > 1 else whole
    element = type_ if type_ is not None else CLASSES.get(("Attrib", size, base))
    if element is None:
        spoken = f"{size} components of {native.dtype}" if size > 1 else f"{native.dtype}"
        raise ShpyTypeError(
            f"no type has elements of {spoken}",
            loc=here(),
            cure="an array of float32, float64, float16, int32, uint32 or bool, of at most 4 components",
        )
    if element.type.size != size:
        raise ShpyTypeError(
            f"this memory holds elements of {size} components, which is no {element.__name__}",
            loc=here(),
            cure="a type of as many components, or sh.Stream(array, type), which copies",
        )
    precision = _PRECISIONS.get(native.dtype, "f32") if element.base is Base.F else "f32"
    return shape, element, precision
