"""A hybrid renderer: OpenGL draws what the eye sees, the ray tracer adds the shadows and mirrors.

The rasteriser (moderngl) fills a G-buffer: a position, a normal, the number of the mesh and uv coordinates in each
pixel. `render(scene, primary=...)` takes it for the hits of the eye rays.

    python examples/raster.py [numpy|opencl|glsl]
"""

import sys

import moderngl
import numpy as np

from raytracer import GBuffer, Scene, render

VERTEX = """#version 330
uniform mat4 view;
in vec3 place; in vec3 normal; in vec2 uv;
out vec3 at; out vec3 n; out vec2 tex;
void main() { at = place; n = normal; tex = uv; gl_Position = view * vec4(place, 1.0); }"""
FRAGMENT = """#version 330
uniform int mesh;
in vec3 at; in vec3 n; in vec2 tex;
layout(location = 0) out vec4 position; layout(location = 1) out vec4 normal; layout(location = 2) out vec4 uv;
void main() { position = vec4(at, 1.0); normal = vec4(n, 0.0); uv = vec4(tex, float(mesh), 0.0); }"""


def projection(scene, width, height):
    """Return the matrix (4, 4) that takes points of the scene to OpenGL's clip coordinates."""
    eye, corner, across, down = scene.camera.view(width, height)
    forward = corner + across * width / 2 + down * height / 2
    far = max(((mesh.vertices - eye) @ forward).max() for mesh in scene.meshes) / (forward @ forward) * 1.01
    near = far / 1e3
    rows = [2 * across / (across @ across) / width, -2 * down / (down @ down) / height, forward / (forward @ forward)]
    matrix = np.zeros((4, 4))
    matrix[:2, :3], matrix[3, :3] = rows[:2], rows[2]
    matrix[2, :3] = rows[2] * (far + near) / (far - near)
    matrix[:, 3] = matrix[:, :3] @ -eye
    matrix[2, 3] -= 2 * far * near / (far - near)
    return matrix


def rasterise(scene, size):
    """Return the G-buffer of a scene, drawn by OpenGL without a window."""
    gl = moderngl.create_context(standalone=True, require=330, backend="egl")
    layers = [gl.texture(size, 4, dtype="f4") for _ in range(3)]
    gl.framebuffer(layers, gl.depth_renderbuffer(size)).use()
    gl.clear(0.0, 0.0, -1.0)  # the blue channel of the third layer is the number of the mesh
    gl.enable(moderngl.DEPTH_TEST | moderngl.CULL_FACE)  # at the rim of a mesh its back is as near as its front
    program = gl.program(VERTEX, FRAGMENT)
    program["view"].write(projection(scene, *size).T.astype("f4").tobytes())
    for number, mesh in enumerate(scene.meshes):
        normals = np.repeat(mesh.face_normals[:, None], 3, axis=1) if mesh.normals is None else mesh.normals
        uv = np.zeros((len(mesh), 3, 2)) if mesh.uv is None else mesh.uv
        program["mesh"] = number
        vertices = gl.buffer(np.concatenate([mesh.corners, normals, uv], axis=-1).astype("f4"))
        gl.vertex_array(program, vertices, "place", "normal", "uv").render(moderngl.TRIANGLES)
    position, normal, uv = (np.frombuffer(layer.read(), "f4").reshape(*size[::-1], 4)[::-1] for layer in layers)
    gl.release()  # its rows begin at the bottom
    return GBuffer(position[..., :3], normal[..., :3], uv[..., 2].astype(int), uv[..., :2])


if __name__ == "__main__":
    scene = Scene.builtin("boxes")
    picture = render(scene, primary=rasterise(scene, (480, 360)), backend=sys.argv[1] if len(sys.argv) > 1 else None)
    picture.save("raster.png")
    print(f"wrote raster.png: 480 x 360, {picture.stats.rays:,} rays of {picture.object_id.size:,} pixels")
