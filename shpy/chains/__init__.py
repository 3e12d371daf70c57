"""Chains: several kernels that run one after the other over named streams, on one device.

Stage: run, above programs. `member` connects a kernel with streams by name, `chain` composes members, `running` runs
a chain, `merging` keeps the elements that a kernel discards, `share` counts the elements that are ready.
"""
