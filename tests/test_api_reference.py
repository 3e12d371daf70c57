"""scripts/reference writes a page for each module with a place for every public name, and its links lead somewhere."""

import posixpath
import re
import subprocess
import sys
from pathlib import Path

import pytest
from patience import HANGING

import raytracer
import shpy as sh

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """The text of each page, by its path in the folder."""
    folder = tmp_path_factory.mktemp("reference")
    command = [sys.executable, ROOT / "scripts/reference", folder]
    done = subprocess.run(command, capture_output=True, text=True, timeout=HANGING)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.strip() == f"{folder}/index.html"
    return {path.relative_to(folder): path.read_text() for path in folder.rglob("*.html")}


def anchors(text):
    return set(re.findall(r'\bid="([^"]+)"', text))


@pytest.mark.parametrize("module", [sh, sh.accuracy, sh.library, sh.testing, raytracer], ids=lambda m: m.__name__)
def test_every_public_function_and_class_has_a_place(pages, module):
    places = anchors(pages[Path(f"{module.__name__.replace('.', '/')}.html")])
    # An alias such as `vec3` has its place under the name of what it stands for.
    wanted = {name for name in module.__all__ if getattr(getattr(module, name), "__name__", None) == name}
    assert len(wanted) > 5
    assert wanted - places == set()


def test_links_lead_to_pages_and_places(pages):
    places = {path: anchors(text) for path, text in pages.items()}
    links = {(path, link) for path in pages for link in re.findall(r'href="(?!https?:|data:|\$)([^"]+)"', pages[path])}
    assert len(links) > 500

    def leads_somewhere(path, link):
        name, _, place = link.partition("#")
        target = Path(posixpath.normpath(path.parent / name)) if name else path
        return target in places and (not place or place in places[target])

    assert [f"{path}: {link}" for path, link in sorted(links) if not leads_somewhere(path, link)] == []
