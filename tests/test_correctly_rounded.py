"""The oracle of correctly rounded functions agrees with mpmath, and the hard cases are all there are."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import correctly_rounded
import mpmath as mp
import numpy as np
import pytest
from correctly_rounded.multiprecision import EXACT, nearest

from shpy.ir.exact import EVEN, FUNCTIONS, MARGIN, ODD, hard_cases

EDGES = np.float32([0, 1, 0.5, 2, 1e-45, 2.0**-126, 3.4028235e38, np.inf, 88.722839, 103.97208, 150, 128, 10, np.nan])


def in_its_domain(name, x):
    match name:
        case "log" | "log2" | "log10" | "rsqrt":
            return x > 0
        case "asin" | "acos":
            return np.abs(x) <= 1
        case "atanh":
            return np.abs(x) < 1
        case "acosh":
            return x >= 1
        case "log1p":
            return x > -1
        case "exp" | "exp2" | "sinh" | "cosh" | "expm1" | "exp10" | "erfc":
            return np.abs(x) < 1000
    return np.full(x.shape, True)


def exactly(name, numbers):
    with mp.workprec(300):
        return np.array([nearest(EXACT[name](mp.mpf(float(x)))) for x in numbers], np.float32)


@pytest.mark.parametrize("name", correctly_rounded.FUNCTIONS)
def test_the_oracle_gives_what_mpmath_gives(name):
    strided = np.concatenate(list(correctly_rounded.everything(stride=21_474_833)))
    x = np.concatenate([strided, EDGES, -EDGES])
    inside = x[in_its_domain(name, x) & np.isfinite(x) & (x != 0)]
    assert len(inside) > 40
    assert correctly_rounded.rounded(name, inside).tolist() == exactly(name, inside).tolist()


@pytest.mark.parametrize("name", correctly_rounded.FUNCTIONS)
def test_the_oracle_gives_what_mpmath_gives_where_it_is_hard(name):
    x, answers = hard_cases(name)
    assert np.all(np.diff(x) > 0)
    assert correctly_rounded.rounded(name, x).tobytes() == answers.tobytes()
    chosen = slice(None, None, max(1, len(x) // 100))
    assert exactly(name, x[chosen]).tolist() == answers[chosen].tolist()


def test_the_oracle_at_infinities_zeros_and_what_is_no_number():
    x = np.float32([np.inf, -np.inf, 0, -0.0, np.nan])
    wanted = {
        "exp": [np.inf, 0, 1, 1, np.nan],
        "log": [np.inf, np.nan, -np.inf, -np.inf, np.nan],
        "sin": [np.nan, np.nan, 0, -0.0, np.nan],
        "atan": [np.pi / 2, -np.pi / 2, 0, -0.0, np.nan],
        "acosh": [np.inf, np.nan, np.nan, np.nan, np.nan],
        "rsqrt": [0, np.nan, np.inf, -np.inf, np.nan],
    }
    for name, answers in wanted.items():
        found, expected = correctly_rounded.rounded(name, x), np.float32(answers)
        np.testing.assert_array_equal(found, expected)
        numbers = ~np.isnan(expected)
        assert np.signbit(found[numbers]).tolist() == np.signbit(expected[numbers]).tolist()


def test_a_tie_goes_to_the_even_number():
    """2**-150 lies in the middle of 0 and the least denormal."""
    x = np.float32([-150, np.nextafter(np.float32(-150), np.float32(0)), -149])
    assert correctly_rounded.rounded("exp2", x).tolist() == [0, 2.0**-149, 2.0**-149]


@pytest.mark.parametrize("name", correctly_rounded.FUNCTIONS)
def test_no_hard_case_is_missing(name):
    """In one part of 4,096 of all numbers, of every exponent."""
    chunk = 1 << 11
    starts = np.arange(0, 1 << 32, chunk << 12, dtype=np.int64) + chunk * 1234
    bits = (starts[:, None] + np.arange(chunk)).ravel().astype(np.uint32)
    x = bits.view(np.float32)
    found = correctly_rounded.hard(name, x, 2 * MARGIN)
    assert np.isin(found, hard_cases(name)[0]).all()


def test_every_function_that_is_exact_has_an_oracle():
    assert {*FUNCTIONS, "rsqrt"} == set(correctly_rounded.FUNCTIONS) >= ODD | EVEN


def test_an_unknown_function_is_named():
    with pytest.raises(correctly_rounded.OracleError, match="there is no function gamma: it is one of exp, exp2, log"):
        correctly_rounded.rounded("gamma", np.float32([1]))


def test_without_gcc_the_cure_is_told(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(
        correctly_rounded.OracleError, match="there is no gcc: it needs gcc and MPFR; on Debian: apt-get install"
    ):
        correctly_rounded._build(tmp_path / "oracle.so")


OF_TWO = {"pow": mp.power, "atan2": mp.atan2, "hypot": mp.hypot}


@pytest.mark.parametrize("name", correctly_rounded.PAIRS)
def test_the_oracle_of_pairs_gives_what_mpmath_gives(name):
    rng = np.random.default_rng(3)
    a, b = (rng.uniform(0.5, 2, (2, 500)) * 2.0 ** rng.integers(-12, 12, (2, 500))).astype(np.float32)
    if name == "pow":
        # Squares of numbers of 13 bits are the middle of two numbers, and these small powers are denormal.
        a[:100], b[:100] = np.arange(4097, 4297, 2), 2
        a[100:200], b[100:200] = np.linspace(2, 3, 100), -np.linspace(88, 93, 100)
    if name == "hypot":
        a[0], b[0] = 14784729, 7946000  # their hypotenuse is 16784729
    with mp.workprec(300):
        wanted = [nearest(OF_TWO[name](mp.mpf(float(x)), mp.mpf(float(y)))) for x, y in zip(a, b, strict=True)]
    assert correctly_rounded.rounded_pairs(name, a, b).tolist() == wanted


def exhaustive(*options: str) -> tuple[int, list[list[str]]]:
    """Return the exit status of scripts/exhaustive on numpy, and the cells of its table."""
    script = Path(__file__).parents[1] / "scripts" / "exhaustive"
    command = [sys.executable, script, *options, "--backend", "numpy"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    rows = [line.strip("| ").split(" | ") for line in run.stdout.splitlines() if line.startswith("| `")]
    return run.returncode, rows


def test_random_pairs_are_counted_and_those_that_are_misrounded():
    status, rows = exhaustive("pairs", "--pairs", "20000")
    assert status == 0
    assert [row[:3] for row in rows] == [[f"`{name}`", "20,000", "0"] for name in correctly_rounded.PAIRS]
    status, rows = exhaustive("pow", "--pairs", "20000", "--math", "portable")
    assert status == 1
    assert 10 < int(rows[0][2]) < 2_000
