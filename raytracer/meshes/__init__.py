"""Triangle meshes: what they are, reading them from files, and making them."""

from raytracer.meshes.mesh import Mesh

__all__ = ["Mesh"]
