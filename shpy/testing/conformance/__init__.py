"""The conformance list: hundreds of small programs whose results are known to the bit, for every backend and driver.

Stage: test. `cases` says what a case is, `exact` and `evaluate` compute what it must give.
"""
