"""IMPROVE: passes from IR to IR, each in a file of its own."""
