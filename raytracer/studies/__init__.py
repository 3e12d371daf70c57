"""Measurements: the trade-off of time and error, and the repeated studies of two papers."""
