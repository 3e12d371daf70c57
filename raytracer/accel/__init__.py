"""Accelerators: structures that spare a ray most of the triangles. Built in numpy."""
