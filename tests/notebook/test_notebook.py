"""The notebook of the examples runs, and shows a picture for each of its cells."""

from pathlib import Path

import nbformat
from nbclient import NotebookClient
from patience import HANGING

NOTEBOOK = Path(__file__).parents[2] / "examples/sliders.ipynb"


def test_each_cell_shows_a_picture(monkeypatch):
    monkeypatch.setenv("SHPY_BACKEND", "numpy")
    notebook = nbformat.read(NOTEBOOK, 4)
    NotebookClient(notebook, timeout=HANGING, kernel_name="python3").execute()
    shown = [set(out["data"]) for cell in notebook.cells if cell.cell_type == "code" for out in cell.outputs]
    assert len(shown) == 4
    assert ["image/png" in kinds for kinds in shown[:3]] == [True] * 3
    assert "application/vnd.jupyter.widget-view+json" in shown[1]
    assert "image/gif" in shown[3]
