"""The appearance of surfaces: materials and their textures."""
