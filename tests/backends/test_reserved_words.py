"""Words that a target keeps for itself, as names of everything that a user can name, on every backend."""

import keyword
import linecache
from typing import Any

import numpy as np
import pytest

import shpy as sh
from shpy.backend.emit.names import RESERVED, Names, Target

GLSL = """
const uniform buffer shared attribute varying coherent volatile restrict readonly writeonly atomic_uint layout
centroid flat smooth noperspective patch sample invariant precise break continue do for while switch case default if
else subroutine in out inout int void bool true false float double discard return vec2 vec3 vec4 ivec2 ivec3 ivec4
bvec2 bvec3 bvec4 uint uvec2 uvec3 uvec4 dvec2 dvec3 dvec4 mat2 mat3 mat4 mat2x2 mat2x3 mat2x4 mat3x2 mat3x3 mat3x4
mat4x2 mat4x3 mat4x4 dmat2 dmat3 dmat4 dmat2x2 dmat2x3 dmat2x4 dmat3x2 dmat3x3 dmat3x4 dmat4x2 dmat4x3 dmat4x4 lowp
mediump highp precision sampler1D sampler1DShadow sampler1DArray sampler1DArrayShadow isampler1D isampler1DArray
usampler1D usampler1DArray sampler2D sampler2DShadow sampler2DArray sampler2DArrayShadow isampler2D isampler2DArray
usampler2D usampler2DArray sampler2DRect sampler2DRectShadow isampler2DRect usampler2DRect sampler2DMS isampler2DMS
usampler2DMS sampler2DMSArray isampler2DMSArray usampler2DMSArray sampler3D isampler3D usampler3D samplerCube
samplerCubeShadow isamplerCube usamplerCube samplerCubeArray samplerCubeArrayShadow isamplerCubeArray
usamplerCubeArray samplerBuffer isamplerBuffer usamplerBuffer image1D iimage1D uimage1D image1DArray iimage1DArray
uimage1DArray image2D iimage2D uimage2D image2DArray iimage2DArray uimage2DArray image2DRect iimage2DRect
uimage2DRect image2DMS iimage2DMS uimage2DMS image2DMSArray iimage2DMSArray uimage2DMSArray image3D iimage3D
uimage3D imageCube iimageCube uimageCube imageCubeArray iimageCubeArray uimageCubeArray imageBuffer iimageBuffer
uimageBuffer struct sampler samplerShadow texture2DMSArray itextureBuffer subpassInput isubpassInput usubpassInputMS
common partition active asm class union enum typedef template this resource goto inline noinline public static
extern external interface long short half fixed unsigned superp input output hvec2 hvec3 hvec4 fvec2 fvec3 fvec4
filter sizeof cast namespace using sampler3DRect packed row_major image1DShadow image2DShadow image1DArrayShadow
image2DArrayShadow image2DRectShadow imageCubeShadow"""
"""Section 3.6 of GLSL 4.60, with what Vulkan adds, and the words that GLSL 3.30 reserves beyond these."""

OPENCL = """
auto break case char const continue default do double else enum extern float for goto if inline int long
register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while bool half
size_t ptrdiff_t intptr_t uintptr_t event_t sampler_t image2d_t image3d_t image2d_array_t image1d_t image1d_buffer_t
image1d_array_t queue_t ndrange_t clk_event_t reserve_id_t pipe global local constant private generic kernel
read_only write_only read_write uniform complex imaginary true false uchar ushort uint ulong quad typeof atomic_int
atomic_uint atomic_long atomic_ulong atomic_float atomic_double atomic_intptr_t atomic_uintptr_t atomic_size_t
atomic_ptrdiff_t atomic_flag memory_order memory_scope memory_order_acquire memory_order_seq_cst image2d_depth_t
image2d_array_depth_t image2d_msaa_t cl_mem_fence_flags half8 bool4 quad2 complex4 float4x4 double16x16
float2x2"""
"""Section 6.1.9 of OpenCL C 3.0 and the types of section 6.3."""


@pytest.mark.parametrize(("target", "words"), [("glsl", GLSL), ("opencl", OPENCL)])
def test_no_name_is_a_word_of_the_specification(target: Target, words: str) -> None:
    names = Names(target)
    given = {names.take(word) for word in words.split()}
    assert given.isdisjoint(words.split())


TABLES = ("packed", "row_major", "sampler2D", "kernel", "local", "lambda", "texture", "image2d_t")
INPUTS = ("row_major", "packed", "in_packed", "sample", "global", "filter", "half")

SUBROUTINE = """
@sh.subroutine
def {0}({1}: sh.Attrib1i) -> sh.Attrib1i:
    return {1} + {2}
"""


def program(words: list[str]) -> sh.Program:
    """Add up what has these names: inputs, variables, subroutines with their parameters, Params and Tables."""
    said = [w for w in words if not keyword.iskeyword(w) and w not in ("sh", "FUNCTIONS", "__debug__")]
    given = [w for w in INPUTS if not keyword.iskeyword(w)]
    lines = ["FUNCTIONS = []"]
    for k, (word, after) in enumerate(zip(said, said[1:] + said[:1], strict=True)):
        lines += [*SUBROUTINE.format(word, after, k).splitlines(), f"FUNCTIONS.append({word})"]
    lines += ["@sh.program", f"def main({', '.join(f'{w}: sh.Attrib1i' for w in given)}) -> sh.Attrib1i:"]
    lines += [f"    total_ = sh.Attrib1i({' + '.join(given)})"]
    said = [w for w in said if w not in given]
    lines += [f"    {word} = sh.Attrib1i(total_ + {k})" for k, word in enumerate(said)]
    lines += [f"    total_ += {word}" for word in said]
    lines += ["    for function_ in FUNCTIONS:", "        total_[:] = function_(total_)"]
    lines += ["    for param_ in PARAMS:", "        total_ ^= param_"]
    lines += ["    for table_ in TABLES_:", "        total_ += table_[total_]", "    return total_"]
    text = "\n".join(lines)
    file = "<reserved words>"
    linecache.cache[file] = (len(text), None, text.splitlines(True), file)
    scope: dict[str, Any] = {
        "sh": sh,
        "PARAMS": [sh.Param(sh.Attrib1i, k, name=word) for k, word in enumerate(words)],
        "TABLES_": [
            sh.Table(np.arange(k + 3, dtype=np.int32), sh.Attrib1i, name=word) for k, word in enumerate(TABLES)
        ],
    }
    exec(compile(text, file, "exec"), scope)
    made: sh.Program = scope["main"]
    return made


ALL = sorted(set().union(*RESERVED.values(), GLSL.split(), OPENCL.split()))
TARGETS = [("numpy", {}, 1), ("opencl", {"lanes": 1}, 1), ("opencl", {"lanes": 4}, 8), ("glsl", {}, 40)]


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("backend", "options", "run"), TARGETS, ids=["numpy", "opencl-1", "opencl-4", "glsl"])
def test_reserved_words_are_names_of_everything(backend: str, options: dict[str, Any], run: int) -> None:
    """Every word is compiled, on GLSL in parts, for Mesa takes minutes for 500 functions; one in `run` is run."""
    words = [w for w in ALL if w in RESERVED["python" if backend == "numpy" else backend]]
    if backend == "glsl":
        for part in range(8):
            program(words[part::8]).compile(backend)
    made = program(words[::run])
    inputs = [np.arange(5, dtype=np.int32) for _ in made.inputs]
    found = made.compile(backend, **options)(*inputs)
    assert np.array_equal(found, made.compile("numpy")(*inputs))
    assert len(set(found.tolist())) == 5
