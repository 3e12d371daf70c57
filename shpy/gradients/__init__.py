"""Derivatives of functions and of programs of the language.

Stage: record, and above. `functions` records a function once more, as a function of its own, and calls the derivative
that passes make of it (`passes/derivatives`). `programs` makes programs of derivatives.
"""
