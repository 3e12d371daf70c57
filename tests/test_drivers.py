"""The conformance list on every driver that is installed: no result differs in a bit, and nothing ends the process."""

import pytest
from drivers import DRIVERS, Driver, Report, cases_of, run


def test_a_row_tells_what_is_corrected_refused_and_wrong():
    notes = ["this device gets fma wrong: strict mode corrects it", "this device flushes denormals to zero"]
    refused = "refused: D has no f64"
    report = Report("D", "1.0", notes, {"one": "same", "two": refused, "three": "wrong: 1, not 2", "four": refused})
    assert report.faults == ["three: wrong: 1, not 2"]
    assert report.row(Driver("driver", "opencl-1")) == (
        f"| driver | D, 1.0 | same bits: 1 programs (4 of {len(cases_of('opencl-1'))} were run); "
        "corrected: gets fma wrong (strict mode corrects it); flushes denormals to zero; "
        "refused: has no f64 (2 programs); three: wrong: 1, not 2 |"
    )


@pytest.mark.slow
@pytest.mark.parametrize("driver", [d for d in DRIVERS if d.installed], ids=lambda d: d.name)
def test_a_driver_gives_the_same_bits_or_refuses(driver: Driver) -> None:
    report = run(driver)
    assert not report.faults
    assert report.outcomes
