"""Streams: data that stays on a device from run to run.

Stage: run. `stream` holds the data, `running` runs kernels over them.
"""
