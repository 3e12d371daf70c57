"""Triangle meshes: what they are, the parts of their files, and making them."""

from raytracer.meshes.instance import Instance
from raytracer.meshes.mesh import Mesh

__all__ = ["Instance", "Mesh"]
