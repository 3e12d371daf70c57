"""Accelerators: structures, built in numpy, with which a ray is tested against only a few of the triangles."""
