"""A bad entry of a mesh file costs that entry: it is left out and counted; with `strict` it is an error."""

import pytest

import shpy as sh
from raytracer import Mesh, Scene, SceneError
from raytracer.cli import main
from raytracer.meshes.folder import BadEntry, Fault, Notices

LACKING = Fault("face names a normal that the file lacks", "faces name a normal that the file lacks")


def test_bad_entries_are_counted_with_the_place_of_the_first():
    notices = Notices("bad.obj")
    notices.leave_out(LACKING, 1, "line 12", "a face names normal 8, and there are 6")
    assert notices.faults() == "bad.obj: left out: 1 face names a normal that the file lacks (in line 12)"
    notices.leave_out(LACKING, 2, "line 14")
    notices.leave_out(Fault("point", "points"), 0, "line 1")
    assert notices.faults() == "bad.obj: left out: 3 faces name a normal that the file lacks (the first in line 12)"
    with pytest.warns(sh.ShpyWarning, match="3 faces name a normal"):
        notices.warn()


def test_a_bad_entry_is_an_error_of_a_strict_reader():
    notices = Notices("bad.obj", strict=True)
    notices.leave_out(LACKING, 0, "line 1")
    with pytest.raises(BadEntry, match=r"^line 12: a face names normal 8, and there are 6$"):
        notices.leave_out(LACKING, 1, "line 12", "a face names normal 8, and there are 6")
    with pytest.raises(BadEntry, match=r"^line 12: 2 faces name a normal that the file lacks$"):
        notices.leave_out(LACKING, 2, "line 12")
    with pytest.raises(BadEntry, match=r"^a\.png: there is no such file$"):
        notices.miss("a.png", "there is no such file")


def test_a_missing_library_is_an_error_of_a_strict_reader(tmp_path, capsys):
    path = tmp_path / "sail.obj"
    path.write_text("mtllib sail.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n")
    with pytest.raises(SceneError, match=r"sail\.obj: sail\.mtl: there is no such file$"):
        Scene.load(path, strict=True)
    with pytest.warns(sh.ShpyWarning, match="materials, which Scene.load reads"):
        assert len(Mesh.load(path, strict=True)) == 1
    assert main(["render", str(path), "--strict", "--size", "8x8", "-o", str(tmp_path / "a.png")]) == 1
    assert "sail.mtl: there is no such file" in capsys.readouterr().err
    assert main(["render", "boxes", "--strict", "--size", "8x8", "-o", str(tmp_path / "a.png")]) == 1
    assert "--strict is for mesh files" in capsys.readouterr().err
