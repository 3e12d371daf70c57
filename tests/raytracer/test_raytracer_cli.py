import os
import re
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pages import wait_until

import shpy as sh
from raytracer import Image, Scene, SceneError, cli, gallery, memory, progress, render, rendering
from raytracer.animation import ANIMATIONS
from raytracer.scenes import SCENES

QUAD = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"


def test_render_a_built_in_scene(tmp_path, capsys):
    path = tmp_path / "boxes.npy"
    arguments = ["render", "boxes", "-o", str(path), "--size", "24x16", "--backend", "numpy", "--bounces", "1"]
    assert cli.main(arguments) == 0
    assert np.load(path)["pixels"].shape == (16, 24, 3)
    assert re.search(r"24 x 16, 36 triangles, [\d,]+ rays on numpy", capsys.readouterr().out)


def test_render_a_file_with_more_samples(tmp_path):
    mesh, path = tmp_path / "quad.obj", tmp_path / "quad.png"
    mesh.write_text(QUAD)
    assert cli.main(["render", str(mesh), "-o", str(path), "--size", "16x16", "--samples", "4"]) == 0
    assert path.stat().st_size > 100


def test_a_picture_that_does_not_fit_into_memory_is_refused_before_anything_runs(tmp_path, monkeypatch, capsys):
    def fail(*_, **__):
        raise AssertionError("something ran")

    monkeypatch.setattr(memory, "free_bytes", lambda: 40_000_000_000)
    monkeypatch.setattr(rendering, "Renderer", fail)
    path = tmp_path / "large.png"
    arguments = ["render", "boxes", "-o", str(path), "--backend", "numpy", "--size"]
    assert cli.main([*arguments, "32768x32768"]) == 1
    said = capsys.readouterr().err
    # 36 bytes of layers and 10 for the PNG.
    assert said == (
        "raytracer: a picture of 32768 x 32768 pixels takes 49,392,123,904 bytes of memory, "
        "and 40,000,000,000 are free: choose a smaller size\n"
    )
    assert not path.exists()
    monkeypatch.setattr(memory, "free_bytes", lambda: 20_000_000_000)
    with pytest.raises(SceneError, match="38,654,705,664 bytes"):
        render(Scene.builtin("boxes"), (32768, 32768), backend="numpy")
    with pytest.raises(AssertionError, match="something ran"):  # half as wide and high it fits
        render(Scene.builtin("boxes"), (16384, 16384), backend="numpy")


def test_what_a_container_may_still_take(tmp_path):
    (tmp_path / "memory.current").write_text("700\n")
    (tmp_path / "memory.stat").write_text("anon 400\ninactive_file 200\n")
    group = (str(tmp_path), *memory._GROUPS[0][1:])
    for most, free in (("1000\n", 500), ("max\n", None), ("100\n", 0)):
        (tmp_path / "memory.max").write_text(most)
        assert memory._free_in_group(*group) == free


def test_free_memory_is_what_the_system_has():
    """Only Linux tells; elsewhere nothing is refused."""
    free = memory.free_bytes()
    if not sys.platform.startswith("linux"):
        assert free is None
        return
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert free is not None
    assert total // 1000 < free < 100 * total


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["render", "teapots"], "neither a file nor a built-in scene; the scenes are boxes, cubes, mirror-box, mixed"),
        (["render", "gone.obj"], "no file gone.obj"),
        (["render", "boxes", "-o", "a.gif"], "not as .gif"),
        (["render", "boxes", "-o", "gone/a.png"], "no folder gone"),
        (["render", "boxes", "--size", "0x4", "-o", "a.npy"], "pixels"),
        (["render", "boxes", "--samples", "3", "-o", "a.npy"], "samples"),
        (["render", "boxes", "--backend", "vulkan", "-o", "a.npy"], "vulkan"),
        (["render", "boxes", "--grid", "4", "-o", "a.npy"], "--grid 4 is for --accel grid, not 'bvh'"),
    ],
)
def test_errors_are_one_line_and_leave_nothing(arguments, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(arguments) == 1
    error = capsys.readouterr().err
    assert error.startswith("raytracer: ")
    assert words in error
    assert "Traceback" not in error
    assert list(tmp_path.iterdir()) == []


def test_a_bad_size_shows_the_form(capsys):
    with pytest.raises(SystemExit):
        cli.main(["render", "boxes", "--size", "big"])
    assert "WIDTHxHEIGHT, such as 1024x768, not 'big'" in capsys.readouterr().err


def test_ctrl_c_leaves_no_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def stopped(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "render", stopped)
    assert cli.main(["render", "boxes"]) == 130
    assert list(tmp_path.iterdir()) == []
    assert "nothing was written" in capsys.readouterr().err


def test_scenes_lists_them_all(capsys):
    assert cli.main(["scenes"]) == 0
    out = capsys.readouterr().out
    assert [line.split()[0] for line in out.splitlines()] == [*SCENES, *ANIMATIONS]
    assert "61,562 triangles" in out


def test_scenes_lists_the_meshes_of_a_file(tmp_path, capsys):
    path = tmp_path / "two.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\no sail\nf 1 2 3\no flag\nf 1 3 2\n")
    assert cli.main(["scenes", str(path)]) == 0
    assert capsys.readouterr().out == "sail   1 triangles\nflag   1 triangles\nfloor  2 triangles\n"


def test_scenes_lists_scenes_that_move(tmp_path, capsys):
    assert cli.main(["scenes", "animated"]) == 0
    assert "sphere  2,208 triangles" in capsys.readouterr().out
    path = tmp_path / "moving.py"
    path.write_text('import raytracer as rt\n\n\ndef scene(time):\n    return rt.Scene.builtin("boxes")\n')
    assert cli.main(["scenes", str(path)]) == 0
    assert capsys.readouterr().out == 3 * "box  12 triangles\n" + "a function of the time, listed at 0 seconds\n"


@pytest.mark.parametrize("command", [["scenes"], ["render", "--time", "0"], ["animate"]], ids=lambda c: c[0])
@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("def scene(time):\n    return 3\n", "scene(0) returns int, not a raytracer.Scene"),
        ("def scene(time):\n    return 1 / time\n", "moving.py:2: ZeroDivisionError"),
        ("x = 1\n", "defines no function scene"),
    ],
    ids=["another-type", "mistake", "no-function"],
)
def test_mistakes_in_a_file_of_a_moving_scene(tmp_path, monkeypatch, capsys, command, text, error):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "moving.py").write_text(text)
    assert cli.main([*command, "moving.py"]) == 1
    assert error in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir() if path.name != "__pycache__"] == ["moving.py"]


@pytest.mark.parametrize("command", [["render", "--time", "0"], ["animate", "--frames", "1"]], ids=lambda c: c[0])
def test_mistakes_in_a_surface_name_its_line(tmp_path, monkeypatch, capsys, command):
    """They are made while the kernel is recorded, long after the file has run."""
    monkeypatch.chdir(tmp_path)
    text = (
        "import raytracer as rt\nfrom raytracer.meshes.shapes import sphere\n\n"
        "def odd(hit):\n    return rt.Surface(colour=hit.position)\n\n"
        "def scene(time):\n    return rt.Scene([sphere(1, rt.Material(surface=odd))], [rt.PointLight((3, 5, 5))])\n"
    )
    (tmp_path / "moving.py").write_text(text)
    assert cli.main([*command, "moving.py", "--size", "8x8", "--backend", "numpy"]) == 1
    lines = capsys.readouterr().err.strip().splitlines()
    assert lines[-1].startswith("raytracer: moving.py:5: TypeError: ")
    assert "Traceback" not in "".join(lines)


def test_pixels_that_are_no_numbers_are_counted(tmp_path, capsys):
    text = (
        "import raytracer as rt, shpy as sh\nfrom raytracer.meshes.shapes import sphere\n\n"
        "def half(hit):\n    return rt.Surface(color=sh.Color3f(sh.sqrt(hit.position.x), 0, 0))\n\n"
        "def scene(time):\n    ball = sphere(1, rt.Material(surface=half))\n"
        "    return rt.Scene([ball], [rt.PointLight((3, 5, 5))], rt.Camera((0, 0, 4), (0, 0, 0)))\n"
    )
    (tmp_path / "half.py").write_text(text)
    words = ["--time", "0", "--size", "16x12", "--backend", "numpy", "-o", str(tmp_path / "half.npy")]
    assert cli.main(["render", str(tmp_path / "half.py"), *words]) == 0
    count = int(np.isnan(np.load(tmp_path / "half.npy")["pixels"]).any(axis=-1).sum())
    assert count > 10
    assert f"of preparation; {count} pixels are NaN\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("changes", "devices"),
    [({}, ["opencl"]), ({"cluster": "local:2"}, []), ({"run": cli.scenes}, [])],
    ids=["render", "cluster", "scenes"],
)
def test_a_command_that_draws_here_opens_the_device_that_is_named(monkeypatch, changes, devices):
    opened = []
    monkeypatch.setattr(cli, "open_device", opened.append)
    cli._open_backend(SimpleNamespace(**{"run": cli._render, "backend": "opencl", "cluster": None} | changes))
    assert opened == devices


def test_doctor_names_backends_and_packages(capsys):
    assert cli.main(["doctor"]) == 0
    out = capsys.readouterr().out
    for word in ("numpy", "opencl", "glsl", "trimesh", "OpenEXR"):
        assert word in out


def test_without_a_terminal_progress_is_a_line_every_few_seconds(monkeypatch, capsys):
    clock = iter([0, 2, 6, 6, 7, 11, 11])
    monkeypatch.setattr(sh.command, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    with progress.progress_bar("work") as report:
        for done in range(5):
            report(done, 4)
    assert capsys.readouterr().err == "work: 25.0%\nwork: 75.0%\n"


def test_the_bar_waits_and_needs_a_terminal(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with progress.progress_bar("work") as report:
        report(1, 2)
        report(2, 2)
    assert "work" not in capsys.readouterr().err
    monkeypatch.setattr(progress, "_PATIENCE", -1.0)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("FORCE_COLOR", "1")
    with progress.progress_bar("work") as report:
        report(1, 2)
    assert "work" in capsys.readouterr().err


def test_a_command_says_what_it_does_before_the_first_rows(tmp_path, monkeypatch, capsys):
    words = ["render", "boxes", "-o", str(tmp_path / "boxes.png"), "--size", "24x16", "--backend", "numpy"]
    line = "raytracer: reads boxes, builds its accelerator and compiles its kernel before the first rows (SHPY_QUIET=1"
    monkeypatch.setattr(progress, "_SILENCE", 0.0)
    assert cli.main(words) == 0
    assert line not in capsys.readouterr().err  # conftest sets SHPY_QUIET
    monkeypatch.delenv("SHPY_QUIET")
    for integrator in ("whitted", "path"):
        assert cli.main([*words, "--integrator", integrator, "--samples", "1"]) == 0
        assert capsys.readouterr().err.count(line) == 1
    monkeypatch.setattr(progress, "_SILENCE", 3600.0)
    before = threading.active_count()
    assert cli.main(["render", str(tmp_path / "absent.obj")]) == 1
    assert cli.main(words) == 0
    wait_until(lambda: threading.active_count() <= before)


def test_the_mode_of_arithmetic_is_an_option(tmp_path, capsys):
    path = tmp_path / "boxes.npy"
    words = ["render", "boxes", "-o", str(path), "--size", "24x16", "--backend", "numpy", "--math"]
    assert cli.main([*words, "portable"]) == 0
    wanted = render(Scene.builtin("boxes"), (24, 16), backend="numpy", math="portable").pixels
    np.testing.assert_array_equal(Image.load(path).pixels, wanted)
    assert cli.main([*words, "loose"]) == 1
    assert "loose" in capsys.readouterr().err
    assert cli.main([*words, "portable", "--error", "1"]) == 1
    assert "leave out --math" in capsys.readouterr().err


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", ["boxes", "mirror-box"])
def test_the_commands_of_the_gallery_draw_its_pictures(name, tmp_path, monkeypatch, capsys):
    """Cameras, backgrounds and exposures are those of docs/gallery/README.md."""
    page = (Path(__file__).parents[2] / "docs" / "gallery" / "README.md").read_text()
    (command,) = (line for line in page.splitlines() if f"`raytracer render {name} " in line)
    words = command.split("`")[1].split()[1:]
    words[words.index("--size") + 1], words[words.index("--samples") + 1] = "16x12", "1"
    monkeypatch.chdir(tmp_path)
    assert cli.main([*words, "--backend", "numpy"]) == 0
    rendered = (tmp_path / f"{name}.png").read_bytes()
    monkeypatch.setattr(gallery, "SCENES", {name: gallery.SCENES[name]})
    assert cli.main(["gallery", str(tmp_path), "--size", "16x12", "--samples", "1", "--backend", "numpy"]) == 0
    assert (tmp_path / f"{name}.png").read_bytes() == rendered


def test_the_gallery_has_every_scene(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(gallery, "SCENES", {name: gallery.SCENES[name] for name in ("boxes", "mirror-box")})
    assert cli.main(["gallery", str(tmp_path), "--size", "16x12", "--samples", "1", "--backend", "numpy"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["boxes.png", "mirror-box.png"]
    assert capsys.readouterr().out.count("16 x 12") == 2
    assert cli.main(["gallery", str(tmp_path / "none")]) == 1
    assert "make it first" in capsys.readouterr().err
