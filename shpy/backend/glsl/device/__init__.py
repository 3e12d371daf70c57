"""GL devices: the context, memory in textures, runs, and collective operations."""
