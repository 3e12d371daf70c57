"""The pytest plugin: a test runs on each backend, and the command line says on which.

Stage: test. The package registers it (entry point `pytest11`), so every run of pytest loads it where shpy is installed.
It stands outside of `shpy`, whose import takes 0.3 s of CPU, and imports that where a test or an option asks for it.

    def test_double(shpy_backend):                      # once for each backend that is available
        assert double.compile(shpy_backend)(2) == 4

    pytest --shpy-backends numpy,opencl --shpy-ulp 2
    pytest --shpy-update                                # golden results are written anew
"""

from __future__ import annotations

from typing import Any

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("shpy")
    group.addoption(
        "--shpy-backends",
        metavar="NAMES",
        help="backends that tests with the fixture shpy_backend, and assert_equivalent, run on: numpy,opencl,glsl",
    )
    group.addoption(
        "--shpy-ulp", type=float, default=0.0, metavar="N", help="the distance that assert_equivalent always allows"
    )
    group.addoption("--shpy-update", action="store_true", help="write the files of assert_golden anew")


def pytest_configure(config: pytest.Config) -> None:
    """Hand the options to `assert_equivalent`; UsageError for a backend that is unknown or not available."""
    names = config.getoption("--shpy-backends")
    ulp = config.getoption("--shpy-ulp")
    update = config.getoption("--shpy-update")
    if not (names or ulp or update):
        return
    from shpy.errors import BackendUnavailable
    from shpy.testing import defaults
    from shpy.testing.reference import require

    defaults.ulp, defaults.update = ulp, update
    try:
        defaults.backends = tuple(require(names.split(","))) if names else None
    except BackendUnavailable as error:
        raise pytest.UsageError(f"--shpy-backends {names}: {error}") from None


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Make one test for each backend where the fixture is asked for."""
    if "shpy_backend" in metafunc.fixturenames:
        from shpy.backend.registry import backends
        from shpy.testing import defaults

        names = defaults.backends or [b.name for b in backends() if b.available]
        metafunc.parametrize("shpy_backend", names, indirect=True)


@pytest.fixture
def shpy_backend(request: Any) -> str:
    """Return the name of the backend that this test runs on, for `Program.compile`."""
    name: str = request.param
    return name
