"""Benchmarks: `python -m benchmarks` runs shpy and every installed peer side by side; `__main__` has its options."""
