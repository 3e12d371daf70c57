"""Streams: data that stays on a device from run to run.

Stage: run. `stream` holds the data, `elements` has its shapes and dtypes; `shpy/run/on_device` runs kernels over them.
"""
