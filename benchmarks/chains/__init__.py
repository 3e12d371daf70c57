"""Chains: computations of many small steps, whose data stay on the device."""
