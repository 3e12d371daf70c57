"""The scripts that let a shell complete the words of the commands."""

from __future__ import annotations

import subprocess
import sys

import pytest

ASKING = """
source <({python} -m {module} --completion bash)
COMP_WORDS=({words} "{last}"); COMP_CWORD={count}
_shtab_{module}
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("module", "words", "last", "found"),
    [
        ("shpy", "shpy", "doc", {"doctor"}),
        ("raytracer", "raytracer render", "--integ", {"--integrator"}),
        ("raytracer", "raytracer render mixed --integrator", "", {"whitted", "path"}),
        ("raytracer", "raytracer render", "scene.g", {"scene.glb"}),
    ],
)
def test_bash_completes_commands_options_choices_and_files(tmp_path, module, words, last, found):
    (tmp_path / "scene.glb").touch()
    script = ASKING.format(python=sys.executable, module=module, words=words, last=last, count=len(words.split()))
    done = subprocess.run(["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True)
    assert set(done.stdout.split()) == found, done.stderr


def test_without_shtab_the_package_is_named(tmp_path):
    code = "import sys; sys.modules['shtab'] = None; from shpy.cli import main; main(['--completion', 'bash'])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2
    assert "completion needs shtab: " in done.stderr
    assert "install 'shtab>=1.6'" in done.stderr
