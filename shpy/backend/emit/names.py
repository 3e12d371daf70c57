r"""Names: every string a user can choose becomes a short, legal, unique identifier of the target.

Stage: emit. Takes what a user called a thing (any text: a keyword, `gl_x`, `a;}`, ten thousand letters) and gives an
identifier that is nobody else's, so that nothing a user writes can change the meaning of the emitted text. A legal
name is kept. Names that begin with `sh_` are the printers' own.

>>> names = Names("glsl")
>>> names.take("radius"), names.take("radius"), names.take("sample"), names.take("θ"), names.take("a;}\nb")
('radius', 'radius_2', 'sample_', 'theta', 'a_b')
>>> names.take(None), names.take(None)
('t', 't2')
"""

from __future__ import annotations

import builtins
import keyword
import re
import unicodedata
from collections.abc import Iterable, Mapping
from typing import Final, Literal

Target = Literal["glsl", "opencl", "python"]

MAX_LENGTH: Final = 40
"""Longer names are cut: no target is asked for more, and nobody reads more."""


def _sized(stems: str, sizes: str) -> set[str]:
    return {stem + size for stem in stems.split() for size in sizes.split()}


_C = """auto bool break case char const continue default do double else enum extern false float for goto if inline int
long register restrict return short signed sizeof static struct switch true typedef union unsigned void volatile
while main NULL main0"""

# Keywords and reserved words of section 3.6 of GLSL 3.30 to 4.60 (`packed` and `row_major` are reserved up to 4.10
# only) and of section 3.7 of GLSL ES 3.00, with those of the extensions that the printer switches on.
_GLSL = """active asm atomic_uint attribute buffer cast centroid class coherent common discard external filter fixed
flat
fvec2 fvec3 fvec4 half highp hvec2 hvec3 hvec4 in inout input interface invariant layout lowp mediump namespace
noinline noperspective out output packed partition patch precise precision public readonly resource row_major sample
sampler2DRect sampler2DRectShadow sampler3DRect shared smooth subroutine superp template texture this uint
uniform using varying writeonly defined sampler samplerExternalOES samplerShadow subpassInput subpassInputMS
isubpassInput isubpassInputMS usubpassInput usubpassInputMS demote nullptr final"""
_GLSL_FUNCTIONS = """abs acos acosh all any asin asinh atan atanh atomicAdd atomicAnd atomicCompSwap atomicCounter
atomicExchange
atomicMax atomicMin atomicOr atomicXor barrier bitCount bitfieldExtract bitfieldInsert bitfieldReverse ceil
clamp cos cosh cross dFdx dFdxCoarse dFdxFine dFdy dFdyCoarse dFdyFine degrees determinant distance dot equal
exp exp2 faceforward findLSB findMSB floatBitsToInt floatBitsToUint floor fma fract frexp ftransform fwidth
fwidthCoarse fwidthFine greaterThan greaterThanEqual groupMemoryBarrier imageAtomicAdd imageLoad imageSamples
imageSize imageStore imulExtended intBitsToFloat interpolateAtCentroid interpolateAtOffset interpolateAtSample
inverse inversesqrt isinf isnan ldexp length lessThan lessThanEqual log log2 matrixCompMult max memoryBarrier
memoryBarrierShared min mix mod modf noise1 noise2 noise3 noise4 normalize not notEqual outerProduct
packDouble2x32 packHalf2x16 packSnorm2x16 packSnorm4x8 packUnorm2x16 packUnorm4x8 pow radians reflect refract
round roundEven shadow1D shadow1DLod shadow1DProj shadow2D shadow2DLod shadow2DProj sign sin sinh smoothstep
sqrt step tan tanh texelFetch texelFetchOffset texture texture1D texture1DLod texture1DProj texture2D
texture2DLod texture2DProj texture2DProjLod texture2DRect texture2DRectProj texture3D texture3DLod texture3DProj
textureCube textureCubeLod textureGather textureGatherOffset textureGatherOffsets textureGrad textureGradOffset
textureLod textureLodOffset textureOffset textureProj textureProjGrad textureProjGradOffset textureProjLod
textureProjLodOffset textureProjOffset textureQueryLevels textureQueryLod textureSamples textureSize transpose
trunc uaddCarry uintBitsToFloat umulExtended unpackDouble2x32 unpackHalf2x16 unpackSnorm2x16 unpackSnorm4x8
unpackUnorm2x16 unpackUnorm4x8 usubBorrow EmitVertex EndPrimitive"""
_GLSL_DIMENSIONS = """1D 2D 3D Cube 2DRect 1DArray 2DArray Buffer 2DMS 2DMSArray CubeArray 1DShadow 2DShadow
CubeShadow 2DRectShadow
1DArrayShadow 2DArrayShadow CubeArrayShadow"""

# OpenCL C 1.2 and 3.0, sections 6.1 (types), 6.9 (keywords) and 6.12 or 6.15 (functions).
_OPENCL = """complex event_t clk_event_t constant generic global half image1d_array_t image1d_buffer_t image1d_t
image2d_array_depth_t image2d_array_msaa_depth_t image2d_array_msaa_t image2d_array_t image2d_depth_t
image2d_msaa_depth_t image2d_msaa_t image2d_t image3d_t imaginary intptr_t kernel local ndrange_t pipe private
ptrdiff_t quad queue_t read_only read_write reserve_id_t sampler_t size_t typeof uintptr_t uniform write_only
asm linux unix memory_order memory_scope"""
_OPENCL_FUNCTIONS = """abs abs_diff acos acosh acospi add_sat all any asin asinh asinpi async_work_group_copy
async_work_group_strided_copy atan atan2 atan2pi atanh atanpi barrier bitselect cbrt ceil clamp clz copysign cos
cosh cospi cross ctz degrees distance dot enqueue_kernel erf erfc exp exp10 exp2 expm1 fabs fast_distance
fast_length fast_normalize fdim floor fma fmax fmin fmod fract frexp get_default_queue get_enqueued_local_size
get_fence get_global_id get_global_linear_id get_global_offset get_global_size get_group_id
get_image_channel_data_type get_image_channel_order get_image_depth get_image_dim get_image_height
get_image_width get_local_id get_local_linear_id get_local_size get_num_groups get_work_dim hadd hypot ilogb
isequal isfinite isgreater isgreaterequal isinf isless islessequal islessgreater isnan isnormal isnotequal
isordered isunordered ldexp length lgamma lgamma_r log log10 log1p log2 logb mad mad24 mad_hi mad_sat max maxmag
mem_fence min minmag mix modf mul24 mul_hi nan nextafter normalize popcount pow pown powr prefetch printf
radians read_imagef read_imagei read_imageui read_mem_fence remainder remquo rhadd rint rootn rotate round rsqrt
select shuffle shuffle2 sign signbit sin sincos sinh sinpi smoothstep sqrt step sub_sat tan tanh tanpi tgamma
trunc upsample vec_step wait_group_events work_group_barrier write_imagef write_imagei write_imageui
write_mem_fence ndrange_1D ndrange_2D ndrange_3D to_global to_local to_private offsetof va_arg va_end va_start"""
_OPENCL_MACROS = """INFINITY NAN HUGE_VAL HUGE_VALF MAXFLOAT CHAR_BIT CHAR_MAX CHAR_MIN INT_MAX INT_MIN LONG_MAX
LONG_MIN SCHAR_MAX
SCHAR_MIN SHRT_MAX SHRT_MIN UCHAR_MAX UINT_MAX ULONG_MAX USHRT_MAX FP_ILOGB0 FP_ILOGBNAN FP_FAST_FMA
FP_FAST_FMAF FP_CONTRACT ALIGN4 ALIGN8 INTTYPE MAX_WORK_DIM MAX_KERNEL_ARGS"""
_OPENCL_PREFIXES = """as_ convert_ vload vstore atom_ atomic_ memory_order_ memory_scope_
native_ half_ async_ sub_group_ work_group_ intel_ cl_
CL_ CLK_ M_ FLT_
DBL_ HALF_ ATOMIC_ image1d_ image2d_ image3d_ read_image write_image POCL_ LLVM_ CLANG_ SPIR_ IMG_"""

RESERVED: Final[Mapping[Target, frozenset[str]]] = {
    "glsl": frozenset(
        {*_C.split(), *_GLSL.split(), *_GLSL_FUNCTIONS.split()}
        | _sized("vec ivec uvec bvec dvec mat dmat", "2 3 4 2x2 2x3 2x4 3x2 3x3 3x4 4x2 4x3 4x4")
        | _sized("sampler isampler usampler image iimage uimage texture itexture utexture", _GLSL_DIMENSIONS)
    ),
    "opencl": frozenset(
        {*_C.split(), *_OPENCL.split(), *_OPENCL_FUNCTIONS.split(), *_OPENCL_MACROS.split()}
        | _sized("char uchar short ushort int uint long ulong half float double bool quad complex", "2 3 4 8 16 32 64")
        | {f"{base}{n}x{m}" for base in ("float", "double") for n in (2, 4, 8, 16) for m in (2, 4, 8, 16)}
        | {"uchar", "ushort", "uint", "ulong"}
    ),
    "python": frozenset({*keyword.kwlist, *keyword.softkwlist, *dir(builtins), "np", "self"}),
}
"""Words that a target keeps for itself: keywords, types, functions and macros."""

_PREFIXES: Final[Mapping[Target, tuple[str, ...]]] = {
    "glsl": ("sh_", "gl_", "webgl_", "_webgl_"),
    "opencl": ("sh_", *_OPENCL_PREFIXES.split()),
    "python": ("sh_",),
}


class Names:
    """The names that are taken in one scope of the emitted text. `scope` opens an inner one."""

    def __init__(self, target: Target, used: Iterable[str] = (), outer: Names | None = None) -> None:
        self.target = target
        self.outer = outer
        self._used = set(used)
        self._next: dict[str, int] = {}

    def scope(self) -> Names:
        """Open a scope inside this one: names taken here, now or later, are taken there, not the other way round."""
        return Names(self.target, outer=self)

    def reserve(self, name: str) -> None:
        """Mark a name as used."""
        self._used.add(name)

    def __contains__(self, name: str) -> bool:
        return name in self._used or (self.outer is not None and name in self.outer)

    def _count(self, stem: str) -> int:
        """Return the last number that was put behind the stem here, or in a scope around this one."""
        return self._next.get(stem) or (self.outer._count(stem) if self.outer else 1)

    def take(self, wish: str | None, default: str = "t") -> str:
        """Take an identifier as close to `wish` as the target allows.

        `default` stands for a name that is missing or has no letter or digit in it; it must itself be legal.
        """
        stem = legal(wish, self.target) if wish else ""
        base = f"{stem.rstrip('_')}_" if stem else default
        if stem and base.startswith(_PREFIXES[self.target]):
            base = stem  # `M_2` would begin as the target's own names do; `M2` does not
        stem = stem or default
        name = stem
        count = self._count(stem)
        while name in self or name in RESERVED[self.target]:
            count += 1
            name = f"{base}{count}"
        self._next[stem] = count
        self._used.add(name)
        return name


def legal(wish: str, target: Target) -> str:
    """Return `wish` as a legal identifier of `target` that is not reserved; '' if it has no letter or digit."""
    text = "".join(map(_spelled, unicodedata.normalize("NFKD", wish[: 4 * MAX_LENGTH])))
    text = re.sub(r"_+", "_", re.sub(r"[^A-Za-z0-9]", "_", text))
    if text == "_":
        return ""
    if wish.isascii() and wish.isidentifier():
        text = text[:MAX_LENGTH]
    else:
        text = text.strip("_")[:MAX_LENGTH]
    text = text if len(text) < MAX_LENGTH else text.rstrip("_")
    if text[:1].isdigit() or re.match("_[A-Z0-9]", text):
        text = "n" + text
    if text in RESERVED[target]:
        text = f"{text}_"
    return f"my_{text.strip('_')}" if text.startswith(_PREFIXES[target]) else text


def _spelled(character: str) -> str:
    """Drop an accent, spell out a Greek letter, and replace any other character by an underscore."""
    if character.isascii():
        return character
    if unicodedata.combining(character):
        return ""
    words = unicodedata.name(character, "").split()
    if words[:1] == ["GREEK"] and words[2:3] == ["LETTER"] and len(words) == 4:
        letter = words[3].replace("LAMDA", "LAMBDA")
        return letter.lower() if words[1] == "SMALL" else letter.capitalize()
    return "_"
