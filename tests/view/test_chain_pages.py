"""The pages of chains, of the examples and others, in a browser: an empty cache, a hundred frames, no error."""

import os
import re
from pathlib import Path

import pytest
import views
from pictured_chains import CHAINS, HEAD
from views import viewed

EXAMPLES = Path(__file__).parents[2] / "examples"
SHOWN = sorted(
    path.stem for path in EXAMPLES.glob("*.py") if re.search(r"^def start\(height, width\)", path.read_text(), re.M)
)
FRAMES = 100


def test_the_examples_have_chains():
    assert SHOWN == ["gray_scott", "life"]


@pytest.mark.slow
@pytest.mark.parametrize("name", [*SHOWN, *CHAINS])
def test_a_chain_shows_a_hundred_frames_and_no_error(browser, tmp_path, name):
    path = EXAMPLES / f"{name}.py"
    if name in CHAINS:
        path = tmp_path / f"{name}.py"
        path.write_text(HEAD + CHAINS[name])
    environment = {**os.environ, "SHPY_CACHE_DIR": str(tmp_path / "cache"), "POCL_CACHE_DIR": str(tmp_path / "pocl")}
    with (
        viewed(path, "--size", "96x64", environment=environment) as view,
        views.watched(browser, view, width=900, height=700) as page,
    ):
        page.evaluate(
            """() => {
                window.problems = [];
                const problem = document.getElementById("problem");
                new MutationObserver(() => { if (!problem.hidden) problems.push(problem.textContent); })
                    .observe(problem, { attributes: true, childList: true });
            }"""
        )
        page.wait_for_selector("body[data-form='opencl']")
        page.wait_for_selector("#work:empty", state="attached")  # the chain may be compiled later than `show`
        before = int(page.get_attribute("body", "data-frames"))
        page.wait_for_function("(frames) => Number(document.body.dataset.frames) >= frames", arg=before + FRAMES)
        assert page.evaluate("() => problems") == []
        assert page.is_hidden("#problem")
