"""How surfaces look: materials and their textures."""
