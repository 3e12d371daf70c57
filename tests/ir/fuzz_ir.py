"""Coverage-guided fuzzing of the parser and the verifier: run as a script, with libFuzzer's options.

    pip install atheris && python tests/ir/fuzz_ir.py -runs=100000

Whatever the text is, it is refused with a ParseError or VerifyError, or it is a module that is printed and read back as
the same one. Anything else ends the run with the text that did it.
"""

from __future__ import annotations

import random
import re
import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["shpy"]):
    import shpy as sh
    from shpy.ir.verifier import verify

ROOT = Path(__file__).parents[2]
TEXTS = re.findall(r"```ir\n(.*?)```", (ROOT / "docs/ir.md").read_text(), re.DOTALL)
TOKEN = re.compile(r"[%$][\w.]+|\w+|[^\w\s]|\n|[ ]+")
TOKENS = sorted({token for text in TEXTS for token in TOKEN.findall(text)})
LONGEST = 4000


def mutate(data: bytes, longest: int, seed: int) -> bytes:
    """Change a token or a line, or, now and then, any byte."""
    rng = random.Random(seed)
    if rng.random() < 0.2:
        return bytes(atheris.Mutate(data, longest))
    text = data.decode("utf-8", errors="replace")
    pieces = TOKEN.findall(text) if rng.random() < 0.7 else text.splitlines(True)
    at, other = (rng.randrange(len(pieces) + 1) for _ in range(2))
    new = [rng.choice(TOKENS)] if rng.random() < 0.5 else pieces[other : other + 1]
    pieces[at : at + rng.randrange(2)] = new if rng.random() < 0.8 else []
    return "".join(pieces).encode()[:longest]


def one(data: bytes) -> None:
    """Parse, verify, print, parse again."""
    text = data.decode("utf-8", errors="replace")
    try:
        module = sh.parse(text)
        verify(module)
    except (sh.ParseError, sh.VerifyError):
        return
    again = sh.parse(str(module))
    assert again == module
    try:
        sh.Program.from_ir(module)
    except sh.ShpyError:
        return


def main() -> None:
    """Begin with the modules of docs/ir.md."""
    with tempfile.TemporaryDirectory() as folder:
        for number, text in enumerate(TEXTS):
            (Path(folder) / str(number)).write_text(text)
        options = [sys.argv[0], f"-max_len={LONGEST}", "-timeout=20", *sys.argv[1:], folder]
        atheris.Setup(options, one, custom_mutator=mutate)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
