"""REPRESENT: types, the op table, nodes, text, verifier and interpreter of the IR."""
