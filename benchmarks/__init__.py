"""Benchmarks: `python -m benchmarks` runs shpy and every installed peer side by side; `command` has its options."""
