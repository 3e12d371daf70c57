"""Matrices: against numpy in binary64, and the same bits on every backend."""

import numpy as np
import pytest
from backends.running import covering

import shpy as sh
from shpy import library

RNG = np.random.default_rng(3)
on_every_backend = pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])


@sh.program
def of_space(
    axis: sh.Vector3f, angle: sh.Attrib1f
) -> tuple[sh.Matrix4f, sh.Matrix4f, sh.Matrix4f, sh.Matrix3f, sh.Matrix3f, sh.Matrix3f]:
    return (
        library.rotate(axis, angle),
        library.scale(axis),
        library.translate(axis),
        library.rotate(angle),
        library.scale(axis.xy),
        library.translate(axis.zy),
    )


@sh.program
def of_cameras(eye: sh.Point3f, target: sh.Point3f, angle: sh.Attrib1f) -> tuple[sh.Matrix4f, sh.Matrix4f]:
    return library.look_at(eye, target), library.perspective(angle, 1.5, 0.1, 100)


@pytest.mark.slow
def test_all_backends_give_the_same_bits():
    axes = np.concatenate([RNG.normal(size=(40, 3)), [[0, 0, 0], [1e30, -1e30, 0], [np.inf, 0, 1], [np.nan, 1, 1]]])
    angles = np.concatenate([RNG.uniform(-10, 10, 41), [-0.0, np.inf, 1e6]])
    sh.testing.assert_equivalent(of_space, axes, angles, backends=covering(1))
    eyes = np.concatenate([RNG.normal(size=(40, 3)), [[0, 0, 0], [0, 1, 0], [1e9, 0, 0], [np.nan, 1, 1]]])
    sh.testing.assert_equivalent(of_cameras, eyes, np.zeros((44, 3)), np.abs(angles), backends=covering(2))


@pytest.mark.sampled(3)
@on_every_backend
def test_rotations_are_orthonormal_and_turn_counterclockwise(backend):
    axes, angles = RNG.normal(size=(50, 3)), RNG.uniform(-7, 7, 50)
    found = of_space.compile(backend)(axes, angles)
    turn, plane = found[0].astype(np.float64), found[3].astype(np.float64)
    for m in (turn, plane):
        np.testing.assert_allclose(m @ m.swapaxes(1, 2), np.broadcast_to(np.eye(m.shape[1]), m.shape), atol=1e-6)
        np.testing.assert_allclose(np.linalg.det(m), 1, atol=1e-6)
    units = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    cross = np.zeros((50, 3, 3))
    cross[:, [2, 0, 1], [1, 2, 0]], cross[:, [1, 2, 0], [2, 0, 1]] = units, -units
    s, c = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    np.testing.assert_allclose(turn[:, :3, :3], np.eye(3) + s * cross + (1 - c) * cross @ cross, atol=2e-6)
    np.testing.assert_array_equal(turn[:, 3], np.broadcast_to([0, 0, 0, 1], (50, 4)))
    np.testing.assert_allclose(plane[:, 0, :2], np.stack([np.cos(angles), -np.sin(angles)], axis=1), atol=1e-6)
    np.testing.assert_allclose(
        np.asarray(library.rotate((0, 0, 9), np.pi / 2) @ sh.Vector3f(1, 0, 0)), [0, 1, 0], atol=1e-6
    )


@pytest.mark.sampled(3)
@on_every_backend
def test_scale_and_translate_act_on_points_and_vectors(backend):
    @sh.program
    def moved(p: sh.Point3f, q: sh.Point2f) -> tuple[sh.Point3f, sh.Vector3f, sh.Point2f]:
        m = library.translate((10, 20, 30)) @ library.scale((1, 2, 3))
        return m @ p, m @ sh.Vector3f(p), library.translate(q) @ library.scale((2, -1)) @ q

    found = moved.compile(backend)((1, 1, -1), (3, 5))
    assert [part.tolist() for part in found] == [[11, 22, 27], [1, 2, -3], [9, 0]]


@pytest.mark.sampled(3)
@on_every_backend
def test_look_at_and_perspective_are_those_of_glu(backend):
    eye, target = np.array([3.0, 2, 5]), np.array([-1, 0.5, 0])
    view, projection = (m.astype(np.float64) for m in of_cameras.compile(backend)(eye, target, 1.1))
    forward = (target - eye) / np.linalg.norm(target - eye)
    side = np.cross(forward, (0, 1, 0))
    side /= np.linalg.norm(side)
    axes = np.stack([side, np.cross(side, forward), -forward])
    np.testing.assert_allclose(view[:3, :3], axes, atol=1e-6)
    np.testing.assert_allclose(view[:3, 3], -axes @ eye, atol=2e-6)
    np.testing.assert_allclose(view @ [*target, 1], [0, 0, -np.linalg.norm(target - eye), 1], atol=1e-5)
    t = 1 / np.tan(0.55)
    expected = [[t / 1.5, 0, 0, 0], [0, t, 0, 0], [0, 0, -100.1 / 99.9, -20 / 99.9], [0, 0, -1, 0]]
    np.testing.assert_allclose(projection, expected, rtol=1e-6)
    for z, depth in ((-0.1, -1), (-100, 1)):
        clip = projection @ [0, 0, z, 1]
        assert clip[2] / clip[3] == pytest.approx(depth, abs=1e-5)


def test_sizes_are_checked():
    for function, given in ((library.scale, 2), (library.translate, (1, 2, 3, 4)), (library.rotate, (1, 2, 3))):
        with pytest.raises(sh.ShpyTypeError, match="component") as error:
            function(given)
        assert error.value.loc.file == __file__
