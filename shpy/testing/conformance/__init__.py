"""The conformance list: hundreds of small programs whose results are known to the bit, for every backend and driver.

Stage: test. `cases` defines a case, `exact` and `evaluate` compute its expected result.
"""
