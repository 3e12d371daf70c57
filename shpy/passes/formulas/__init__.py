"""Formulas of the elementary functions, in operations that every target rounds alike: `strict` and `portable`."""
