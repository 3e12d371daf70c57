"""The appearance of surfaces: materials, textures, and programs of users."""
