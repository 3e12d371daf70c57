"""Devices, for all targets: the pace of dispatches, lists of live elements, probes, and the cache on disk."""
