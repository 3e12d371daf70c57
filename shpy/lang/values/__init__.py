"""Values of the language: their types, operators and functions, on symbolic values and on constants alike."""
