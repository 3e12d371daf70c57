"""A PLY file of a triangle with uv coordinates and the name of a picture."""

PLY = """ply
format ascii 1.0
comment TextureFile paint.png
element vertex 3
property float x
property float y
property float z
property float s
property float t
element face 1
property list uchar int vertex_indices
end_header
0 0 0 0 0
1 0 0 1 0
0 1 0 0 1
3 0 1 2
"""
