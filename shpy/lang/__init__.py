"""RECORD: running the user's function on symbolic values, which append to the IR."""
