"""Shaders that tell the faults of a device: what they draw is compared with exact results.

Stage: run. Each draws one question; `context.py` asks them when a device is first used.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np

from shpy.backend.glsl.text.prologue import VERSION
from shpy.passes.formulas.strict.coefficients import STRICT_FAR_DIGITS, STRICT_INVERSE_PI, STRICT_SIN

# The operations that a device may get wrong.
PROBE: Final = f"""\
{VERSION}#ifndef GL_ARB_gpu_shader5
#define fma(a, b, c) 0.0
#endif
uniform sampler2D triples;
layout(location = 0) out vec4 first;
layout(location = 1) out vec4 second;
void main() {{
    vec4 p = texelFetch(triples, ivec2(gl_FragCoord.xy), 0);
    precise vec4 found = vec4(p.x + p.y, p.x - p.y, p.x * p.y, p.x / p.y);
    first = found;
    precise float fused = fma(p.x, p.y, p.z);
    second = vec4(sqrt(p.x), floor(p.x), float(int(min(p.x, 16777215.0))), fused);
}}
"""


def _question(body: str) -> str:
    """Return a shader whose variables may be `precise` where the device has that."""
    return f"{VERSION}layout(location = 0) out vec4 answer;\n{body}"


# A loop whose second exit never holds, as it follows `v += 1`.
EXITS: Final = _question("""\
void main() {
    int v = 0;
    float left = 5.0;
    while (v < 4) {
        v += 1;
        if (v < 1) {
            left = 0.0;
            break;
        }
    }
    answer = vec4(left);
}
""")

# A choice in a function, whose comparison is false, as NaN is less than nothing.
CHOICES: Final = _question("""\
float larger(precise vec4 v) {
    precise float result = v.x < v.y ? v.y : v.x;
    return result;
}
void main() {
    precise vec4 v = uintBitsToFloat(uvec4(0x7fc00000u + uint(gl_FragCoord.x), 0x40000000u, 0u, 0u));
    answer = vec4(isnan(larger(v)) ? 1.0 : 0.0);
}
""")

# A choice of -0.0, whose product with -1.0 is 0.0: `zero` would be as good a maximum, but for its sign.
SIGNS: Final = _question("""\
void main() {
    uint unknown = uint(min(int(gl_FragCoord.x), 0));
    precise float x = uintBitsToFloat(0x80000000u + unknown);
    precise float zero = float(unknown);
    precise bool greater = x >= zero;
    precise float chosen = greater ? x : zero;
    precise float product = -1.0 * chosen;
    answer = vec4(floatBitsToUint(product) == 0u ? 1.0 : 0.0);
}
""")

# A comparison whose negation holds, as NaN is not less than anything.
NEGATIONS: Final = _question("""\
void main() {
    precise float x = uintBitsToFloat(0x7fc00000u + uint(gl_FragCoord.x));
    float other = 0.0;
    precise bool less = x < 2.5;
    if (!less) {
        other = 1.0;
    }
    answer = vec4(other);
}
""")

# Operations of binary64, whose results leave as the bits of two numbers a texel.
DOUBLES: Final = """\
#version 330 core
#extension GL_ARB_gpu_shader5 : enable
#extension GL_ARB_gpu_shader_fp64 : require
uniform sampler2D triples;
layout(location = 0) out uvec4 products;
layout(location = 1) out uvec4 sums;
layout(location = 2) out uvec4 others;
layout(location = 3) out uvec4 narrowed;
void main() {
    vec4 p = texelFetch(triples, ivec2(gl_FragCoord.xy), 0);
    precise double a = double(p.x);
    precise double x = a * double(p.y);
    precise double y = x * double(p.z);
    precise double quotient = x / y, sum = x + y, difference = a - y, root = sqrt(x), whole = floor(a * 0.3lf);
    precise double wide = p.z < 0.0 ? a * 1.5lf : x;
    products = uvec4(unpackDouble2x32(y), unpackDouble2x32(quotient));
    sums = uvec4(unpackDouble2x32(sum), unpackDouble2x32(difference));
    others = uvec4(unpackDouble2x32(root), unpackDouble2x32(whole));
    narrowed = uvec4(floatBitsToUint(float(wide)), 0u, 0u, 0u);
}
"""

# A square root of binary64 that the prologue corrects: for NVIDIA 580.159, and goes when a later one is right.
ROOTS: Final = """\
#version 330 core
#extension GL_ARB_gpu_shader5 : enable
#extension GL_ARB_gpu_shader_fp64 : require
uniform sampler2D triples;
layout(location = 0) out uvec4 roots;
PROLOGUE
void main() {
    vec4 p = texelFetch(triples, ivec2(gl_FragCoord.xy), 0);
    precise double x = double(p.x) * double(p.y);
    precise double root = sh_sqrt(x);
    roots = uvec4(unpackDouble2x32(root), 0u, 0u);
}
"""

_FLOATS: Final = (4.4709815e-38, 9.8848554e-33, -86.000626, 6.1870016e29, 1.1920929e-07, 0.99999905, 3.4028235e38)


def _decimals(extension: str, comparisons: Iterable[str]) -> str:
    lines = "\n".join(f"    same = same && {comparison};" for comparison in comparisons)
    main = f"void main() {{\n    bool same = true;\n{lines}\n    answer = vec4(same ? 1.0 : 0.0);\n}}\n"
    return f"{VERSION}{extension}layout(location = 0) out vec4 answer;\n{main}"


def decimal_floats() -> str:
    """Return a shader that compares decimal numbers of binary32 with their bits; it draws 1 where all are equal."""
    numbers = np.array(_FLOATS, np.float32)
    return _decimals("", (f"floatBitsToUint({x}) == 0x{x.view(np.uint32):08x}u" for x in numbers))


def decimal_doubles() -> str:
    """Return the same for binary64, with digits of 1 / pi, all of whose bits count in far angles."""
    numbers = [x for digits in (STRICT_INVERSE_PI, *STRICT_FAR_DIGITS, STRICT_SIN) for x in digits]
    bits = np.array(numbers).view(np.uint32).reshape(-1, 2).tolist()
    return _decimals(
        "#extension GL_ARB_gpu_shader_fp64 : require\n",
        (
            f"unpackDouble2x32({x!r}lf) == uvec2(0x{low:08x}u, 0x{high:08x}u)"
            for x, (low, high) in zip(numbers, bits, strict=True)
        ),
    )


QUESTIONS: Final = {
    # llvmpipe of Mesa 22.3: see FAULTS.
    "exits": (EXITS, [5] * 8),
    # llvmpipe and zink of Mesa 25.0 and 26.1; goes when Debian 13 and 14 are right.
    "choices": (CHOICES, [1] * 8),
    # NVIDIA 580.159; goes when a later one is right.
    "negations": (NEGATIONS, [1] * 8),
    # llvmpipe and zink of Mesa 26.1; goes when Debian 14 is right.
    "signs": (SIGNS, [1] * 8),
    # NVIDIA 580.159 by its results, not by this question yet; goes, with `decimal_doubles`, when that draws 1.
    "decimals": (decimal_floats(), [1] * 8),
}
"""By fault, the shader that shows it, and what a device without the fault draws for eight elements."""
