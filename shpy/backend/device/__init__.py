"""Devices, for all targets: the pace of dispatches, lists of live elements, probes, and what is kept on disk."""
