"""The code in the documents runs, prints what they say, and is emitted as they show it.

In a document, a block `python` is run after those before it; a block `text` that follows is what it printed; a block
`emitted BACKEND` is the text of the program that was recorded last, in GLSL that for a device without faults;
`<!-- operations -->` begins a table made of the rows of `ir/ops.py`. `pytest --update-snapshots` writes all of these
anew.
"""

import contextlib
import io
import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import trimesh
from operation_tables import table_of_functions, table_of_operations
from PIL import Image as pillow
from texts import TEXTS

import shpy as sh
from raytracer.meshes.shapes import knot

ROOT = Path(__file__).parents[1]
RUN = [
    "README.md", "docs/texts.md", "docs/language.md", "docs/library.md", "docs/streams.md", "docs/testing.md",
    "docs/gradients.md", "docs/accuracy.md", "docs/clusters.md", "docs/numerics.md",
    "docs/shadertoy.md", "docs/live.md",
    "docs/raytracer.md", "docs/raytracer-pictures.md", "docs/raytracer-rays.md", "docs/raytracer-files.md",
    "docs/materials.md",
    "docs/tutorial.md",
]  # fmt: skip
ON_NUMPY = {
    *("docs/testing.md", "docs/tutorial.md"),
    *("docs/raytracer.md", "docs/raytracer-pictures.md", "docs/raytracer-files.md"),
}
"""Documents whose blocks ask for no backend and take half as long on numpy, for each of their kernels runs once."""
FENCE = re.compile(r"^```(?P<info>\w.*)\n(?P<text>(?:(?!```).*\n)*)```$", re.MULTILINE)
TABLES = [
    (
        "docs/numerics.md",
        re.compile(r"(?<=<!-- operations -->\n).*?(?=<!-- end of operations -->)", re.DOTALL),
        table_of_operations,
    ),
    (
        "docs/language.md",
        re.compile(r"(?<=<!-- functions -->\n).*?(?=<!-- end of functions -->)", re.DOTALL),
        table_of_functions,
    ),
]


@dataclass
class Document:
    """A document that is being run: what its code has defined, and what its last block printed."""

    folder: Path
    names: dict
    printed: str = ""
    count: int = 0

    def block(self, match):
        """Return the text that the block should hold."""
        info, text = match["info"].split(), match["text"]
        if info[1:2] == ["emitted"]:
            program = self.last_program()
            return TEXTS["glsl"](program.ir) if info[2] == "glsl" else program.compile(info[2], lanes=1).source
        if info[0] == "python":
            self.run(text, info[1] if len(info) > 1 else f"block{self.count}.py")
        return self.printed if info[0] == "text" else text

    def run(self, text, name):
        self.count += 1
        path = self.folder / name
        path.write_text(text)
        shown = io.StringIO()
        with contextlib.redirect_stdout(shown):
            exec(compile(text, path, "exec"), self.names)
        self.printed = "\n".join(line.rstrip() for line in shown.getvalue().replace(f"{self.folder}/", "").splitlines())
        self.printed += "\n" if self.printed else ""

    def last_program(self):
        return [thing for thing in self.names.values() if isinstance(thing, sh.Program)][-1]


def write_mesh(path):
    """A mesh in the place of the one that readers of the tutorial have."""
    mesh = knot(segments=60, sides=12)
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)


def write_jar(path):
    """Write a file of several objects with transforms, and materials with and without a picture."""
    scene = trimesh.Scene()
    squares = pillow.fromarray(np.kron([[220, 90], [60, 180]], np.ones((4, 4))).astype(np.uint8))
    for name, mesh, height in (
        ("body", trimesh.creation.box((1, 1.6, 1)), 0.8),
        ("knob", trimesh.creation.icosphere(2, 0.25), 1.8),
    ):
        look = trimesh.visual.material.PBRMaterial(baseColorFactor=[200, 120, 60, 255], metallicFactor=0.0)
        look.baseColorTexture = squares if name == "body" else None
        mesh.visual = trimesh.visual.TextureVisuals(uv=mesh.vertices[:, :2], material=look)
        scene.add_geometry(mesh, name, name, transform=trimesh.transformations.translation_matrix((0, height, 0)))
    scene.export(path)


@pytest.mark.parametrize("name", RUN)
def test_the_code_runs_and_prints_what_the_document_says(name, tmp_path, monkeypatch, snapshots):
    path = ROOT / name
    monkeypatch.chdir(tmp_path)
    if name not in ON_NUMPY:
        monkeypatch.delenv("SHPY_BACKEND")  # what users read has the default that users have
    write_mesh(tmp_path / "bunny.ply")
    write_jar(tmp_path / "jar.glb")
    document = Document(tmp_path, {"__name__": "document"})

    def block(match):
        return f"```{match['info']}\n{document.block(match).rstrip()}\n```".replace("\n\n```", "\n```")

    text = path.read_text()
    found = FENCE.sub(block, text)
    assert document.count > 0
    snapshots.check_part(path, text, found)


@pytest.mark.parametrize(("file", "place", "table"), TABLES, ids=["operations", "functions"])
def test_the_table_is_that_of_the_code(file, place, table, snapshots):
    path = ROOT / file
    text = path.read_text()
    assert len(place.findall(text)) == 1
    snapshots.check_part(path, text, place.sub(lambda _: f"\n{table()}\n", text))


DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_to_files(path):
    links = re.findall(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", path.read_text())
    assert [link for link in links if not (path.parent / link).exists()] == []


@pytest.mark.parametrize("script", ["scripts/setup", "scripts/test"])
def test_the_two_commands_are_there(script):
    assert script in (ROOT / "README.md").read_text()
    assert os.access(ROOT / script, os.X_OK)


def test_continuous_integration_runs_the_second_command():
    assert (ROOT / ".ci/run").read_text().rstrip().endswith("scripts/test")
