"""Inputs that viewers fill by name, and the pixels of outputs."""

import numpy as np
import pytest

import shpy as sh
from shpy.display.screen import Moment, filled, is_filled, pixels

MOMENT = Moment((5, 3), time=1.5, frame=7, mouse=(4, 2, -1, 2))


@sh.program
def named(
    uv: sh.TexCoord2f,
    pixel: sh.Attrib2i,
    resolution: sh.Attrib2f,
    time: sh.Attrib1f,
    frame: sh.Attrib1i,
    mouse: sh.Attrib4f,
) -> sh.Attrib4f:
    right = (pixel + 0.5) / resolution
    return sh.Attrib4f(sh.Attrib2f(uv - right), time + frame, mouse.z)


def test_inputs_are_filled_by_name():
    values = filled(named.inputs, MOMENT)
    assert values.keys() == named.inputs.keys()
    found = named(**values, shape=MOMENT.shape)
    assert found.shape == (3, 5, 4)
    assert np.abs(found[..., :2]).max() < 1e-6
    assert found[0, 0, 2:].tolist() == [8.5, -1]
    assert values["pixel"][2, 4].tolist() == [4, 2]


def test_other_types_of_the_same_size_take_the_same_numbers():
    inputs = {"pixel": sh.Attrib2f, "mouse": sh.Attrib2f, "resolution": sh.Attrib2i, "time": sh.Attrib1f}
    values = filled(inputs, MOMENT, names=["time"])
    assert values["mouse"] == (4, 2)
    assert values["resolution"].tolist() == [5, 3]
    assert "time" not in values


@pytest.mark.parametrize(
    ("name", "type_"),
    [("uv", sh.Attrib3f), ("time", sh.Attrib1b), ("speed", sh.Attrib1f), ("uv", sh.Table[sh.Attrib2f])],
)
def test_names_of_other_types_are_left_alone(name, type_):
    assert not is_filled(name, type_)
    assert filled({name: type_}, MOMENT) == {}


def test_a_number_is_grey_and_a_fourth_component_is_alpha():
    grey = pixels(np.array([[0.0, 0.5, 2.0, -1.0, np.nan]], np.float32))
    assert grey[0].tolist() == [[0, 0, 0, 255], [128, 128, 128, 255], [255, 255, 255, 255], *[[0, 0, 0, 255]] * 2]
    assert pixels(np.array([[[1, 0, 1, 0.5]]], np.float32)).tolist() == [[[255, 0, 255, 128]]]
    assert pixels(np.array([[[1, 0]]], np.float32)).tolist() == [[[255, 0, 0, 255]]]
    assert pixels(np.array([[True, False]])).tolist() == [[[255] * 4, [0, 0, 0, 255]]]


def test_linear_light_becomes_srgb_once():
    assert pixels(np.array([[0.0, 0.002, 0.2158605, 1.0]]), encode=True)[0, :, 0].tolist() == [0, 7, 128, 255]


def test_other_shapes_are_refused():
    with pytest.raises(sh.ShpyTypeError, match="a picture has the shape"):
        pixels(np.zeros((3, 5, 5)))
    with pytest.raises(sh.ShpyTypeError, match="a picture has the shape"):
        pixels(np.float32(1))
