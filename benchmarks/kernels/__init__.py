"""Kernels: one file each, with our version, the peers', and when their answers count as the same."""
