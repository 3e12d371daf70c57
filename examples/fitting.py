"""Fit a texture of few texels to a picture: 60 steps along the gradient of the error by the texels.

Every backend computes the same bits, so it finds the same texture: python examples/fitting.py [numpy|opencl|glsl]
"""

import sys

import numpy as np
from pictures import save

import shpy as sh

TEXELS, STEPS = 24, 60

sheet = sh.Texture2D(np.zeros((TEXELS, TEXELS, 3)), name="sheet")


@sh.program
def picture(uv: sh.TexCoord2f) -> sh.Color3f:
    """Draw rings that noise bends."""
    p = uv * 2
    bent = p + sh.vec2(sh.library.fbm(p, octaves=2), sh.library.fbm(p + 9, octaves=2))
    return sh.Color3f(0.5 + 0.45 * sh.cos(6 * sh.length(bent - sh.vec2(0.9, 1.2)) + sh.vec3(0, 0.5, 1.1)))


@sh.program
def shown(uv: sh.TexCoord2f) -> sh.Color3f:
    return sheet(uv)


@sh.program
def misfit(uv: sh.TexCoord2f, target: sh.Color3f) -> sh.Attrib1f:
    d = shown(uv) - target
    return sh.dot(d, d)


def fitted(size, steps, backend=None):
    """Return the picture of size x size pixels, the texture's pictures after some steps, and the error of each step."""
    rows, columns = np.indices((size, size))
    places = sh.Stream((np.stack([columns, rows], axis=-1) + 0.5) / size, sh.TexCoord2f, backend)
    target = picture(places)
    panels, errors = [target.numpy()], []
    step = sh.value_and_gradient(misfit, sheet)
    texels = np.full((TEXELS, TEXELS, 3), 0.5, np.float32)
    for k in range(steps):
        sheet.update(texels)
        value, by_texels = step(places, target)
        errors.append(float(np.sqrt(value / size**2)))
        texels = texels - np.float32(0.4 * (TEXELS / size) ** 2) * by_texels
        if k in (2, steps - 1):
            panels.append(shown(places).numpy())
    return panels, errors


if __name__ == "__main__":
    pictures, errors = fitted(256, STEPS, *sys.argv[1:])
    print(f"the error falls from {errors[0]:.3f} to {errors[-1]:.3f}")
    save("fitting", np.hstack(pictures))
