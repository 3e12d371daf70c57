"""Nothing: installations of before `shpy_start.pytest_plugin` load this module in every run of pytest."""
