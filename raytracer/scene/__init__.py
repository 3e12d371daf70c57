"""Scenes: meshes under lights before a camera, and the tables that kernels read."""
