"""Measurements are written whole or not at all, and a path that cannot be written is refused before anything runs."""

import json

import pytest

import shpy as sh
from shpy.cli import main
from shpy.files import replacing
from shpy.pictures.outputs import check_output, new_figure, save_figure, write_json

PROGRAM = """
import shpy as sh


@sh.program
def twice(x: sh.Attrib1f) -> sh.Attrib1f:
    raise SystemExit("it ran")
"""


def test_a_file_is_replaced_when_it_is_complete(tmp_path):
    path = tmp_path / "found.json"
    path.write_text("before")
    with pytest.raises(TypeError), replacing(path) as temporary:
        temporary.write_text("half of it") + "the rest"
    assert [p.name for p in tmp_path.iterdir()] == ["found.json"]
    assert path.read_text() == "before"
    write_json(path, {"a": float("inf"), "b": (1, 2)})
    assert json.loads(path.read_text()) == {"a": "inf", "b": [1, 2]}
    assert [p.name for p in tmp_path.iterdir()] == ["found.json"]


def test_a_picture_has_its_numbers_beside_it(tmp_path):
    figure = new_figure(2, 2)
    figure.subplots().plot([1, 2], [3, 4])
    save_figure(figure, tmp_path / "drawn.svg", {"x": 1})
    assert sorted(p.name for p in tmp_path.iterdir()) == ["drawn.json", "drawn.svg"]
    assert (tmp_path / "drawn.svg").read_text().startswith("<?xml")


def test_the_cure_of_a_picture_without_a_format_is_json_alone(tmp_path):
    figure = new_figure(2, 2)
    with pytest.raises(sh.ShpyError, match="is no picture") as caught:
        save_figure(figure, tmp_path / "numbers", {"x": 1})
    assert caught.value.cure.endswith("; or in .json")
    save_figure(figure, tmp_path / "numbers.json", {"x": 1})
    assert [p.name for p in tmp_path.iterdir()] == ["numbers.json"]
    assert json.loads((tmp_path / "numbers.json").read_text()) == {"x": 1}


@pytest.mark.parametrize(
    ("name", "said"), [("missing/x.png", "there is no folder"), ("x.docx", "is no picture"), ("x", "is no picture")]
)
def test_a_path_that_cannot_be_written_is_refused(tmp_path, name, said):
    with pytest.raises(sh.ShpyError, match=said):
        check_output(tmp_path / name)


@pytest.mark.parametrize("command", [["accuracy"], ["tradeoff", "--error", "2ulp"]])
def test_commands_refuse_it_before_they_run(tmp_path, capsys, command):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    status = main([*command, f"{program}:twice", "-o", str(tmp_path / "missing" / "x.png")])
    assert status == 2
    assert "there is no folder" in capsys.readouterr().err
