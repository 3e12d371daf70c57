"""The Python text of a vectorised module for numpy."""
