"""Triangle meshes: what they are, the parts of their files, and making them."""

from raytracer.meshes.mesh import Instance, Mesh

__all__ = ["Instance", "Mesh"]
