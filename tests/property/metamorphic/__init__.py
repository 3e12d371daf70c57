"""Changes of a program that leave every result as it was, so that a wrong one betrays itself without a reference."""
