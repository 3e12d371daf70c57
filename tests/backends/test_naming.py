from __future__ import annotations

import re

import pytest
from hypothesis import given, settings, strategies as st

from shpy.backend.emit.names import _PREFIXES, MAX_LENGTH, RESERVED, Names, Target, legal

TARGETS: tuple[Target, ...] = ("glsl", "opencl", "python")
NASTY = [
    "x", "x", "X", "x_2", "x__2", "x_", "_x", "__x", "_", "__", "", " ", "1x", "42", "gl_Position", "gl__", "sh_min",
    "float", "float3", "vec3", "sampler2D", "in", "out", "lambda", "None", "kernel", "convert_int", "as_float", "M_PI",
    "vload3", "a;}", "a;}\nb", "a*/b", "//", "\\\n", '"', "'", "#define x", "θ", "Θ", "λ", "größe", "日本", "x\u0301",
    "x\0y", "a" * 10_000, "a" * 10_000, "_" * 10_000, ";" * 10_000, "a_" * 5_000, "main", "np", "print", "__import__",
    "__debug__", "_Bool", "_A", "INFINITY", "texture", "defined", "radius", "t", "t2", "linux", "webgl_x", "ﬁeld", "x²",
]  # fmt: skip


def check(target: Target, name: str) -> None:
    assert re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name)
    assert len(name) <= MAX_LENGTH + 10
    assert name not in RESERVED[target]
    assert "__" not in name
    assert not name.startswith("sh_")
    assert not name.startswith(_PREFIXES[target])


@pytest.mark.parametrize("target", TARGETS)
def test_every_nasty_name_becomes_a_legal_one_of_its_own(target: Target) -> None:
    names = Names(target)
    given_out = [names.take(wanted) for wanted in NASTY * 2]
    for name in given_out:
        check(target, name)
    assert len(set(given_out)) == len(given_out)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("target", TARGETS)
@settings(max_examples=40)
@given(wanted=st.lists(st.text(max_size=60) | st.from_regex(r"[a-z_]{1,5}_?[0-9]?", fullmatch=True), max_size=30))
def test_any_text_becomes_a_legal_name_of_its_own(target: Target, wanted: list[str]) -> None:
    names = Names(target)
    given_out = [names.take(text) for text in wanted]
    for name in given_out:
        check(target, name)
    assert len(set(given_out)) == len(given_out)


@pytest.mark.parametrize("target", TARGETS)
def test_a_reserved_word_is_never_given_out(target: Target) -> None:
    names = Names(target)
    for word in RESERVED[target]:
        check(target, names.take(word))


@pytest.mark.parametrize("name", ["x", "radius", "t_max", "_hidden", "Sky2", "a1b2"])
@pytest.mark.parametrize("target", TARGETS)
def test_a_legal_name_is_kept(target: Target, name: str) -> None:
    assert Names(target).take(name) == name


@pytest.mark.parametrize("target", TARGETS)
def test_numbers_make_no_reserved_prefix(target: Target) -> None:
    """Two names `M` were `M` and `M_2`, which begins as OpenCL's own constants do."""
    names = Names(target)
    stems = [prefix.rstrip("_") for prefixes in _PREFIXES.values() for prefix in prefixes]
    given_out = [names.take(stem) for stem in stems * 3]
    for name in given_out:
        check(target, name)
    assert len(set(given_out)) == len(given_out)


def test_readable() -> None:
    names = Names("opencl")
    assert [names.take("M") for _ in range(3)] == ["M", "M2", "M3"]
    assert [names.take("half") for _ in range(2)] == ["my_half", "my_half_2"]
    assert legal("sample", "glsl") == "sample_"
    assert legal("größe", "python") == "grose" or legal("größe", "python") == "gro_e"
    assert legal("Ωθλ", "opencl") == "Omegathetalambda"
    assert legal("gl_x", "glsl") == "my_gl_x"
    assert legal("gl_x", "opencl") == "gl_x"
    assert legal("½", "glsl") == "n1_2"
    assert legal("café", "glsl") == "cafe"
    assert legal("???", "glsl") == ""


def test_names_of_an_inner_scope_avoid_the_outer_ones_only() -> None:
    outer = Names("opencl", used=["n"])
    first, second = outer.scope(), outer.scope()
    assert (first.take("n"), first.take("x"), second.take("x"), outer.take("x")) == ("n_2", "x", "x", "x")
