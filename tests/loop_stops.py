"""A shader of its own that finds out whether the OpenGL driver stops long loops."""

import functools
import subprocess
import sys

from patience import HANGING

__all__ = ["stops_loops"]

SHADER = """
import moderngl, numpy as np
context = moderngl.create_context(standalone=True, backend="egl", require=330)
program = context.program(vertex_shader='''#version 330
void main() {
    gl_Position = vec4(4 * (gl_VertexID & 1) - 1, 2 * (gl_VertexID & 2) - 1, 0, 1);
}
''', fragment_shader='''#version 330
uniform int n;
out int x;
void main() {
    x = 1;
    for (int i = 0; i < n; i++)
        x = x * 1664525 + 1013904223;  // no compiler has a closed form of it
}
''')
program["n"] = 70_000
frame = context.framebuffer([context.texture((1, 1), 1, dtype="i4")])
frame.use()
context.vertex_array(program, []).render(moderngl.TRIANGLES, vertices=3)
x = 1
for _ in range(70_000):
    x = (x * 1664525 + 1013904223) % 2**32
print(int(np.frombuffer(frame.read(components=1, dtype="i4"), np.uint32)[0]) != x)
"""


@functools.cache
def stops_loops() -> bool:
    """Tell whether a loop of 70,000 iterations ends early, as in llvmpipe of Mesa 22.3: after 65,535, in silence."""
    ran = subprocess.run([sys.executable, "-c", SHADER], capture_output=True, text=True, timeout=HANGING, check=True)
    return ran.stdout.strip() == "True"
