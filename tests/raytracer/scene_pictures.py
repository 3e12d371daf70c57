"""Comparisons of pictures: all layers to the bit, and frames of a scene that moves against scenes built anew."""

import numpy as np

from raytracer import Renderer

SIZE = (40, 30)


def same(found, wanted):
    """Assert that all layers of two pictures have the same bits."""
    for name, layer in wanted.layers.items():
        assert found.layers[name].dtype == layer.dtype, name
        np.testing.assert_array_equal(found.layers[name].view(np.uint32), layer.view(np.uint32), err_msg=name)


def frames(scenes):
    """Yield a picture of each scene, by one Renderer that is shown them and seldom builds everything anew."""
    first, *others = scenes
    renderer = Renderer(first, backend="numpy")
    yield renderer.render(SIZE)
    for scene in others:
        renderer.show(scene)
        yield renderer.render(SIZE)
    assert renderer.builds <= 3


def turned(angle, offset=(0, 0, 0), scale=(1, 1, 1)):
    """Return the matrix (4, 4) that scales along the axes, turns about y by an angle in radians, and moves."""
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) * scale, offset])
    return matrix
