"""The ray tracer in the stress mode: the same pixels, whatever its runs are split into."""

import numpy as np
import pytest
from stress.mode import stressed

from raytracer import Scene, render

SIZE = (48, 36)
WAYS = {
    "whitted": {"scene": "boxes", "bounces": 2},
    "staged": {"scene": "boxes", "bounces": 1, "tracer": "staged"},
    "path": {"scene": "cornell", "integrator": "path", "samples": 2},
}


def picture(way, backend):
    options = dict(WAYS[way])
    return render(Scene.builtin(options.pop("scene")), size=SIZE, backend=backend, **options)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
@pytest.mark.parametrize("way", WAYS)
def test_pictures_have_the_same_bits(way, backend):
    expected = picture(way, "numpy")
    for seed in (1, 2):
        with stressed(seed):
            found = picture(way, backend)
        np.testing.assert_array_equal(found.pixels.view(np.uint32), expected.pixels.view(np.uint32))
        np.testing.assert_array_equal(found.object_id, expected.object_id)
        np.testing.assert_array_equal(found.depth.view(np.uint32), expected.depth.view(np.uint32))
