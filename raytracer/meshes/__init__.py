"""Triangle meshes: what they are, reading them from files, and making them."""

from raytracer.meshes.from_trimesh import mesh_of
from raytracer.meshes.instance import Instance
from raytracer.meshes.loading import load_mesh
from raytracer.meshes.mesh import LOADERS, Mesh

__all__ = ["Instance", "Mesh"]

LOADERS.update(file=load_mesh, trimesh=mesh_of)
