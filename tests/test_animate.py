"""Animations of programs and chains: their frames are the pictures that runs give, and a file is whole or not there."""

import os

import numpy as np
import pytest
from PIL import Image as pillow

import shpy as sh
from shpy.display.screen import pixels
from shpy.pictures.videos import VideoError

gain = sh.Param(sh.Attrib1f, 1.0, name="gain", range=(0, 4))


@sh.program
def wave(uv: sh.TexCoord2f, time: sh.Attrib1f, frame: sh.Attrib1i, speed: sh.Attrib1f = 1.0) -> sh.Color3f:
    return gain * sh.Color3f(uv.x, sh.fract(speed * time), 0.125 * frame)


@sh.program
def grow(u: sh.Attrib1f):
    return {"u": u + 0.25}


@sh.program
def red(u: sh.Attrib1f, uv: sh.TexCoord2f) -> sh.Color3f:
    return sh.Color3f(u, uv)


def read(folder):
    return [np.asarray(pillow.open(folder / name)) for name in sorted(os.listdir(folder))]


def test_a_folder_holds_the_frames_of_a_program(tmp_path):
    made = sh.animate(wave, tmp_path / "frames", frames=np.int64(3), fps=4, size=(np.int16(6), 5), backend="numpy")
    assert made == tmp_path / "frames"
    right = (np.arange(6) + 0.5) / 6
    for number, found in enumerate(read(made)):
        expected = np.zeros((5, 6, 3))
        expected[...] = np.stack([right, np.full(6, number / 4), np.full(6, number / 8)], axis=-1)
        assert np.array_equal(found, pixels(expected)[..., :3])


def test_inputs_and_params_are_numbers_or_functions_of_the_time(tmp_path):
    given = {"gain": lambda time: 1 + 2 * time, "speed": 0.5}
    sh.animate(wave, tmp_path / "frames", frames=2, fps=2, size=(4, 4), backend="numpy", **given)
    first, second = read(tmp_path / "frames")
    assert gain.value == 1
    assert second[0, 0, 1] == round(2 * 0.25 * 255)
    assert np.abs(second[..., 0] - np.minimum(2.0 * first[..., 0], 255)).max() <= 1


def test_numbers_are_shown_as_they_are_or_encoded_once(tmp_path):
    @sh.program
    def grey() -> sh.Attrib1f:
        return sh.Attrib1f(0.2158605)

    for encode, level in ((False, 55), (True, 128)):
        sh.animate(grey, tmp_path / "frames", frames=1, size=(2, 2), encode=encode, backend="numpy")
        assert read(tmp_path / "frames")[0].tolist() == [[[level] * 3] * 2] * 2


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_a_chain_goes_on_from_frame_to_frame(tmp_path, backend):
    start = np.zeros((3, 4), np.float32)
    sh.animate(sh.repeat(grow, 1), tmp_path / "plain", frames=3, u=start, backend=backend)
    assert [f[0, 0].tolist() for f in read(tmp_path / "plain")] == [[64] * 3, [128] * 3, [191] * 3]
    sh.animate(sh.repeat(grow, 2), tmp_path / "shown", frames=2, show=red, u=start, backend=backend)
    second = read(tmp_path / "shown")[1]
    assert second.shape == (3, 4, 3)
    assert second[2, 3].tolist() == [255, 223, 213]


def test_a_folder_is_resumed_where_it_ended(tmp_path):
    start = np.zeros((2, 2), np.float32)
    sh.animate(sh.repeat(grow, 1), tmp_path / "all", frames=3, u=start, backend="numpy")
    sh.animate(sh.repeat(grow, 1), tmp_path / "some", frames=2, u=start, backend="numpy")
    sh.animate(sh.repeat(grow, 1), tmp_path / "some", frames=3, u=start, backend="numpy", resume=True)
    assert np.array_equal(read(tmp_path / "some"), read(tmp_path / "all"))


def test_frames_of_a_longer_animation_are_told_of(tmp_path):
    start = np.zeros((2, 2), np.float32)
    sh.animate(sh.repeat(grow, 1), tmp_path, frames=3, u=start, backend="numpy")
    with pytest.warns(sh.ShpyWarning, match="holds 2 frames of another animation that have other numbers: they stay"):
        sh.animate(sh.repeat(grow, 1), tmp_path, frames=1, u=start, backend="numpy")
    assert len(read(tmp_path)) == 3


@pytest.mark.parametrize("ending", ["gif", "webp"])
def test_files_play_at_their_pace(tmp_path, ending):
    told = []
    sh.animate(
        wave, tmp_path / f"wave.{ending}", frames=3, fps=10, size=(8, 4), progress=lambda *done: told.append(done)
    )
    with pillow.open(tmp_path / f"wave.{ending}") as found:
        assert (found.n_frames, found.size, found.info["loop"]) == (3, (8, 4), 0)
        found.load()
        assert found.info["duration"] == 100
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_smooth_shades_stay_smooth_in_a_gif(tmp_path):
    @sh.program
    def shades(uv: sh.TexCoord2f) -> sh.Color3f:
        return sh.Color3f(uv, 0.5 + 0.5 * sh.sin(20 * uv.x * uv.y))

    sh.animate(shades, tmp_path / "shades.gif", frames=1, size=(96, 96), backend="numpy")
    sh.animate(shades, tmp_path / "exact", frames=1, size=(96, 96), backend="numpy")
    found = np.asarray(pillow.open(tmp_path / "shades.gif").convert("RGB"), np.float32)
    error = (found - read(tmp_path / "exact")[0]).reshape(12, 8, 12, 8, 3).mean(axis=(1, 3))
    assert np.abs(error).mean() < 1.5  # 2.4 without dithering


def test_a_file_is_whole_or_not_there(tmp_path):
    def stops(time):
        if time > 0.1:
            raise RuntimeError("enough")
        return 1.0

    (tmp_path / "wave.gif").write_bytes(b"before")
    with pytest.raises(RuntimeError, match="enough"):
        sh.animate(wave, tmp_path / "wave.gif", frames=9, size=(4, 4), backend="numpy", gain=stops)
    assert os.listdir(tmp_path) == ["wave.gif"]
    assert (tmp_path / "wave.gif").read_bytes() == b"before"
    assert gain.value == 1


@sh.program
def of_points(p: sh.Point3f) -> sh.Color3f:
    return sh.Color3f(p.x)


@pytest.mark.parametrize(
    ("shown", "output", "changes", "error", "what"),
    [
        (of_points, "a.gif", {}, sh.ShpyTypeError, "of_points is no program of pixels: nothing fills its input p"),
        (wave, "a.gif", {"spede": 2}, sh.ShpyTypeError, "spede is neither an input nor a Param of wave"),
        (wave, "a.gif", {"gain": 9}, sh.ShpyTypeError, "9.0 is outside of its range, 0 to 4"),
        (wave, "a.gif", {"size": (0, 4)}, sh.ShpyTypeError, r"size=\(0, 4\) is no width and height"),
        (wave, "a.gif", {"show": red}, sh.ShpyTypeError, "show= makes colours of the streams of a chain"),
        (wave, "a.gif", {"frames": 0}, VideoError, "one frame or more"),
        (wave, "a", {"frames": 10**30}, VideoError, "at most 1,000,000 frames"),
        (wave, "a.gif", {"frames": "2"}, VideoError, "one frame or more, not '2'"),
        (wave, "a.gif", {"fps": 0}, VideoError, "more than 0"),
        (wave, "a.gif", {"fps": "24"}, VideoError, "at most 1000 frames a second, not '24'"),
        (wave, "a.gif", {"fps": 0.0015}, VideoError, "show a frame for at most 655.35 s, not 666.667 s"),
        (wave, "a.webp", {"fps": 5e-324}, VideoError, "show a frame for at most 16777.2 s, not inf s"),
        (wave, "a.avi", {}, VideoError, "not as .avi"),
        (wave, "a.gif", {"resume": True}, VideoError, "in a folder"),
        (wave, "no/a.gif", {}, FileNotFoundError, "there is no folder"),
        (sh.repeat(grow, 1), "a.gif", {"w": 1}, sh.ShpyTypeError, "w is no stream of repeat"),
        (sh.repeat(grow, 1), "a.gif", {}, sh.ShpyTypeError, "u"),
        (3, "a.gif", {}, sh.ShpyTypeError, "3 is neither a program nor a chain"),
    ],
)  # fmt: skip
def test_mistakes_are_named(tmp_path, shown, output, changes, error, what):
    with pytest.raises(error, match=what):
        sh.animate(shown, tmp_path / output, **({"frames": 2, "backend": "numpy"} | changes))
    assert not os.listdir(tmp_path)


@sh.program
def onward(u: sh.Table[sh.Attrib1f, 2]):
    return {"w": u[sh.grid_index(2)] + 0.25}


@sh.program
def return_(w: sh.Table[sh.Attrib1f, 2], time: sh.Attrib1f = 9.0):
    return {"u": w[sh.grid_index(2)] * sh.cond(time < 9, 1, 0)}


@pytest.mark.parametrize("given", [{"size": (5, 4)}, {"size": (5, 4), "w": np.zeros((4, 5))}, {}])
def test_a_stream_that_a_chain_writes_before_it_reads_it_may_be_left_out_or_given(tmp_path, given):
    chain = sh.sequence(onward, return_)
    sh.animate(chain, tmp_path / "frames", frames=3, fps=4, u=np.zeros((4, 5)), backend="numpy", **given)
    assert [frame[0, 0, 0] for frame in read(tmp_path / "frames")] == [64, 128, 191]
    assert read(tmp_path / "frames")[0].shape == (4, 5, 3)


@sh.program
def fall(at: sh.Point2f, board: sh.Table[sh.Attrib1f, 2]):
    return {"at": sh.Point2f(at.x, at.y + board[0, 0])}


@sh.program
def above(board: sh.Table[sh.Attrib1f, 2]) -> sh.Attrib1f:
    return board[sh.grid_index(2)]


def test_components_of_vectors_are_no_axes_of_a_picture(tmp_path):
    streams = {"at": np.zeros((7, 2)), "board": np.ones((3, 6))}
    sh.animate(sh.repeat(fall, 1), tmp_path / "frames", frames=1, show=above, backend="numpy", **streams)
    assert read(tmp_path / "frames")[0].shape == (3, 6, 3)
