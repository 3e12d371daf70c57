"""The conformance list on every driver that is installed: no result differs in a bit, and nothing ends the process."""

import pytest
from drivers import DRIVERS, Driver, run


@pytest.mark.slow
@pytest.mark.parametrize("driver", [d for d in DRIVERS if d.installed], ids=lambda d: d.name)
def test_a_driver_gives_the_same_bits_or_refuses(driver: Driver) -> None:
    report = run(driver)
    assert not report.faults
    assert report.outcomes
