"""An interrupted command keeps and names what it finished; path tracing goes on from there bit for bit."""

import os
import re
import signal
import subprocess
import sys

import numpy as np
import pytest
from pages import wait_until
from patience import HANGING

from raytracer import Image, Renderer, Scene, cli, render
from raytracer.integrators import progressive
from raytracer.integrators.layers import BANDS

LINE = ["render", "cornell", "--integrator", "path", "--size", "6x5", "--bounces", "2", "--backend", "numpy"]
ENDLESS = """
import sys
from raytracer import cli
from raytracer.integrators import progressive
progressive.SAMPLES_AT_ONCE = 2
cli._SAVING = cli._SHARE = 0
sys.exit(cli.main(sys.argv[1:]))
"""


def started(path, samples=100_000):
    """A process that renders for a long time and writes after each pass, once the first one is written."""
    words = [sys.executable, "-c", ENDLESS, *LINE, "--samples", str(samples), "-o", str(path)]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
    wait_until(lambda: path.exists() or process.poll() is not None)
    assert process.poll() is None, process.stderr.read()
    return process


def goes_on(path, capsys):
    """Continue the picture by a few samples, and compare with one that was rendered at a stretch."""
    samples = Image.load(path).samples
    assert samples > 0
    assert cli.main([*LINE, "--samples", str(samples + 3), "-o", str(path), "--resume"]) == 0
    capsys.readouterr()
    whole = Renderer(Scene.builtin("cornell"), backend="numpy", integrator="path", bounces=2)
    expected, found = whole.render((6, 5), samples=samples + 3), Image.load(path)
    for name, layer in expected.layers.items():
        np.testing.assert_array_equal(found.layers[name], layer, err_msg=name)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_with_what_is_finished(tmp_path, capsys, number):
    path = tmp_path / "a.npy"
    process = started(path)
    process.send_signal(number)
    said = process.communicate(timeout=HANGING)[1]
    assert process.returncode == 128 + number, said
    assert f"stopped after {Image.load(path).samples:,} of 100,000 samples, which were written" in said
    assert os.listdir(tmp_path) == ["a.npy"]
    goes_on(path, capsys)


def test_a_killed_process_leaves_a_picture_to_go_on_from(tmp_path, capsys):
    path = tmp_path / "a.exr"
    process = started(path)
    process.kill()
    process.communicate()
    goes_on(path, capsys)


def test_a_picture_is_written_while_it_is_computed_but_not_all_the_time(tmp_path, monkeypatch, capsys):
    """After every ten seconds, and after twenty times as long as writing takes."""
    clock, saved = [0.0], []
    passes, save = Renderer.passes, Image.save

    def slow_passes(*given, **options):
        for image in passes(*given, **options):
            clock[0] += 4.0
            yield image

    def slow_save(image, path, *look):
        saved.append(image.samples)
        clock[0] += 1.0
        return save(image, path, *look)

    monkeypatch.setattr(Renderer, "passes", slow_passes)
    monkeypatch.setattr(Image, "save", slow_save)
    monkeypatch.setattr(cli.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(progressive, "SAMPLES_AT_ONCE", 1)
    assert cli.main([*LINE, "--samples", "14", "-o", str(tmp_path / "a.npy")]) == 0
    assert saved == [3, 8, 13, 14]  # at 12 s; 20 s after 13 s, and so on; at the end


def test_an_interruption_of_the_last_writing_says_what_is_there(tmp_path, monkeypatch, capsys):
    path, save = tmp_path / "a.npy", Image.save

    def interrupted(image, to, *look):
        if image.samples == 6:
            raise KeyboardInterrupt
        return save(image, to, *look)

    monkeypatch.setattr(Image, "save", interrupted)
    monkeypatch.setattr(cli, "_SAVING", 0)
    monkeypatch.setattr(cli, "_SHARE", 0)
    monkeypatch.setattr(progressive, "SAMPLES_AT_ONCE", 2)
    assert cli.main([*LINE, "--samples", "6", "-o", str(path)]) == 130
    assert capsys.readouterr().err == f"raytracer: stopped; {path} holds 4 samples\n"
    assert Image.load(path).samples == 4


def test_a_picture_that_cannot_be_continued_is_said(tmp_path, monkeypatch, capsys):
    passes = Renderer.passes

    def stopped(*given, **options):
        yield next(passes(*given, **options))
        raise KeyboardInterrupt

    monkeypatch.setattr(Renderer, "passes", stopped)
    assert cli.main([*LINE, "--samples", "40", "-o", str(tmp_path / "a.png")]) == 130
    assert "16 of 40 samples, which were written; --resume goes on from .exr or .npy alone" in capsys.readouterr().err


@pytest.mark.slow
def test_passes_of_large_pictures_have_fewer_samples(monkeypatch):
    """An interruption loses a pass at most, which therefore takes seconds, not minutes."""
    renderer = Renderer(Scene.builtin("cornell"), backend="numpy", integrator="path", bounces=1)
    expected = renderer.render((4, 3), samples=20)
    monkeypatch.setitem(BANDS, "paths on numpy", 4)
    for bands, counts in ((15, [5, 10, 15, 20]), (1, list(range(1, 21))), (64, [16, 20])):
        monkeypatch.setattr(progressive, "BANDS_AT_ONCE", bands)
        images = list(renderer.passes((4, 3), samples=20))
        assert [image.samples for image in images] == counts
        np.testing.assert_array_equal(images[-1].pixels, expected.pixels)


def test_an_interrupted_animation_says_which_frames_it_wrote(tmp_path):
    folder = tmp_path / "frames"
    words = ["animate", "animated", "--frames", "9000", "--size", "4x3", "--backend", "numpy", "-o", str(folder)]
    command = [sys.executable, "-m", "raytracer", *words]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    wait_until(lambda: (folder / "0002.png").exists() or process.poll() is not None)
    process.terminate()
    said = process.communicate(timeout=HANGING)[1].splitlines()[-1]
    assert process.returncode == 128 + signal.SIGTERM
    found = re.fullmatch(rf"raytracer: stopped; {folder} holds the first (\d+) of 9,000 frames: --resume .*", said)
    written = len(os.listdir(folder))
    assert found, said
    assert int(found[1]) in (written - 1, written)  # a frame may be written and not yet counted


def test_an_interrupted_gallery_says_what_it_wrote(tmp_path, monkeypatch, capsys):
    def interrupted(folder, size, **given):
        yield tmp_path / "boxes.png", render(Scene.builtin("boxes"), (4, 3), backend="numpy")
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "gallery", interrupted)
    assert cli.main(["gallery", str(tmp_path)]) == 130
    assert capsys.readouterr().err == f"raytracer: stopped; pictures written to {tmp_path}: 1\n"
