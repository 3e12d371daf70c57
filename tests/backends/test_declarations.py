"""The declarations that a text gets for PoCL: those of its header, and the same bits with them as with the header."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from backends.test_conformance import STRUCTURED, each

from shpy.backend.opencl.device.declarations import declarations
from shpy.backend.opencl.device.driver import Machine, machine_of
from shpy.backend.opencl.device.trial import DECLARES
from shpy.backend.opencl.text.operations import FUNCTIONS, NATIVE
from shpy.testing.conformance.cases import Case

HEADER = Path("/usr/share/pocl/include/opencl-c.h")
"""The place where Debian's and Ubuntu's packages have it, which `scripts/test` installs."""

SIZES = ("", "2", "3", "4", "8", "16")
INTS = ("char", "uchar", "short", "ushort", "int", "uint", "long", "ulong")
BASES = (*INTS, "float", "double")
NAMES = [
    *FUNCTIONS.values(),
    *NATIVE.values(),
    *"fabs sign min max clamp get_global_id get_global_size get_global_offset get_local_id get_group_id".split(),
    *"atomic_inc atomic_dec atomic_add atomic_min atomic_max mem_fence".split(),
    *(f"convert_{base}{n}{mode}" for base in BASES for n in SIZES for mode in ("", "_rte")),
    *(f"convert_{base}{n}_sat" for base in INTS for n in SIZES),
    *(f"{way}{n}" for way in ("vload", "vstore") for n in SIZES[1:]),
    *(f"vload_half{n}" for n in SIZES),
    *(f"vstore_half{n}{mode}" for n in SIZES for mode in ("", "_rte")),
]
MACROS = {"__ovld": "overloadable", "__cnfn": "const", "__purefn": "pure"}
TYPE = re.compile(rf"(size_t|{'|'.join(BASES)})\d*")

Parts = tuple[Any, ...]


def parts(declaration: str) -> Parts:
    """Return the attributes, the result and the types of the operands of a declaration."""
    found = re.search(r"__attribute__\(\((.*?)\)\)", declaration)
    attributes = set(found[1].split(", ")) if found else {MACROS[word] for word in MACROS if word in declaration}
    plain = re.sub(r"__attribute__\(\(.*?\)\)|__ovld|__cnfn|__purefn", "", declaration)
    result, operands = re.split(r"\w+\(", plain.removesuffix(");"), maxsplit=1)
    types = []
    for operand in operands.replace("cl_mem_fence_flags", "uint").replace("*", " * ").split(","):
        words = operand.split()
        named = len(words) > 1 and words[-1] != "*" and not TYPE.fullmatch(words[-1])
        types.append(" ".join(words[:-1] if named else words))
    return sorted(attributes), result.strip(), *types


def in_header() -> dict[str, list[Parts]]:
    """Return the declarations of OpenCL C 1.2 in the header by name, without those for f16."""
    found: dict[str, list[Parts]] = {}
    for whole in re.finditer(r"^[a-z_]\w*\s[^;{}#]*?\b(\w+)\([^;{}#]*\);", HEADER.read_text(), re.MULTILINE):
        declaration = " ".join(whole[0].split())
        generic = "*" in declaration and not re.search(r"__(global|local|private|constant)", declaration)
        if not generic and not re.search(r"\bhalf\d*\b(?! ?\*)", declaration):
            found.setdefault(whole[1], []).append(parts(declaration))
    return found


def test_functions_are_declared_as_in_the_header() -> None:
    header = in_header()
    for name in NAMES:
        lines = declarations(f"{name}()", doubles=True).splitlines()
        own = [parts(line) for line in lines if not line.startswith("#")]
        assert sorted(own) == sorted(header[name]), name


@pytest.mark.parametrize("name", ["vload32", "convert_int32", "vstore_half64", "as_float32", "convert_bool", "sh_any"])
def test_other_names_are_not_declared(name: str) -> None:
    assert declarations(f"{name}(x)") == "#line 1\n"


def test_without_binary64_nothing_of_it_is_declared() -> None:
    text = "floor(x) vload4(0, a) convert_int(x) vstore_half(x, 0, a)"
    assert "double" in declarations(text, doubles=True)
    assert "double" not in declarations(text)


def test_errors_have_the_lines_of_the_text() -> None:
    machine = machine_of(None)
    with pytest.raises(machine.cl.Error, match=r":3:\d+: use of undeclared identifier 'no_such_function'"):
        machine.build(
            "__kernel void f(__global float *a) {\n    a[0] = floor(a[0]);\n    a[1] = no_such_function(a);\n}"
        )


@pytest.fixture
def whole_header(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """The texts that are compiled with the header, as if the compiler took no declarations of ours."""
    machine, texts = machine_of(None), []
    monkeypatch.setitem(machine.__dict__, "_succeeded", machine._succeeded - {DECLARES})
    compiled = Machine._compiled_with_header

    def noted(machine: Machine, text: str, options: list[str]) -> Any:
        texts.append(text)
        return compiled(machine, text, options)

    monkeypatch.setattr(Machine, "_compiled_with_header", noted)
    machine._programs.clear()
    yield texts
    machine._programs.clear()


@pytest.mark.sampled(6)
@each([case for case in STRUCTURED[::100] if not case.refused and "texture" not in case.name])
def test_the_header_gives_the_same_bits(case: Case, whole_header: list[str]) -> None:
    again = replace(case)  # which is recorded anew, so that no kernel of it is kept
    again.check(again.run("opencl"), "opencl")
    assert whole_header
