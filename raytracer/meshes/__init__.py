"""Triangle meshes: their classes, the readers of their files, and shapes."""

from raytracer.meshes.mesh import Instance, Mesh

__all__ = ["Instance", "Mesh"]
