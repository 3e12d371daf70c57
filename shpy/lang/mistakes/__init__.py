"""Mistakes of the user, found in the text or the bytecode of a function, and explained with a cure."""
