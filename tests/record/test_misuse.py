"""Every misuse that the language names, its message word for word: tests/record/misuse.txt.

A section holds a program and, behind `----`, the error's class and line (counted in the program) and its text.
`pytest --update-snapshots` writes the second half anew: read it before you commit it.
"""

import linecache
import re
from pathlib import Path

import numpy as np
import pytest

import shpy as sh

TEXT = Path(__file__).with_name("misuse.txt")
PRELUDE = "C = sh.Attrib1f(1)\nP = sh.Param(sh.Attrib1f, 1)\ntab = sh.Table(np.arange(4.0), sh.Attrib1f)\n"


def sections():
    for part in TEXT.read_text().split("==== ")[1:]:
        name, _, rest = part.partition("\n")
        program, _, expected = rest.partition("\n----\n")
        yield name, program, expected.strip()


CASES = list(sections())


def error_of(program, file, source_known=True):
    """Return the error of recording `case` of the program, as text."""
    names = {"sh": sh, "np": np, "math": __import__("math"), "F": sh.Attrib1f, "V": sh.Attrib3f}
    names |= {n: getattr(sh, n) for n in sh.__all__ if n.startswith("SH_")}
    exec(compile(PRELUDE, str(file) + ".prelude", "exec"), names)
    if source_known:
        file.write_text(program)
    linecache.checkcache(str(file))

    def record():
        exec(compile(program, str(file), "exec"), names)
        sh.program(names["case"])

    with pytest.raises((sh.ShpyError, IndexError, AttributeError)) as caught:
        record()
    error = caught.value
    assert isinstance(error, sh.ShpyError)
    assert error.loc is not None, error
    text = re.sub(r"/\S*/(case\.py)", r"\1", str(error))
    return f"{type(error).__name__} at line {error.loc.line}\n{text}"


@pytest.mark.parametrize(("name", "program", "expected"), CASES, ids=[c[0] for c in CASES])
def test_misuse_says_what_is_wrong_and_what_to_write(name, program, expected, tmp_path, snapshots):
    section = f"==== {name}\n{program}\n----\n"
    found = error_of(program, tmp_path / "case.py")
    snapshots.check_part(TEXT, section + expected, section + found)


@pytest.mark.parametrize(
    "name",
    [
        "block_value_used_after",
        "if_on_value",
        "math_sin",
        "store_into_copy",
        "loop_index_after",
        "other_recording",
        "exception_caught_outside_block",
        "generator_left_in_block",
        "block_still_open",
        "block_kept",
    ],
)
def test_misuse_is_found_without_the_source_too(name, tmp_path):
    program = next(p for n, p, _ in CASES if n == name)
    assert "write instead" in error_of(program, tmp_path / "nowhere.py", source_known=False)
